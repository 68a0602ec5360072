//! How symmetric the truth is about an element, and the elements it is symmetric about: for evaluation alone.

use palpate::geometry::{Bvh, Plane, Point, TriangleMesh, Vector};
use palpate::metrics::SurfaceSamples;
use palpate::symmetry::SymmetryElement;
use rayon::prelude::*;

/// Moved by a true element the truth lies this close to itself, metres: a copy by it is worth having.
const TRUE: f64 = 1.5e-3;
/// Planes with normals closer than this are one (cosine).
const SAME: f64 = 0.99;

/// The true mesh, to be moved onto itself.
pub(crate) struct TrueSymmetry {
    truth: Bvh,
    pub(crate) samples: Vec<Point>,
    pub(crate) middle: Point,
}

impl TrueSymmetry {
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

    /// The elements near candidates by which the truth lies on itself, the best first, and each but once.
    pub(crate) fn fitted(&self, candidates: &[SymmetryElement]) -> Vec<SymmetryElement> {
        let mut fitted: Vec<(SymmetryElement, f64)> =
            candidates.par_iter().map(|e| self.climbed(e)).filter(|f| f.1 < TRUE).collect();
        fitted.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut distinct: Vec<SymmetryElement> = Vec::new();
        for (element, _) in fitted {
            if !distinct.iter().any(|d| implies(d, &element)) {
                distinct.push(element);
            }
        }
        distinct
    }

    /// The best element near a candidate, and its error: pattern search over two turns and the shifts.
    fn climbed(&self, element: &SymmetryElement) -> (SymmetryElement, f64) {
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

/// Whether what is symmetric about `a` need not be told that it is about `b`.
pub(crate) fn implies(a: &SymmetryElement, b: &SymmetryElement) -> bool {
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
