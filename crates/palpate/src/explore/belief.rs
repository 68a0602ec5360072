use super::hypotheses::Mode;
use super::{BeliefParams, ExploreError, SurfaceUncertainty};
use crate::geometry::{Point, TriangleMesh, Vector};
use crate::metrics::SurfaceSamples;
use crate::pipeline::{ReconstructParams, Reconstruction};
use crate::scene::Scene;
use nalgebra::{DMatrix, DVector};

/// What is believed of the surface's error: a Gaussian field over points of the mesh, along their normals.
///
/// Prior covariance: K(u, v) = σ(u) σ(v) exp(−|u − v|² / 2ℓ²) ((1 + n_u·n_v) / 2)³ + Σ_h p_h δ_h(u) δ_h(v): an error that fades with distance,
/// and one that moves the surface as a whole, from the current one to that of hypothesis h. Every factor is positive definite, so their
/// product is (Schur); max(0, n_u·n_v), which the cube is close to, is not.
pub struct Belief {
    points: Vec<Point>,
    normals: Vec<Vector>,
    covariance: DMatrix<f64>,
    /// √Σ p δ² at each point.
    disagreement: Vec<f64>,
    /// σ of the prior without hypotheses.
    local: Vec<f64>,
    touch_variance: f64,
    /// Area of the surface, m².
    area: f64,
    reach: f64,
}

/// What a touch is expected to give.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Gain {
    /// Expected decrease of the surface's mean distance from the truth, metres.
    pub mean_distance: f64,
    /// Area over which σ falls by more than a third, m².
    pub area: f64,
    /// Largest σ under the pad before the touch, metres.
    pub sigma: f64,
    /// Largest disagreement of the hypotheses under the pad, metres.
    pub disagreement: f64,
}

impl Belief {
    /// The belief after a reconstruction, with the library's own uncertainty or another.
    ///
    /// Solves the surface again for a few other sets of symmetries.
    ///
    /// # Errors
    /// [`ExploreError::Metrics`] if the mesh has no surface.
    pub fn new(
        scene: &Scene,
        current: &Reconstruction,
        params: &ReconstructParams,
        belief: &BeliefParams,
        uncertainty: &dyn SurfaceUncertainty,
    ) -> Result<Self, ExploreError> {
        let (points, normals, area) = carriers(&current.mesh, belief.spacing)?;
        let local = uncertainty.sigma(&points, &normals);
        let modes = super::hypotheses::modes(scene, current, params, belief, (&points, &normals));
        Ok(Self::from_parts(points, normals, area, local, &modes, belief))
    }

    pub(super) fn from_parts(
        points: Vec<Point>,
        normals: Vec<Vector>,
        area: f64,
        local: Vec<f64>,
        modes: &[Mode],
        params: &BeliefParams,
    ) -> Self {
        let two_l2 = 2.0 * params.correlation_length.powi(2);
        let n = points.len();
        let mut covariance = DMatrix::from_fn(n, n, |i, j| {
            let alike = (0.5 + 0.5 * normals[i].dot(&normals[j])).powi(3);
            local[i] * local[j] * alike * (-(points[i] - points[j]).norm_squared() / two_l2).exp()
        });
        let mut disagreement = vec![0.0; n];
        for mode in modes {
            let delta = DVector::from_column_slice(&mode.offsets);
            let weight = params.hypotheses * mode.probability;
            covariance.ger(weight, &delta, &delta, 1.0);
            disagreement.iter_mut().zip(&mode.offsets).for_each(|(d, o)| *d += weight * o * o);
        }
        let disagreement = disagreement.into_iter().map(f64::sqrt).collect();
        let touch_variance = params.touch_sigma.powi(2);
        Self { points, normals, covariance, disagreement, local, touch_variance, area, reach: 1.5 * params.spacing }
    }

    /// Points that carry the belief.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// σ at each point, metres.
    pub fn sigma(&self) -> Vec<f64> {
        self.covariance.diagonal().iter().map(|v| v.max(0.0).sqrt()).collect()
    }

    /// What a touch with this footprint is expected to give.
    ///
    /// σ'² = K_vv − K_vF (K_FF + s² I)⁻¹ K_Fv; gain = √(2/π) · mean over the area of (σ − σ'), the decrease of E|error|.
    pub fn gain(&self, footprint: &[Point], normal: &Vector) -> Gain {
        let under = self.under(footprint, normal);
        let Some(explained) = self.explained(&under) else { return Gain::default() };
        let mut gain = Gain::default();
        for (i, e) in explained.iter().enumerate() {
            let before = self.covariance[(i, i)].max(0.0);
            let after = (before - e).max(0.0);
            gain.mean_distance += before.sqrt() - after.sqrt();
            gain.area += if after.sqrt() < before.sqrt() * 2.0 / 3.0 { 1.0 } else { 0.0 };
        }
        let n = self.points.len() as f64;
        gain.mean_distance *= std::f64::consts::FRAC_2_PI.sqrt() / n;
        gain.area *= self.area / n;
        gain.sigma = under.iter().map(|&i| self.covariance[(i, i)].max(0.0).sqrt()).fold(0.0, f64::max);
        gain.disagreement = under.iter().map(|&i| self.disagreement[i]).fold(0.0, f64::max);
        gain
    }

    /// Takes a touch as made: what it would tell is known from now on.
    pub fn condition(&mut self, footprint: &[Point], normal: &Vector) {
        let Some(whitened) = self.whitened(&self.under(footprint, normal)) else { return };
        // In this form the posterior stays symmetric and no rounding grows from touch to touch.
        self.covariance.gemm_tr(-1.0, &whitened, &whitened, 1.0);
    }

    /// σ of the prior without the hypotheses at the point nearest to `p`, metres.
    pub fn local_sigma(&self, p: &Point) -> f64 {
        let nearest = (0..self.points.len())
            .min_by(|&a, &b| (self.points[a] - p).norm_squared().total_cmp(&(self.points[b] - p).norm_squared()));
        nearest.map_or(0.0, |i| self.local[i])
    }

    /// Carriers under the pad: for each point of the footprint the nearest that faces alike.
    fn under(&self, footprint: &[Point], normal: &Vector) -> Vec<usize> {
        let nearest = |p: &Point| {
            let alike = (0..self.points.len()).filter(|&i| self.normals[i].dot(normal) > 0.3);
            let distance = |i: usize| (self.points[i] - p).norm_squared();
            let best = alike.min_by(|&a, &b| distance(a).total_cmp(&distance(b)))?;
            (distance(best) < self.reach.powi(2)).then_some(best)
        };
        let mut under: Vec<usize> = footprint.iter().filter_map(nearest).collect();
        under.sort_unstable();
        under.dedup();
        under
    }

    /// Variance of each carrier that an observation of `under` explains.
    fn explained(&self, under: &[usize]) -> Option<Vec<f64>> {
        Some(self.whitened(under)?.column_iter().map(|column| column.norm_squared()).collect())
    }

    /// L⁻¹ K_Fv with L Lᵀ = K_FF + s²: its square is what an observation of F = `under` explains. `None` where nothing is under the pad.
    fn whitened(&self, under: &[usize]) -> Option<DMatrix<f64>> {
        if under.is_empty() {
            return None;
        }
        let across = self.covariance.select_rows(under);
        let mut block = across.select_columns(under);
        for i in 0..under.len() {
            block[(i, i)] += self.touch_variance;
        }
        block.cholesky()?.l().solve_lower_triangular(&across)
    }
}

/// Points about `spacing` apart over the surface with outward normals, and the surface's area. 200 to 1200 of them.
fn carriers(mesh: &TriangleMesh, spacing: f64) -> Result<(Vec<Point>, Vec<Vector>, f64), ExploreError> {
    let area = mesh.area();
    let count = ((area / (spacing * spacing)) as usize).clamp(200, 1200);
    let samples = SurfaceSamples::draw(mesh, count, 0);
    if samples.is_empty() {
        return Err(crate::metrics::MetricsError::NoSurface { what: "reconstructed", faces: mesh.faces.len() }.into());
    }
    let normals = samples.faces.iter().map(|&f| mesh.face_normal(f)).collect();
    Ok((samples.points, normals, area))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::Solid;

    /// The belief over a solid of which only the top was measured, with one hypothesis that moves a side.
    fn belief(solid: &str) -> Belief {
        let mesh = Solid::named(solid).expect("listed").mesh(2e-5, 4e-3);
        let params = BeliefParams::default();
        let (points, normals, area) = carriers(&mesh, params.spacing).expect("it has faces");
        let local = points.iter().map(|p| 0.5e-3 + 0.15 * (0.06 - p.z).max(0.0)).collect();
        let offsets = normals.iter().map(|n| 4e-3 * n.x.max(0.0)).collect();
        let modes = [Mode { probability: 0.1, offsets }];
        Belief::from_parts(points, normals, area, local, &modes, &params)
    }

    #[test]
    fn the_prior_is_a_covariance() {
        for solid in ["tabbed-box", "sphere", "bracket"] {
            let belief = belief(solid);
            let least = belief.covariance.clone().symmetric_eigenvalues().min();
            assert!(least > -1e-12 * belief.covariance.trace(), "{solid}: {least:e}");
        }
    }

    #[test]
    fn gains_do_not_grow_along_a_list_until_all_is_known() {
        for solid in ["tabbed-box", "sphere", "bracket"] {
            let mut belief = belief(solid);
            let places: Vec<(Point, Vector)> =
                belief.points.iter().copied().zip(belief.normals.iter().copied()).collect();
            let pad = |(p, _): &(Point, Vector)| -> Vec<Point> {
                places.iter().map(|(q, _)| *q).filter(|q| (q - p).norm() < 9e-3).collect()
            };
            let mut gains: Vec<f64> = Vec::new();
            for _ in 0..60 {
                let each = places.iter().map(|place| (belief.gain(&pad(place), &place.1).mean_distance, place));
                let (gain, best) = each.max_by(|a, b| a.0.total_cmp(&b.0)).expect("there are places");
                gains.push(gain);
                belief.condition(&pad(best), &best.1);
            }
            let grown = gains.windows(2).map(|g| g[1] / g[0]).fold(0.0, f64::max);
            assert!(grown < 1.05 && gains[59] < 0.1 * gains[0], "{solid}: {gains:?}");
            assert!(belief.covariance.diagonal().min() > -1e-12, "{solid}");
        }
    }
}
