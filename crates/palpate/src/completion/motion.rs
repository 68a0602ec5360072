use crate::geometry::{Plane, Point, Vector};
use crate::symmetry::{Motion, Symmetry, SymmetryElement};
use nalgebra::Matrix3;

/// One way to copy the evidence: a motion that the accepted symmetries generate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Copying {
    /// Where things go.
    pub motion: Motion,
    /// The lowest score of the hypotheses it is made of.
    pub score: f64,
    /// Copies that stand or fall together share a family: all turns about one axis do.
    pub family: u32,
}

impl Copying {
    fn then(&self, next: &Self) -> Self {
        let score = self.score.min(next.score);
        Self { motion: self.motion.then(&next.motion), score, family: 0 }
    }
}

/// The copyings of each family, in order.
pub(super) fn families(copyings: &[Copying]) -> Vec<Vec<&Copying>> {
    let count = copyings.iter().map(|c| c.family as usize + 1).max().unwrap_or(0);
    let mut families = vec![Vec::new(); count];
    for copying in copyings {
        families[copying.family as usize].push(copying);
    }
    families
}

/// What an accepted plane counts at least: one that shows the unseen side has little support of its own.
const LEAST_SCORE: f64 = 0.3;

/// All motions that the accepted symmetries generate and the completion uses.
///
/// Planes (at most four): each one, all pairs and one triple product. A continuous axis replaces the pairs: it is taken at angles
/// about `arc` apart at radius `radius`, alone and composed with each plane perpendicular to it.
///
/// * `radius` – typical distance of the evidence from an axis, metres
/// * `arc` – wanted spacing of the copies round an axis, metres
pub fn copyings(symmetry: &Symmetry, radius: f64, arc: f64) -> Vec<Copying> {
    let mut out: Vec<Copying> = Vec::new();
    let mut push = |copying: Copying, family: u32| {
        let m = &copying.motion;
        if (m.linear - Matrix3::identity()).norm() * radius > 1e-3 || m.translation.norm() > 1e-3 {
            out.push(Copying { family, ..copying });
        }
    };
    let planes: Vec<(Plane, Copying)> = symmetry
        .accepted
        .iter()
        .filter_map(|h| match &h.element {
            SymmetryElement::Reflection(p) => Some((
                *p,
                Copying { motion: Motion::reflection(p), score: h.score.value().max(LEAST_SCORE), family: 0 },
            )),
            _ => None,
        })
        .take(4)
        .collect();
    let mut family = 0..;
    let mut next = || family.next().expect("the range is endless");
    for (_, reflection) in &planes {
        push(*reflection, next());
    }
    if let Some((axis, direction, score)) = first_axis(symmetry) {
        let copies = ((std::f64::consts::TAU * radius / arc) as u32).clamp(16, 96);
        let turns: Vec<Copying> =
            axis.motions(copies).into_iter().map(|motion| Copying { motion, score, family: 0 }).collect();
        let alone = next();
        for turn in &turns {
            push(*turn, alone);
        }
        for (plane, reflection) in &planes {
            if plane.normal.dot(&direction).abs() > 0.97 {
                let composed = next();
                for turn in &turns {
                    push(reflection.then(turn), composed);
                }
            }
        }
        return out;
    }
    for (i, (p, a)) in planes.iter().enumerate() {
        for (j, (q, b)) in planes.iter().enumerate() {
            // Perpendicular planes commute: one order is enough.
            let commute = p.normal.dot(&q.normal).abs() < 0.02;
            if i != j && !(commute && j < i) {
                push(a.then(b), next());
            }
        }
    }
    if let [(_, a), (_, b), (_, c), ..] = &planes[..] {
        push(a.then(b).then(c), next());
    }
    out
}

fn first_axis(symmetry: &Symmetry) -> Option<(SymmetryElement, Vector, f64)> {
    symmetry.accepted.iter().find_map(|h| match &h.element {
        SymmetryElement::Axis { direction, .. } => Some((h.element, direction.into_inner(), h.score.value())),
        _ => None,
    })
}

/// The reflection plane that the published method mirrors at: the best accepted one; else one through the accepted axis or centre
/// that sends the visible side to the hidden one.
///
/// * `view` – direction from the camera to the object
pub fn best_plane(symmetry: &Symmetry, view: &Vector) -> Option<Plane> {
    let through = |p: &Point, direction: Option<&Vector>| {
        let across = direction.map_or(*view, |d| view - d * d.dot(view));
        Plane::new(across, p)
    };
    let planes = symmetry.accepted.iter().filter_map(|h| match &h.element {
        SymmetryElement::Reflection(plane) => Some((*plane, h.score.value())),
        _ => None,
    });
    // The plane that shows most of the hidden side: it faces the camera, weighed by its score.
    let facing = |(p, score): &(Plane, f64)| score * p.normal.dot(&view.normalize()).abs().max(0.1);
    planes.max_by(|a, b| facing(a).total_cmp(&facing(b))).map(|p| p.0).or_else(|| {
        symmetry.accepted.iter().find_map(|h| match &h.element {
            SymmetryElement::Axis { point, direction, .. } => through(point, Some(direction)),
            SymmetryElement::Sphere { center } => through(center, None),
            SymmetryElement::Reflection(_) => None,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::symmetry::{Hypothesis, Score};

    fn symmetry(elements: &[SymmetryElement]) -> Symmetry {
        let hypothesis = |element: &SymmetryElement| Hypothesis {
            element: *element,
            score: Score { support: 1.0, informative: 0.5, ..Score::default() },
            confidence: 1.0,
            covariance: None,
            rejection: None,
        };
        Symmetry { accepted: elements.iter().map(hypothesis).collect(), rejected: Vec::new() }
    }

    fn plane(n: Vector) -> SymmetryElement {
        SymmetryElement::Reflection(Plane::new(n, &Point::origin()).expect("it has a direction"))
    }

    #[test]
    fn two_perpendicular_planes_give_a_third_copy() {
        let copies = copyings(&symmetry(&[plane(Vector::x()), plane(Vector::y())]), 0.05, 8e-3);
        assert_eq!(copies.len(), 3);
        let p = Point::new(0.1, 0.2, 0.3);
        assert!((copies[2].motion.point(&p) - Point::new(-0.1, -0.2, 0.3)).norm() < 1e-12);
    }

    #[test]
    fn an_axis_sweeps_and_composes_with_the_plane_across_it() {
        let axis = SymmetryElement::Axis { point: Point::origin(), direction: Vector::z_axis(), order: None };
        let copies = copyings(&symmetry(&[axis, plane(Vector::z()), plane(Vector::x())]), 0.05, 8e-3);
        // 39 angles: 38 turns, each also with the plane across; two reflections.
        assert_eq!(copies.len(), 2 * 38 + 2);
        assert_eq!(best_plane(&symmetry(&[axis]), &Vector::new(1.0, 0.0, -1.0)).map(|p| p.normal.x.abs()), Some(1.0));
    }
}
