use super::element::SymmetryElement;
use super::score::{BLOCK, Scorer, Tolerances};

/// An element whose score is behind another's by this over the root of the votes counted is clearly worse: three σ of the difference of two
/// means over the same votes, of elements that are near one another.
const BEHIND: f64 = 0.6;

/// The score of an element on ever more votes.
pub(super) struct Course {
    /// On all of them.
    pub(super) value: f64,
    /// After every [`BLOCK`].
    parts: Vec<f64>,
}

impl Scorer<'_> {
    /// How the score of an element goes as votes are counted. Once it is clearly behind `best`, as far as that went, the rest is taken to be as
    /// far behind.
    pub(super) fn course(
        &self,
        element: &SymmetryElement,
        tolerances: &Tolerances,
        count: usize,
        best: Option<&Course>,
    ) -> Course {
        let mut parts = Vec::with_capacity(count / BLOCK + 1);
        let mut behind = 0.0;
        let score = self.score_while(element, tolerances, count, |votes, value| {
            behind = best.and_then(|b| b.parts.get(parts.len())).map_or(0.0, |b| b - value);
            parts.push(value);
            behind < BEHIND / (votes as f64).sqrt()
        });
        // Without another nothing is given up.
        let value = score.map_or_else(|| best.map_or(0.0, |b| b.value) - behind, |s| s.value());
        Course { value, parts }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::testing::{Solid, view};
    use crate::evidence::{Evidence, EvidenceParams};
    use crate::geometry::{Plane, Point, Vector};
    use crate::symmetry::SymmetryParams;

    #[test]
    fn an_element_that_is_clearly_worse_is_given_up_and_stays_worse() {
        let center = Point::new(0.0, 0.0, 0.03);
        let (frame, visible) = view(&[Solid::Box(center, Vector::new(0.045, 0.025, 0.03), 0.8)], 0.0);
        let evidence = Evidence::gather(&frame, &visible, &[], &EvidenceParams::default()).expect("the box is seen");
        let upright = |yaw: f64, shift: f64| {
            let n = Vector::new(yaw.cos(), yaw.sin(), 0.0);
            SymmetryElement::Reflection(Plane::new(n, &(center + n * shift)).expect("a direction"))
        };
        let params = SymmetryParams::default();
        let scorer = Scorer::new(&evidence, &params);
        let (fine, votes) = (Tolerances::fine(&params), params.refine_samples.min(scorer.votes.len()));
        let course = |element: &SymmetryElement, best: Option<&Course>| scorer.course(element, &fine, votes, best);
        let right = course(&upright(0.8, 0.0), None);
        assert_eq!(right.value, scorer.score(&upright(0.8, 0.0), &fine, votes).value());
        assert_eq!(right.parts.len(), votes.div_ceil(BLOCK));
        let near = course(&upright(0.801, 0.0), Some(&right));
        assert_eq!(near.value, scorer.score(&upright(0.801, 0.0), &fine, votes).value(), "counted to the end");
        let wrong = course(&upright(1.2, 0.01), Some(&right));
        assert!(wrong.parts.len() < right.parts.len() / 2, "{} of {} parts", wrong.parts.len(), right.parts.len());
        assert!(wrong.value < right.value - 0.05, "{} for {}", wrong.value, right.value);
    }
}
