//! The symmetries of the truth: an upper bound of what any estimator of them can give, for evaluation alone.

use palpate::evidence::Evidence;
use palpate::geometry::{Bvh, Plane, Point, TriangleMesh, Vector};
use palpate::metrics::SurfaceSamples;
use palpate::symmetry::{EvidenceSearch, Hypothesis, Score, Symmetry, SymmetryElement, SymmetryEstimator};
use rayon::prelude::*;

/// Moved by an oracle's element the truth lies this close to itself, metres: a copy by it is worth having.
const TRUE: f64 = 1.5e-3;
/// From farther than this a candidate is not fitted, metres.
const NEAR: f64 = 8e-3;
/// Planes with normals closer than this are one (cosine).
const SAME: f64 = 0.99;
/// At most this many planes, as for the search.
const PLANES: usize = 4;

/// Fits the candidates of the evidence search to the true mesh and accepts those by which it lies on itself.
pub(crate) struct Oracle {
    truth: Bvh,
    samples: Vec<Point>,
    middle: Point,
}

impl Oracle {
    /// * `samples` – points of the truth that are moved
    pub(crate) fn new(truth: &TriangleMesh, samples: usize) -> Self {
        let samples = SurfaceSamples::draw(truth, samples, 1).points;
        let middle = Point::from(samples.iter().map(|p| p.coords).sum::<Vector>() / samples.len() as f64);
        Self { truth: Bvh::new(truth), samples, middle }
    }

    /// Mean distance of the moved truth to the truth, metres.
    pub(crate) fn error(&self, element: &SymmetryElement) -> f64 {
        let motions = element.motions(7);
        let distance = |p: &Point| self.truth.closest_point(p).map_or(f64::INFINITY, |s| s.distance);
        let sum: f64 = motions.iter().map(|m| self.samples.iter().map(|p| distance(&m.point(p))).sum::<f64>()).sum();
        sum / (motions.len() * self.samples.len()) as f64
    }

    /// Whether a prediction is the true element by the measure of SymmetryNet: the mean displacement between what the two make of the object's points is at
    /// most tan 15° of the greatest displacement by the true one.
    #[allow(dead_code, reason = "not every example that has an oracle asks")]
    pub(crate) fn matches(&self, predicted: &SymmetryElement, truth: &SymmetryElement) -> bool {
        if predicted.kind() != truth.kind() {
            return false;
        }
        let mut truth = *truth;
        if let (SymmetryElement::Axis { order: theirs, .. }, SymmetryElement::Axis { order: ours, .. }) =
            (&mut truth, predicted)
        {
            *theirs = *ours;
        }
        let (ours, theirs) = (predicted.motions(7), truth.motions(7));
        let (mut between, mut greatest, mut count) = (0.0, 0.0f64, 0.0);
        // Turns about opposite directions run the other way round.
        let reversed = match (predicted, &truth) {
            (SymmetryElement::Axis { direction: a, .. }, SymmetryElement::Axis { direction: b, .. }) => a.dot(b) < 0.0,
            _ => false,
        };
        for (i, true_motion) in theirs.iter().enumerate() {
            let motion = &ours[if reversed { ours.len() - 1 - i } else { i }];
            for p in &self.samples {
                between += (motion.point(p) - true_motion.point(p)).norm();
                greatest = greatest.max((true_motion.point(p) - p).norm());
                count += 1.0;
            }
        }
        between / count <= 15.0f64.to_radians().tan() * greatest
    }

    /// The best element near a candidate, and its error: pattern search over two turns and the shifts.
    pub(crate) fn fitted(&self, element: &SymmetryElement) -> (SymmetryElement, f64) {
        let (mut best, mut error) = (*element, self.error(element));
        let mut step = 8e-3;
        while step > 2e-4 {
            let neighbours =
                (0..10).filter_map(|i| changed(&best, &self.middle, i / 2, if i % 2 == 0 { step } else { -step }));
            let tried = neighbours.map(|e| (self.error(&e), e)).min_by(|a, b| a.0.total_cmp(&b.0));
            match tried {
                Some((e, element)) if e < error => (best, error) = (element, e),
                _ => step /= 2.0,
            }
        }
        (best, error)
    }
}

/// What is symmetric about the truth, by [`TRUE`]: a centre, else axes of revolution, and planes that hold none of them.
#[allow(dead_code, reason = "not every example that has an oracle asks")]
pub(crate) fn elements(oracle: &Oracle) -> Vec<SymmetryElement> {
    let center = SymmetryElement::Sphere { center: oracle.middle };
    let directions = (0..60).map(|i| {
        let z = (f64::from(i) + 0.5) / 60.0;
        let (r, a) = ((1.0 - z * z).sqrt(), 2.4 * f64::from(i));
        Vector::new(r * a.cos(), r * a.sin(), z)
    });
    let axis = |d: &Vector| SymmetryElement::Axis {
        point: oracle.middle,
        direction: nalgebra::Unit::new_normalize(*d),
        order: None,
    };
    let plane = |d: &Vector| Plane::new(*d, &oracle.middle).map(SymmetryElement::Reflection);
    let axes = directions.clone().step_by(2).map(|d| axis(&d));
    let planes = directions.filter_map(|d| plane(&d));
    let mut found: Vec<SymmetryElement> = Vec::new();
    for candidates in [vec![center], axes.collect(), planes.collect()] {
        let mut fitted: Vec<(SymmetryElement, f64)> =
            candidates.par_iter().map(|e| oracle.fitted(e)).filter(|f| f.1 < TRUE).collect();
        fitted.sort_by(|a, b| a.1.total_cmp(&b.1));
        for (element, _) in fitted {
            if !found.iter().any(|f| same(f, &element) || oracle.matches(&element, f)) {
                found.push(element);
            }
        }
    }
    found
}

/// The element with one of its parameters changed: 0 and 1 turn it about the middle (ten times `by`, radians), 2 to 4 shift it along x, y, z.
fn changed(element: &SymmetryElement, middle: &Point, parameter: usize, by: f64) -> Option<SymmetryElement> {
    let turned = |d: &Vector| {
        let across = if d.z.abs() < 0.9 { Vector::z() } else { Vector::x() };
        let (u, v) = (d.cross(&across).normalize(), d.cross(&d.cross(&across)).normalize());
        d + [u, v][parameter.min(1)] * (10.0 * by)
    };
    let shift = |p: &Point| p + Vector::ith(parameter.saturating_sub(2), by);
    match element {
        SymmetryElement::Reflection(plane) => {
            let foot = middle - plane.normal.into_inner() * plane.signed_distance(middle);
            let (n, p) = if parameter < 2 { (turned(&plane.normal), foot) } else { (*plane.normal, shift(&foot)) };
            Plane::new(n, &p).map(SymmetryElement::Reflection)
        }
        SymmetryElement::Axis { point, direction, order } => {
            let (d, p) = if parameter < 2 { (turned(direction), *point) } else { (**direction, shift(point)) };
            let direction = nalgebra::Unit::try_new(d, 1e-9)?;
            Some(SymmetryElement::Axis { point: p, direction, order: *order })
        }
        SymmetryElement::Sphere { center } => {
            (parameter >= 2).then(|| SymmetryElement::Sphere { center: shift(center) })
        }
    }
}

impl SymmetryEstimator for Oracle {
    fn estimate(&self, evidence: &Evidence) -> Symmetry {
        let found = EvidenceSearch::default().estimate(evidence);
        let candidates = found.accepted.iter().chain(&found.rejected).map(|h| &h.element);
        let mut fitted: Vec<(SymmetryElement, f64)> =
            candidates.filter(|e| self.error(e) < NEAR).map(|e| self.fitted(e)).filter(|f| f.1 < TRUE).collect();
        fitted.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut accepted: Vec<Hypothesis> = Vec::new();
        for (element, _) in fitted {
            let planes = accepted.iter().filter(|h| matches!(h.element, SymmetryElement::Reflection(_))).count();
            let known = accepted.iter().any(|h| same(&h.element, &element));
            let full = matches!(element, SymmetryElement::Reflection(_)) && planes >= PLANES;
            if !known && !full {
                let score = Score { support: 1.0, informative: 1.0, ..Score::default() };
                accepted.push(Hypothesis { element, score, confidence: 1.0, covariance: None, rejection: None });
            }
        }
        Symmetry { accepted, rejected: Vec::new() }
    }
}

fn same(a: &SymmetryElement, b: &SymmetryElement) -> bool {
    use SymmetryElement::{Axis, Reflection, Sphere};
    match (a, b) {
        (Reflection(a), Reflection(b)) => a.normal.dot(&b.normal).abs() > SAME,
        (Axis { direction: a, .. }, Axis { direction: b, .. }) => a.dot(b).abs() > SAME,
        // Of the planes that hold an axis, turns about it say all.
        (Axis { direction, .. }, Reflection(plane)) => plane.normal.dot(direction).abs() < 0.1,
        (Sphere { .. }, _) => true,
        _ => false,
    }
}
