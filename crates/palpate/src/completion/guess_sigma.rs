use super::motion::{Copying, copyings};
use crate::evidence::Evidence;
use crate::geometry::{Plane, Point, Vector};
use crate::symmetry::{Hypothesis, Motion, Symmetry, SymmetryElement, tangents, tilted};
use nalgebra::{DMatrix, Matrix3, Vector3};
use rayon::prelude::*;

/// σ of a parameter that support leaves undetermined: radians for turns, metres for shifts.
const UNDETERMINED: [f64; 2] = [0.03, 2e-3];
/// Samples of a copy that are compared with what was measured.
const COMPARED: usize = 400;
/// A copy lands beside a measured surface, and not on another one, up to this offset, metres.
const BESIDE: f64 = 8e-3;
/// Farther along the surface than this a measured sample says nothing of a copy, metres.
const TANGENTIAL: f64 = 4e-3;
/// A sample that maps nearer to itself than this proves nothing, metres.
const ELSEWHERE: f64 = 8e-3;
/// With fewer comparisons than this the miss is unknown; then it is taken to be `UNKNOWN_MISS`, metres.
const LEAST_COMPARED: usize = 10;
const UNKNOWN_MISS: f64 = 1e-3;

/// How uncertain the copies of the evidence are: by the covariance of the symmetry, and by how far each copy misses what was measured.
pub struct GuessSigma {
    /// Per copying: how it changes with one σ of each independent parameter.
    levers: Vec<Vec<Motion>>,
    /// Per copying: robust σ of its offset from the measured surface, metres.
    misses: Vec<f64>,
}

impl GuessSigma {
    /// * `radius`, `arc` – as the `copyings` were made with
    ///
    /// O(copyings · (parameters + compared samples)).
    pub fn new(evidence: &Evidence, symmetry: &Symmetry, made: &[Copying], radius: f64, arc: f64) -> Self {
        let centroid = evidence.centroid();
        let mut levers = vec![Vec::new(); made.len()];
        for (h, hypothesis) in symmetry.accepted.iter().enumerate() {
            for d in independent_steps(hypothesis) {
                let mut moved = symmetry.clone();
                moved.accepted[h].element = perturbed(&hypothesis.element, &centroid, &d);
                let changed = copyings(&moved, radius, arc);
                if changed.len() != made.len() {
                    continue;
                }
                for ((lever, a), b) in levers.iter_mut().zip(&changed).zip(made) {
                    let linear = a.motion.linear - b.motion.linear;
                    let translation = a.motion.translation - b.motion.translation;
                    if linear != Matrix3::zeros() || translation != Vector3::zeros() {
                        lever.push(Motion { linear, translation });
                    }
                }
            }
        }
        let misses = made.par_iter().map(|c| miss(evidence, &c.motion)).collect();
        Self { levers, misses }
    }

    /// σ along `normal` of the copy of `source` (unmoved) that the covariance of the symmetry causes, metres.
    pub fn lever(&self, copying: usize, source: &Point, normal: &Vector) -> f64 {
        let along = |d: &Motion| (d.linear * source.coords + d.translation).dot(normal).powi(2);
        self.levers[copying].iter().map(along).sum::<f64>().sqrt()
    }

    /// How far the copy lies beside what was measured where both are, robust σ, metres: the object is less symmetric than the covariance says.
    pub fn miss(&self, copying: usize) -> f64 {
        self.misses[copying]
    }
}

/// The columns of the root of the covariance: independent changes of the parameters by one σ each.
fn independent_steps(hypothesis: &Hypothesis) -> Vec<[f64; 4]> {
    let (n, turns) = match hypothesis.element {
        SymmetryElement::Reflection(_) => (3, 2),
        SymmetryElement::Axis { .. } => (4, 2),
        SymmetryElement::Sphere { .. } => (3, 0),
    };
    let known = hypothesis.covariance.as_ref().filter(|c| c.shape() == (n, n) && c.iter().all(|x| x.is_finite()));
    let covariance = known.cloned().unwrap_or_else(|| {
        DMatrix::from_fn(n, n, |i, j| if i == j { UNDETERMINED[usize::from(i >= turns)].powi(2) } else { 0.0 })
    });
    let eigen = covariance.symmetric_eigen();
    (0..n)
        .map(|k| {
            let size = eigen.eigenvalues[k].max(0.0).sqrt();
            std::array::from_fn(|i| if i < n { eigen.eigenvectors[(i, k)] * size } else { 0.0 })
        })
        .collect()
}

/// The element changed by small parameters, in the order of [`Hypothesis::covariance`].
fn perturbed(element: &SymmetryElement, centroid: &Point, d: &[f64; 4]) -> SymmetryElement {
    match element {
        SymmetryElement::Reflection(plane) => {
            let foot = centroid - plane.normal.into_inner() * (plane.signed_distance(centroid) - d[2]);
            let normal = tilted(&plane.normal, d[0], d[1]);
            SymmetryElement::Reflection(Plane { normal, offset: normal.dot(&foot.coords) })
        }
        SymmetryElement::Axis { point, direction, order } => {
            let (u, v) = tangents(direction);
            let foot = point + direction.into_inner() * direction.dot(&(centroid - point));
            let point = foot + u * d[2] + v * d[3];
            SymmetryElement::Axis { point, direction: tilted(direction, d[0], d[1]), order: *order }
        }
        SymmetryElement::Sphere { center } => {
            SymmetryElement::Sphere { center: center + Vector::new(d[0], d[1], d[2]) }
        }
    }
}

/// Robust σ of the offsets of moved samples from the measured surface that they land beside.
fn miss(evidence: &Evidence, motion: &Motion) -> f64 {
    let samples = &evidence.samples;
    let step = (samples.len() / COMPARED).max(1);
    let mut offsets: Vec<f64> = samples
        .iter()
        .step_by(step)
        .filter_map(|s| {
            let (p, n) = (motion.point(&s.position), motion.vector(&s.normal));
            if (p - s.position).norm() < ELSEWHERE {
                return None;
            }
            let found = evidence.index.nearest_agreeing(samples, &p, &n, 0.5)?;
            (found.tangential < TANGENTIAL && found.plane_offset < BESIDE).then_some(found.plane_offset)
        })
        .collect();
    if offsets.len() < LEAST_COMPARED {
        return UNKNOWN_MISS;
    }
    let middle = offsets.len() / 2;
    1.4826 * *offsets.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::EvidenceParams;
    use crate::evidence::testing::{Solid, view};
    use crate::symmetry::Score;

    fn one_plane(covariance: Option<DMatrix<f64>>) -> Symmetry {
        let element = SymmetryElement::Reflection(
            Plane::new(Vector::x(), &Point::new(0.0, 0.0, 0.03)).expect("it has a direction"),
        );
        let hypothesis = Hypothesis { element, score: Score::default(), confidence: 1.0, covariance, rejection: None };
        Symmetry { accepted: vec![hypothesis], rejected: Vec::new() }
    }

    #[test]
    fn a_shift_of_the_plane_moves_the_copy_twice_as_far_and_a_turn_grows_with_the_lever() {
        let solids = [Solid::Box(Point::new(0.0, 0.0, 0.03), Vector::new(0.04, 0.025, 0.03), 0.0)];
        let (frame, visible) = view(&solids, 0.0);
        let evidence = Evidence::gather(&frame, &visible, &[], &EvidenceParams::default()).expect("the box is seen");
        let covariance = DMatrix::from_diagonal(&nalgebra::DVector::from_vec(vec![0.0, 0.0, 1e-6]));
        let symmetry = one_plane(Some(covariance));
        let made = copyings(&symmetry, 0.05, 8e-3);
        let sigma = GuessSigma::new(&evidence, &symmetry, &made, 0.05, 8e-3);
        let lever = sigma.lever(0, &Point::new(0.04, 0.01, 0.02), &-Vector::x());
        assert!((lever - 2e-3).abs() < 1e-9, "1 mm of shift gives {lever}");
        assert!(sigma.miss(0) < 5e-4, "an exact box misses itself by {}", sigma.miss(0));

        let turn = DMatrix::from_diagonal(&nalgebra::DVector::from_vec(vec![0.01f64.powi(2), 0.01f64.powi(2), 0.0]));
        let symmetry = one_plane(Some(turn));
        let sigma = GuessSigma::new(&evidence, &symmetry, &made, 0.05, 8e-3);
        let center = evidence.centroid();
        let at = |y: f64| sigma.lever(0, &Point::new(0.04, center.y + y, center.z), &-Vector::x());
        // A turn by 0.01 at the centroid moves the copy by twice the angle times the distance along the plane.
        assert!((at(0.02) - 2.0 * 0.01 * 0.02).abs() < 2e-5 && at(0.0) < 2e-5, "{} {}", at(0.02), at(0.0));
    }

    #[test]
    fn a_plane_beside_the_right_one_misses_what_was_measured() {
        let solids = [Solid::Box(Point::new(0.003, 0.0, 0.03), Vector::new(0.04, 0.025, 0.03), 0.0)];
        let (frame, visible) = crate::evidence::testing::view_from(&solids, 0.0, 1.5, 0.9);
        let evidence = Evidence::gather(&frame, &visible, &[], &EvidenceParams::default()).expect("the box is seen");
        let symmetry = one_plane(None);
        let made = copyings(&symmetry, 0.05, 8e-3);
        let sigma = GuessSigma::new(&evidence, &symmetry, &made, 0.05, 8e-3);
        assert!(sigma.lever(0, &Point::new(0.04, 0.0, 0.0), &-Vector::x()) > 3e-3, "undetermined is not certain");
    }
}
