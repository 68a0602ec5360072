//! Points moved onto the surface of their neighbours before balls roll over them.

use super::grid::Grid;
use crate::geometry::{Aabb, Point, Vector};
use crate::surface::poisson::noise_and_spacing;
use rayon::prelude::*;

/// Noise over spacing up to which balls manage by themselves …
const QUIET: f64 = 0.08;

/// … and to which a round is meant to bring it: points of density 1/s², weighed with a Gaussian of radius r, average noise to s/(√(4π) r) of itself.
const WANTED: f64 = 0.08;

/// Largest Gaussian, in spacings: a round then looks at some 2,000 points.
const WIDEST: f64 = 12.0;

/// Gaussian radii within which neighbours count.
const REACH: f64 = 2.0;

/// Edge of the cells whose points are seen as one, in Gaussian radii: the weight hardly differs within.
const GROUP: f64 = 0.5;

/// Neighbours count if their normals agree to this cosine: across an edge or a thin wall there is another surface.
const AGREEMENT: f64 = 0.7;

/// Noise and spacing of a cloud, metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quality {
    pub(super) noise: f64,
    pub(super) spacing: f64,
}

impl Quality {
    pub(super) fn of(points: &[Point], normals: &[Vector]) -> Self {
        let (noise, spacing) = noise_and_spacing(points, normals);
        Self { noise, spacing }
    }

    /// Rounds that bring the noise to where balls find their footing: none for quiet clouds, one for others.
    pub(super) fn rounds(self) -> u32 {
        u32::from(self.noise > QUIET * self.spacing)
    }

    /// Radius of the Gaussian of a round, metres: no larger than the noise asks for.
    pub(super) fn radius(self) -> f64 {
        let wanted = self.noise / (WANTED * (4.0 * std::f64::consts::PI).sqrt());
        wanted.clamp(self.spacing, WIDEST * self.spacing)
    }
}

/// The points moved along their neighbours' mean normal onto the surface of those neighbours, and those mean normals.
///
/// Neighbours weigh by a Gaussian of their distance along the surface, which does not see the noise. What one says of a point p is
/// (q − p)·(n + m)/|n + m|, n and m being the normals: for two points of a smooth surface that is zero up to the third order of the distance, where the
/// distance from the plane of q alone would draw curved surfaces inwards.
///
/// Points of a small cell that face alike are weighed as one, by their mean normal; what they say of the offset is summed exactly.
/// O(n log n): the groups round a point are some hundred at most, however many points they hold.
///
/// Kolluri, *Provably good moving least squares*, ACM Trans. Algorithms 4(2), 2008, with planes for neighbours.
///
/// * `radius` – of the Gaussian, metres
pub(super) fn projected(points: &[Point], normals: &[Vector], radius: f64) -> (Vec<Point>, Vec<Vector>) {
    if radius <= 0.0 {
        return (points.to_vec(), normals.to_vec());
    }
    let reach = (REACH * radius).powi(2);
    let groups = grouped(points, normals, GROUP * radius);
    let places: Vec<Point> = groups.iter().map(|g| g.place).collect();
    let others = Grid::new(&places, REACH * radius);
    let moved = Grid::new(points, REACH * radius).map_near(&others, &groups, |i, p, near| {
        let n = normals[i];
        let (mut mean, mut offset, mut total) = (Vector::zeros(), 0.0, 0.0);
        for group in near {
            let chord = group.place - p;
            let (squared, cosine) = (chord.norm_squared(), n.dot(&group.normals) * group.per_length);
            if squared < reach && cosine > AGREEMENT {
                // Summed over the group's points.
                let sum = chord.dot(&(n * group.count + group.normals)) + group.along;
                let sum = sum / (2.0 + 2.0 * cosine).sqrt();
                let off = sum / group.count;
                let w = bell(squared - off * off, radius);
                mean += group.normals * w;
                offset += w * sum;
                total += w * group.count;
            }
        }
        let mean = mean.try_normalize(1e-9).unwrap_or(n);
        (p + mean * (offset / total.max(f64::MIN_POSITIVE)), mean)
    });
    moved.into_iter().unzip()
}

/// Points that are near each other and face the same way.
#[derive(Clone, Copy)]
struct Group {
    /// Their mean.
    place: Point,
    count: f64,
    /// Sum of their normals.
    normals: Vector,
    /// One over its length.
    per_length: f64,
    /// Σ (q − place) · m over the points and their normals.
    along: f64,
}

/// The points by cells of the edge and by octant and largest coordinate of their normals, in a fixed order: normals of a group are at most 60° apart, so that
/// the faces of an edge stay two.
fn grouped(points: &[Point], normals: &[Vector], edge: f64) -> Vec<Group> {
    let Some(bounds) = Aabb::of(points) else { return Vec::new() };
    // Nineteen bits an axis, and one for the side.
    let edge = edge.max(bounds.size().max() / f64::from(1 << 19));
    let key = |i: usize| {
        let cell = (points[i] - bounds.min) / edge;
        let bits = |k: usize| (cell[k] as u64) << 1 | u64::from(normals[i][k] < 0.0);
        (normals[i].iamax() as u64) << 60 | bits(2) << 40 | bits(1) << 20 | bits(0)
    };
    let mut order: Vec<(u64, u32)> = (0..points.len()).into_par_iter().map(|i| (key(i), i as u32)).collect();
    order.par_sort_unstable();
    let members: Vec<&[(u64, u32)]> = order.chunk_by(|a, b| a.0 == b.0).collect();
    let group = |members: &&[(u64, u32)]| {
        let count = members.len() as f64;
        let first = points[members[0].1 as usize];
        let of = || members.iter().map(|&(_, i)| (points[i as usize], normals[i as usize]));
        let place = first + of().map(|(q, _)| q - first).sum::<Vector>() / count;
        let normals: Vector = of().map(|(_, m)| m).sum();
        let along = of().map(|(q, m)| (q - place).dot(&m)).sum();
        Group { place, count, normals, per_length: 1.0 / normals.norm(), along }
    };
    members.par_iter().with_min_len(256).map(group).collect()
}

/// (1 − d²/16r²)⁸: a Gaussian of radius r, to 0.04, for d up to 2 r. An exponential each would take a fifth of ball pivoting's time.
fn bell(squared: f64, radius: f64) -> f64 {
    let second = (1.0 - squared / (16.0 * radius * radius)).powi(2);
    let fourth = second * second;
    fourth * fourth
}

#[cfg(test)]
mod tests {
    use super::super::{BallPivotingParams, ball_pivoting};
    use super::*;
    use crate::geometry::{PointCloud, Topology};
    use crate::surface::testing::directions;

    #[test]
    fn projection_flattens_a_noisy_sheet_and_leaves_a_flat_one() {
        let noisy: Vec<Point> = (0..900)
            .map(|i| Point::new(f64::from(i % 30), f64::from(i / 30), f64::from(i * 7919 % 101) / 101.0 - 0.5))
            .collect();
        let normals = vec![Vector::z(); 900];
        let rms = |points: &[Point]| (points.iter().map(|p| p.z * p.z).sum::<f64>() / 900.0).sqrt();
        let (smooth, mean) = projected(&noisy, &normals, 1.0);
        // 1/√(4π) of the noise in the middle of the sheet, more at its border.
        assert!(rms(&smooth) < 0.4 * rms(&noisy), "{} of {}", rms(&smooth), rms(&noisy));
        assert!(smooth.iter().zip(&noisy).all(|(a, b)| a.x == b.x && a.y == b.y) && mean == normals);
        let flat: Vec<Point> = noisy.iter().map(|p| Point::new(p.x, p.y, 0.0)).collect();
        assert_eq!(projected(&flat, &normals, 1.0).0, flat);
    }

    #[test]
    fn a_sphere_does_not_shrink() {
        let normals = directions(4000);
        let points: Vec<Point> = normals.iter().map(|n| Point::from(*n)).collect();
        let spacing = (4.0 * std::f64::consts::PI / 4000.0_f64).sqrt();
        let (moved, _) = projected(&points, &normals, 2.0 * spacing);
        // Planes alone would move it by about the square of the radius: 0.006.
        assert!(moved.iter().all(|p| (p.coords.norm() - 1.0).abs() < 1e-9));
    }

    #[test]
    fn noisy_points_are_projected_before_balls_roll() {
        let cloud = {
            let normals = directions(4000);
            // Uniform within half a spacing.
            let off = |i: usize| 0.056 * ((i * 7919 % 1013) as f64 / 1012.0 - 0.5);
            let points = normals.iter().enumerate().map(|(i, n)| Point::from(n * (1.0 + off(i)))).collect();
            PointCloud::with_normals(points, normals).expect("one normal a point")
        };
        let mesh = |project| {
            let params = BallPivotingParams { project, ..BallPivotingParams::default() };
            let mesh = ball_pivoting(&cloud, &params).expect("a surface");
            let off = mesh.vertices.iter().map(|v| (v.coords.norm() - 1.0).abs()).sum::<f64>();
            (Topology::of(&mesh).boundary_edges, off / mesh.vertices.len() as f64)
        };
        let (automatic, as_they_are) = (mesh(None), mesh(Some(0)));
        assert!(automatic.0 == 0 && as_they_are.0 > 0, "{automatic:?} {as_they_are:?}");
        assert!(automatic.1 < 0.5 * as_they_are.1, "{automatic:?} {as_they_are:?}");
        assert_eq!(mesh(Some(1)), automatic);
    }

    #[test]
    fn rounds_follow_the_noise() {
        let quality = |noise| Quality { noise, spacing: 1.0 };
        assert_eq!([0.0, 0.05, 0.3, 3.0].map(|n| quality(n).rounds()), [0, 0, 1, 1]);
        assert_eq!(quality(0.0).radius(), 1.0);
        assert!((quality(0.5).radius() - 1.763).abs() < 1e-3);
        assert_eq!(quality(1e9).radius(), WIDEST);
    }

    #[test]
    fn the_faces_of_an_edge_do_not_draw_each_other() {
        let at = |i: u32| f64::from(i) * 1e-3;
        let face = |turn: &dyn Fn(f64, f64) -> Point, n: Vector| -> Vec<(Point, Vector)> {
            (0..900).map(|k| (turn(at(k % 30), at(k / 30)), n)).collect()
        };
        let mut both = face(&|u, v| Point::new(0.0, u, -v), Vector::x());
        both.extend(face(&|u, v| Point::new(-v, u, 0.0), Vector::z()));
        let (points, normals): (Vec<Point>, Vec<Vector>) = both.into_iter().unzip();
        let (moved, _) = projected(&points, &normals, 2e-3);
        let farthest = points.iter().zip(&moved).map(|(p, q)| (p - q).norm()).fold(0.0, f64::max);
        assert!(farthest < 1e-9, "{farthest}");
    }
}
