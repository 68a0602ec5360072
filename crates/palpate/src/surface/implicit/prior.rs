use super::{WeightedSample, level::Level};
use crate::geometry::{Point, Vector};
use rayon::prelude::*;

/// Generalised winding number of oriented samples, each standing for a disc of the given area; about 1 inside, 0 outside.
///
/// Barill et al., *Fast Winding Numbers for Soups and Clouds*, 2018, eq. 4, summed directly: O(nodes · samples), both few thousands.
pub(super) struct Winding {
    /// Position and dipole in groups of eight: x, y, z, dx, dy, dz.
    groups: Vec<[[f32; LANES]; 6]>,
    /// Keeps a sample's own singularity finite, m².
    softening: f32,
    /// Positions are relative to it, so that `f32` suffices far from the origin.
    origin: Point,
}

const LANES: usize = 8;

impl Winding {
    /// `samples` must be spread about one per `spacing` cube.
    pub(super) fn new(samples: &[WeightedSample], spacing: f64) -> Self {
        let origin = samples.first().map_or_else(Point::origin, |s| s.position);
        let mut groups = vec![[[0.0; LANES]; 6]; samples.len().div_ceil(LANES)];
        for (i, s) in samples.iter().enumerate() {
            // A plane of normal n cuts cubes of side s in pieces of mean area s² / (|nx| + |ny| + |nz|).
            let area = spacing * spacing / s.normal.lp_norm(1).max(1e-9);
            let d: Vector = s.normal * (area / (4.0 * std::f64::consts::PI));
            let p = s.position - origin;
            for (slot, value) in groups[i / LANES].iter_mut().zip([p.x, p.y, p.z, d.x, d.y, d.z]) {
                slot[i % LANES] = value as f32;
            }
        }
        Self { groups, softening: (1e-3 * spacing * spacing) as f32, origin }
    }

    /// The winding number at `p`.
    pub(super) fn at(&self, p: &Point) -> f32 {
        let p = p - self.origin;
        let (x, y, z) = (p.x as f32, p.y as f32, p.z as f32);
        let mut sum = [0.0f32; LANES];
        for [px, py, pz, dx, dy, dz] in &self.groups {
            for l in 0..LANES {
                let (rx, ry, rz) = (px[l] - x, py[l] - y, pz[l] - z);
                let r2 = rx * rx + ry * ry + rz * rz + self.softening;
                sum[l] += (rx * dx[l] + ry * dy[l] + rz * dz[l]) / (r2 * r2.sqrt());
            }
        }
        sum.iter().sum()
    }
}

/// Cosine from which a sample faces a direction.
const FACING: f64 = 0.8;

/// A slightly too large convex hull of samples: the intersection of half-spaces in evenly spread directions, of those in which the
/// surface is seen to turn back. Where the evidence just ends (the rim of the visible side), its hull says nothing of what lies beyond.
pub(super) struct Hull {
    supports: Vec<(Vector, f64)>,
}

impl Hull {
    const DIRECTIONS: usize = 192;

    /// `margin` – a sample within it of the extreme may show that the surface turns there, metres
    pub(super) fn new(samples: &[WeightedSample], margin: f64) -> Self {
        let golden = std::f64::consts::PI * (3.0 - 5.0f64.sqrt());
        let supports: Vec<Option<(Vector, f64)>> = (0..Self::DIRECTIONS)
            .into_par_iter()
            .map(|i| {
                let z = 1.0 - (2 * i + 1) as f64 / Self::DIRECTIONS as f64;
                let (r, a) = ((1.0 - z * z).sqrt(), golden * i as f64);
                let d = Vector::new(r * a.cos(), r * a.sin(), z);
                let extreme = samples.iter().map(|s| d.dot(&s.position.coords)).fold(f64::NEG_INFINITY, f64::max);
                let facing = |s: &&WeightedSample| d.dot(&s.normal) > FACING;
                let faces = samples.iter().filter(facing).any(|s| d.dot(&s.position.coords) > extreme - margin);
                faces.then_some((d, extreme))
            })
            .collect::<Vec<_>>();
        Self { supports: supports.into_iter().flatten().collect() }
    }

    /// How far `p` is outside (a lower bound), metres; ≤ 0 inside.
    pub(super) fn outside(&self, p: &Point) -> f64 {
        self.supports.iter().map(|(d, s)| d.dot(&p.coords) - s).fold(f64::NEG_INFINITY, f64::max)
    }
}

/// How far under the threshold the winding number says outside for all it can, and as far again from where on it is sure.
const RAMP: f32 = 0.05;

/// Weight of the outside prior at every node of `level`: that of the winding number plus, if a hull is given, its own beyond the margin.
///
/// A winding number just under the threshold may still be one of the inside of a body of which a side is missing, where the seams are
/// smoothness' to close; far under it, between the wings of an aeroplane, it is not.
pub(super) fn weights(level: &Level, winding: &Winding, hull: Option<&Hull>, params: &super::PriorParams) -> Vec<f32> {
    let [nx, ny, _] = level.dims;
    let mut out = vec![0.0f32; level.values.len()];
    out.par_chunks_mut(level.plane_len()).enumerate().for_each(|(k, out)| {
        for j in 0..ny {
            for i in 0..nx {
                let p = level.position(i, j, k);
                let under = (params.winding_threshold as f32 - winding.at(&p)) / RAMP;
                let mut weight = params.winding_weight as f32 * under.clamp(0.0, 1.0);
                weight += params.winding_sure_weight as f32 * (under - 1.0).clamp(0.0, 1.0);
                if hull.is_some_and(|h| h.outside(&p) > params.hull_margin) {
                    weight += params.hull_weight as f32;
                }
                out[j * nx + i] = weight;
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::super::PriorParams;
    use super::*;
    use crate::geometry::Aabb;

    #[test]
    fn winding_number_of_a_sphere_is_one_inside_and_nothing_outside() {
        let spacing = 0.01;
        let count = (4.0 * std::f64::consts::PI * 0.01 / (spacing * spacing) * 1.5) as usize;
        let golden = std::f64::consts::PI * (3.0 - 5.0f64.sqrt());
        let samples: Vec<_> = (0..count)
            .map(|i| {
                let z = 1.0 - (2 * i + 1) as f64 / count as f64;
                let (r, a) = ((1.0 - z * z).sqrt(), golden * i as f64);
                let n = Vector::new(r * a.cos(), r * a.sin(), z);
                WeightedSample { position: Point::from(n * 0.1), normal: n, weight: 1.0, orientation: 1.0 }
            })
            .collect();
        // The area rule assumes one sample per cut cube; here the density is known, so compare after scaling.
        let w = Winding::new(&samples, spacing);
        let inside = w.at(&Point::origin());
        assert!((inside - 1.0).abs() < 0.15, "{inside}");
        assert!(w.at(&Point::new(0.3, 0.0, 0.0)).abs() < 0.05);
        let hull = Hull::new(&samples, 0.01);
        assert!(hull.outside(&Point::origin()) < -0.09);
        assert!((hull.outside(&Point::new(0.0, 0.0, 0.15)) - 0.05).abs() < 2e-3);
    }

    #[test]
    fn only_far_under_the_threshold_the_outside_is_sure() {
        let (position, normal) = (Point::origin(), Vector::z());
        let winding = Winding::new(&[WeightedSample { position, normal, weight: 1.0, orientation: 1.0 }], 0.01);
        let corner = Point::new(0.01, 0.01, 0.01);
        let level = Level::covering(&Aabb { min: -corner, max: corner }, 0.01);
        let params = PriorParams::default();
        let u = f64::from(winding.at(&level.position(0, 0, 0)));
        for (under, wanted) in [
            (-0.05, 0.0),
            (0.025, 0.5 * params.winding_weight),
            (0.05, params.winding_weight),
            (0.075, params.winding_weight + 0.5 * params.winding_sure_weight),
            (0.2, params.winding_weight + params.winding_sure_weight),
        ] {
            let params = PriorParams { winding_threshold: u + under, ..params.clone() };
            let weight = weights(&level, &winding, None, &params)[level.index(0, 0, 0)];
            assert!(
                (f64::from(weight) - wanted).abs() < 1e-3 * params.winding_sure_weight,
                "{under}: {weight}, not {wanted}"
            );
        }
    }

    #[test]
    fn the_hull_of_a_seen_half_does_not_end_behind() {
        let half: Vec<WeightedSample> = (0..2000)
            .map(|i| {
                let z = 1.0 - (i as f64 + 0.5) / 2000.0;
                let (r, a) = ((1.0 - z * z).sqrt(), 2.4 * i as f64);
                let n = Vector::new(r * a.cos(), r * a.sin(), z);
                WeightedSample { position: Point::from(n * 0.05), normal: n, weight: 1.0, orientation: 1.0 }
            })
            .collect();
        let hull = Hull::new(&half, 4e-3);
        assert!(hull.outside(&Point::new(0.0, 0.0, -0.04)) < 0.0, "nothing turns back there");
        assert!(hull.outside(&Point::new(0.0, 0.0, 0.06)) > 9e-3, "the seen side does");
    }
}
