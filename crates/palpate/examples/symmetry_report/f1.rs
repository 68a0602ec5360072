//! Precision, recall and F1 of accepted symmetries by the measure of SymmetryNet (Shi et al. 2020): a prediction is right if the mean displacement between what it and
//! the true element make of the object's points is at most tan 15° of the greatest displacement by the true one.

use crate::true_symmetry::{TrueSymmetry, implies};
use palpate::geometry::{Plane, Vector};
use palpate::symmetry::{Hypothesis, SymmetryElement};

/// Directions over the half sphere from which planes and axes are sought.
const DIRECTIONS: u32 = 60;
/// Of the candidates of a kind so many are fitted, those by which the truth is nearest to itself.
const FITTED: usize = 12;

/// What is symmetric about the truth: a centre, else axes of revolution, and planes that none of them implies.
pub(crate) fn elements(truth: &TrueSymmetry) -> Vec<SymmetryElement> {
    let directions: Vec<Vector> = (0..DIRECTIONS)
        .map(|i| {
            let z = (f64::from(i) + 0.5) / f64::from(DIRECTIONS);
            let (r, a) = ((1.0 - z * z).sqrt(), 2.4 * f64::from(i));
            Vector::new(r * a.cos(), r * a.sin(), z)
        })
        .collect();
    let axis = |d: &Vector| SymmetryElement::Axis {
        point: truth.middle,
        direction: nalgebra::Unit::new_normalize(*d),
        order: None,
    };
    let plane = |d: &Vector| Plane::new(*d, &truth.middle).map(SymmetryElement::Reflection);
    let mut found: Vec<SymmetryElement> = Vec::new();
    for mut candidates in [
        vec![SymmetryElement::Sphere { center: truth.middle }],
        directions.iter().map(axis).collect(),
        directions.iter().filter_map(plane).collect(),
    ] {
        candidates.sort_by_cached_key(|e| (truth.error(e) * 1e9) as u64);
        candidates.truncate(FITTED);
        for element in truth.fitted(&candidates) {
            if !found.iter().any(|f| implies(f, &element) || matches(truth, &element, f)) {
                found.push(element);
            }
        }
    }
    found
}

/// Whether a prediction is the true element.
fn matches(truth: &TrueSymmetry, predicted: &SymmetryElement, element: &SymmetryElement) -> bool {
    use SymmetryElement::Axis;
    let mut element = *element;
    if let (Axis { direction: theirs, order, .. }, Axis { direction: ours, order: wanted, .. }) =
        (&mut element, predicted)
    {
        // The sign of a direction has no meaning, but turns follow it.
        (*theirs, *order) = (if theirs.dot(ours) < 0.0 { -*theirs } else { *theirs }, *wanted);
    }
    if predicted.kind() != element.kind() {
        return false;
    }
    let (mut between, mut greatest) = (0.0, 0.0f64);
    let (ours, theirs) = (predicted.motions(7), element.motions(7));
    for (a, b) in ours.iter().zip(&theirs) {
        for p in &truth.samples {
            between += (a.point(p) - b.point(p)).norm();
            greatest = greatest.max((b.point(p) - p).norm());
        }
    }
    between / (ours.len() * truth.samples.len()) as f64 <= 15.0f64.to_radians().tan() * greatest
}

/// What was found of what is there.
#[derive(Default)]
pub(crate) struct Found {
    /// Of each accepted hypothesis: confidence, and whether it is right.
    predicted: Vec<(f64, bool)>,
    /// Of each true element: the confidence of the surest hypothesis that is it.
    wanted: Vec<Option<f64>>,
}

impl Found {
    /// Counts the hypotheses of a scene. What a true element implies is right, and is asked of nobody.
    pub(crate) fn add(
        &mut self,
        accepted: &[Hypothesis],
        truth: &TrueSymmetry,
        elements: &[SymmetryElement],
        right: f64,
    ) {
        for h in accepted {
            let implied = || elements.iter().any(|t| implies(t, &h.element)) && truth.error(&h.element) < right;
            let right = elements.iter().any(|t| matches(truth, &h.element, t)) || implied();
            self.predicted.push((h.confidence, right));
        }
        for t in elements {
            let finders = accepted.iter().filter(|h| matches(truth, &h.element, t)).map(|h| h.confidence);
            self.wanted.push(finders.max_by(f64::total_cmp));
        }
    }

    /// Precision, recall and F1 of what is accepted with at least this confidence.
    pub(crate) fn from(&self, least: f64) -> [f64; 3] {
        let share = |right: usize, all: usize| right as f64 / all.max(1) as f64;
        let taken: Vec<bool> = self.predicted.iter().filter(|p| p.0 >= least).map(|p| p.1).collect();
        let precision = share(taken.iter().filter(|r| **r).count(), taken.len());
        let recall = share(self.wanted.iter().filter(|w| w.is_some_and(|c| c >= least)).count(), self.wanted.len());
        [precision, recall, 2.0 * precision * recall / (precision + recall).max(1e-9)]
    }
}
