use super::{Plane, Point, Vector};
use nalgebra::{Matrix3, SymmetricEigen};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

/// Hypotheses are scored on at most this many points; the refit uses all of them.
const SCORED_POINTS: usize = 4096;

/// How a plane is searched among points that do not all lie on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneRansac {
    /// Largest distance of an inlier, metres.
    pub tolerance: f64,
    /// Most hypotheses tried.
    pub max_iterations: usize,
    /// Stop once the chance of having missed a better plane is below 1 − `confidence`.
    pub confidence: f64,
    /// Of the random draws.
    pub seed: u64,
}

impl Default for PlaneRansac {
    fn default() -> Self {
        Self { tolerance: 0.005, max_iterations: 1000, confidence: 0.9999, seed: 0 }
    }
}

/// A plane and how well points lie on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneFit {
    /// Least-squares plane of the inliers.
    pub plane: Plane,
    /// Number of points within the tolerance.
    pub inliers: usize,
    /// Robust standard deviation of the inliers about the plane (1.4826 · median absolute distance), metres.
    pub sigma: f64,
}

impl PlaneRansac {
    /// The plane with the most inliers among those that `accept` allows, refitted by least squares to its inliers.
    ///
    /// `None` if no three points span an acceptable plane. The normal's sign is arbitrary.
    ///
    /// # References
    /// Fischler & Bolles, *Random sample consensus*, CACM 24(6), 1981.
    pub fn fit(&self, points: &[Point], accept: impl Fn(&Plane) -> bool) -> Option<PlaneFit> {
        if points.len() < 3 {
            return None;
        }
        let mut rng = Pcg64Mcg::seed_from_u64(self.seed);
        let scored: Vec<Point> = if points.len() <= SCORED_POINTS {
            points.to_vec()
        } else {
            (0..SCORED_POINTS).map(|_| points[rng.random_range(0..points.len())]).collect()
        };
        let mut best: Option<(usize, Plane)> = None;
        let mut needed = self.max_iterations;
        let mut tried = 0;
        while tried < needed.min(self.max_iterations) {
            tried += 1;
            let [a, b, c] = [(); 3].map(|()| scored[rng.random_range(0..scored.len())]);
            let Some(plane) = Plane::new((b - a).cross(&(c - a)), &a).filter(&accept) else { continue };
            let inliers = scored.iter().filter(|p| plane.signed_distance(p).abs() < self.tolerance).count();
            if best.as_ref().is_none_or(|(most, _)| inliers > *most) {
                best = Some((inliers, plane));
                needed = iterations_for(inliers as f64 / scored.len() as f64, self.confidence);
            }
        }
        self.refit(points, best?.1, accept)
    }

    /// Alternates inlier selection and least squares; the tolerance shrinks to three robust σ so that a step or an
    /// object's foot within the tolerance does not tilt the plane.
    fn refit(&self, points: &[Point], start: Plane, accept: impl Fn(&Plane) -> bool) -> Option<PlaneFit> {
        let mut plane = start;
        let mut tolerance = self.tolerance;
        for _ in 0..5 {
            let near: Vec<Point> =
                points.iter().filter(|p| plane.signed_distance(p).abs() < tolerance).copied().collect();
            let Some(next) = fit_plane(&near).filter(&accept) else { break };
            plane = if next.normal.dot(&plane.normal) < 0.0 { next.flipped() } else { next };
            tolerance = (3.0 * robust_sigma(&near, &plane)).clamp(0.1 * self.tolerance, self.tolerance);
        }
        let near: Vec<Point> =
            points.iter().filter(|p| plane.signed_distance(p).abs() < self.tolerance).copied().collect();
        (near.len() >= 3).then(|| PlaneFit { plane, inliers: near.len(), sigma: robust_sigma(&near, &plane) })
    }
}

/// Draws of three needed to hit three inliers once with the given confidence.
fn iterations_for(inlier_share: f64, confidence: f64) -> usize {
    let miss = 1.0 - inlier_share.powi(3);
    if miss <= 0.0 {
        return 1;
    }
    let needed = (1.0 - confidence).ln() / miss.ln();
    if needed.is_finite() { needed.ceil() as usize } else { usize::MAX }
}

fn robust_sigma(points: &[Point], plane: &Plane) -> f64 {
    let mut distances: Vec<f64> = points.iter().map(|p| plane.signed_distance(p).abs()).collect();
    if distances.is_empty() {
        return 0.0;
    }
    let middle = distances.len() / 2;
    1.4826 * *distances.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Mean and covariance (not normalised) of points.
pub(crate) fn scatter(points: impl Iterator<Item = Point> + Clone) -> Option<(Point, Matrix3<f64>)> {
    let (count, sum) = points.clone().fold((0usize, Vector::zeros()), |(n, s), p| (n + 1, s + p.coords));
    if count == 0 {
        return None;
    }
    let mean = Point::from(sum / count as f64);
    let scatter = points.fold(Matrix3::zeros(), |m, p| m + (p - mean) * (p - mean).transpose());
    Some((mean, scatter))
}

/// The least-squares plane through points; `None` if fewer than three, or all on one line.
pub fn fit_plane(points: &[Point]) -> Option<Plane> {
    let (mean, scatter) = scatter(points.iter().copied())?;
    let eigen = SymmetricEigen::new(scatter);
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    let spread = |i: usize| eigen.eigenvalues[order[i]].max(0.0);
    if points.len() < 3 || spread(1) <= 1e-12 * spread(2) {
        return None;
    }
    Plane::new(eigen.eigenvectors.column(order[0]).into_owned(), &mean)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution as _, Normal};

    /// A tilted plane with 1 mm noise, 5 mm-high steps and 40 % outliers above it.
    fn noisy_table() -> (Plane, Vec<Point>) {
        let truth = Plane::new(Vector::new(0.1, -0.8, -0.6), &Point::new(0.0, 0.1, 0.7)).expect("a direction");
        let e1 = truth.normal.cross(&Vector::x()).normalize();
        let e2 = truth.normal.cross(&e1);
        let mut rng = Pcg64Mcg::seed_from_u64(7);
        let noise = Normal::new(0.0, 1e-3).expect("finite");
        let points = (0..10_000)
            .map(|i| {
                let (s, t) = (rng.random_range(-0.3..0.3), rng.random_range(-0.3..0.3));
                let height = if i % 5 < 3 { noise.sample(&mut rng) } else { rng.random_range(0.0..0.3) };
                Point::from(truth.normal.into_inner() * (truth.offset + height)) + e1 * s + e2 * t
            })
            .collect();
        (truth, points)
    }

    #[test]
    fn finds_a_plane_under_outliers() {
        let (truth, points) = noisy_table();
        let fit = PlaneRansac::default().fit(&points, |_| true).expect("a plane");
        assert!(
            fit.plane.normal.dot(&truth.normal).abs().acos() < 2e-3,
            "tilt {}",
            fit.plane.normal.dot(&truth.normal)
        );
        let foot = Point::from(truth.normal.into_inner() * truth.offset);
        assert!(fit.plane.signed_distance(&foot).abs() < 3e-4);
        assert!((fit.sigma - 1e-3).abs() < 2e-4, "sigma {}", fit.sigma);
        assert!((6000..6400).contains(&fit.inliers), "{} inliers", fit.inliers);
    }

    #[test]
    fn same_seed_same_plane_and_rejected_planes_are_not_returned() {
        let (truth, points) = noisy_table();
        let ransac = PlaneRansac { seed: 3, ..PlaneRansac::default() };
        assert_eq!(ransac.fit(&points, |_| true), ransac.fit(&points, |_| true));
        let other = ransac.fit(&points, |p| p.normal.dot(&truth.normal).abs() < 0.5).expect("some other plane");
        assert!(other.plane.normal.dot(&truth.normal).abs() < 0.5);
    }

    #[test]
    fn degenerate_points_span_no_plane() {
        let line: Vec<Point> = (0..50).map(|i| Point::new(i as f64, 2.0 * i as f64, 1.0)).collect();
        assert_eq!(fit_plane(&line), None);
        assert_eq!(PlaneRansac::default().fit(&line, |_| true), None);
        assert_eq!(PlaneRansac::default().fit(&[Point::origin()], |_| true), None);
        assert_eq!(fit_plane(&vec![Point::new(1.0, 1.0, 1.0); 10]), None);
    }
}
