use super::element::{Motion, SymmetryElement};
use super::params::SymmetryParams;
use super::score::{Scorer, Tolerances};
use crate::evidence::{Evidence, Sample};
use crate::geometry::PointCloud;

/// Motions of an axis or a sphere that are shown.
const TURNS: u32 = 7;

/// What the evidence says of one moved sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It lands on a measured surface that faces the same way.
    Supports,
    /// It lands in proven free space.
    Violates,
    /// It lands beside a measured surface that faces the same way, not on it.
    Contradicts,
    /// It lands where nothing is known.
    Neutral,
}

impl Verdict {
    /// The colour it is shown in, sRGB: green, red, orange, blue grey.
    pub fn color(self) -> [u8; 3] {
        match self {
            Self::Supports => [62, 158, 92],
            Self::Violates => [200, 40, 44],
            Self::Contradicts => [236, 148, 58],
            Self::Neutral => [140, 156, 176],
        }
    }
}

/// The samples that vote, moved by an element (an axis: a seventh turn at a time), and what the evidence says of each, in the tolerances
/// of acceptance. O(samples · motions).
pub fn verdicts(evidence: &Evidence, element: &SymmetryElement, params: &SymmetryParams) -> Vec<(Sample, Verdict)> {
    let scorer = Scorer::new(evidence, params);
    let tolerances = Tolerances::fine(params);
    let judged = |motion: &Motion, s: &Sample| {
        let moved = Sample { position: motion.point(&s.position), normal: motion.vector(&s.normal), ..*s };
        let score = scorer.of_one(s, &moved.position, &moved.normal, &tolerances);
        let verdict = if score.violation > 0.0 {
            Verdict::Violates
        } else if score.support > 0.0 {
            Verdict::Supports
        } else if score.contradiction > 0.0 {
            Verdict::Contradicts
        } else {
            Verdict::Neutral
        };
        (moved, verdict)
    };
    let motions = element.motions(TURNS);
    motions.iter().flat_map(|motion| scorer.votes.iter().map(move |s| judged(motion, s))).collect()
}

/// The moved samples as a cloud, coloured by verdict.
pub fn verdict_cloud(verdicts: &[(Sample, Verdict)]) -> PointCloud {
    PointCloud {
        points: verdicts.iter().map(|(s, _)| s.position).collect(),
        normals: Some(verdicts.iter().map(|(s, _)| s.normal).collect()),
        colors: Some(verdicts.iter().map(|(_, v)| v.color()).collect()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::EvidenceParams;
    use crate::evidence::testing::{Solid, view};
    use crate::geometry::{Plane, Point, Vector};

    fn shares(offset: f64) -> [f64; 4] {
        let center = Point::new(0.0, 0.0, 0.03);
        let (frame, visible) = view(&[Solid::Box(center, Vector::new(0.025, 0.045, 0.03), 0.0)], 0.0);
        let evidence = Evidence::gather(&frame, &visible, &[], &EvidenceParams::default()).expect("the box is seen");
        let plane = Plane::new(Vector::y(), &(center + Vector::y() * offset)).expect("it has a direction");
        let found = verdicts(&evidence, &SymmetryElement::Reflection(plane), &SymmetryParams::default());
        let cloud = verdict_cloud(&found);
        assert!(cloud.len() == found.len() && cloud.colors.is_some_and(|c| c[0] == found[0].1.color()));
        [Verdict::Supports, Verdict::Violates, Verdict::Contradicts, Verdict::Neutral]
            .map(|v| found.iter().filter(|f| f.1 == v).count() as f64 / found.len() as f64)
    }

    #[test]
    fn a_right_plane_is_supported_and_a_shifted_one_violates_free_space() {
        let right = shares(0.0);
        assert!(right[0] > 0.6 && right[1] < 0.01 && right[2] < 0.02, "{right:?}");
        let shifted = shares(0.012);
        assert!(shifted[1] > 0.2, "{shifted:?}");
    }
}
