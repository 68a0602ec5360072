use crate::evidence::Sample;
use crate::geometry::{KdTree, Point};
use rayon::prelude::*;

/// The thinnest and thickest part whose far side is guessed, metres.
pub(super) const THINNEST: f64 = 8e-4;
pub(super) const THICKEST: f64 = 20e-3;
/// The far side faces away: greatest cosine between the two normals.
const AWAY: f64 = -0.7;
/// A sample this near to the line through another, straight into the body, is on that line, metres.
const WIDTH: f64 = 2.5e-3;
/// Sides farther than this are not looked for, metres, and the steps in which they are, as a share of the distance.
const FARTHEST: f64 = 0.15;
const STRIDE: f64 = 0.15;
/// Side of the cells that samples are thinned to, metres.
pub(super) const CELL: f64 = 3e-3;
/// Two thicknesses that differ by more than this factor are not of one part: beside a sample whose other side is known to be elsewhere there is
/// no guess.
const OTHERWISE: f64 = 2.5;
/// How far from such a sample, metres.
const BESIDE: f64 = 6e-3;
/// A surface is flat as far as its normals agree by this cosine.
pub(super) const FLAT: f64 = 0.8;

/// Whether two thicknesses are of one part.
pub(super) fn similar(a: f64, b: f64) -> bool {
    (a / b).ln().abs() < OTHERWISE.ln()
}

/// The other side of a sample's part.
#[derive(Clone, Copy)]
pub(super) struct Side {
    /// How far it is, metres; more than [`THICKEST`] for "thick".
    pub(super) depth: f64,
    /// Whether one of the two was felt: of two sides that were seen or guessed, one is often the outline's blur or a wrong guess.
    pub(super) felt: bool,
}

/// Samples, what is near them and what is behind them.
pub(super) struct KnownSides {
    pub(super) samples: Vec<Sample>,
    pub(super) tree: KdTree,
    /// The other side of each sample's part, where it is known.
    pub(super) sides: Vec<Option<Side>>,
}

impl KnownSides {
    pub(super) fn new(samples: Vec<Sample>) -> Self {
        let points: Vec<Point> = samples.iter().map(|s| s.position).collect();
        let mut known = Self { tree: KdTree::new(&points), samples, sides: Vec::new() };
        known.sides = known.samples.par_iter().map(|s| known.far_side(s)).collect();
        known
    }

    /// The next surface straight into the body that faces away; `None` where no other side is known.
    fn far_side(&self, s: &Sample) -> Option<Side> {
        let mut best: Option<Side> = None;
        let mut searched = 0.0;
        while searched < FARTHEST && best.is_none_or(|b| b.depth > searched) {
            // A ball round the next piece of the line, as wide as that is.
            let half = 0.5 * (STRIDE * searched).max(WIDTH);
            let middle = s.position - s.normal * (searched + half);
            searched += 2.0 * half;
            for (i, _) in self.tree.within(&middle, half.hypot(WIDTH)) {
                let other = &self.samples[i];
                let d = other.position - s.position;
                let depth = -d.dot(&s.normal);
                let beside = (d + s.normal * depth).norm();
                let away = other.normal.dot(&s.normal) < AWAY;
                if away
                    && (0.5 * THINNEST..FARTHEST).contains(&depth)
                    && beside < WIDTH
                    && best.is_none_or(|b| depth < b.depth)
                {
                    best = Some(Side { depth, felt: s.is_felt() || other.is_felt() });
                }
            }
        }
        best
    }

    /// Whether a sample beside `s` shows that the other side, known there, is not at `depth`.
    pub(super) fn is_otherwise(&self, s: &Sample, depth: f64) -> bool {
        self.tree.within(&s.position, BESIDE).into_iter().any(|(i, _)| {
            let same = self.samples[i].normal.dot(&s.normal) > FLAT;
            same && self.sides[i].is_some_and(|side| !similar(side.depth, depth))
        })
    }

    /// Whether the surface hardly turns within `radius` of a sample; what lies as deep as half of that is another side.
    pub(super) fn is_flat(&self, s: &Sample, radius: f64) -> bool {
        self.tree.within(&s.position, radius).into_iter().all(|(i, _)| {
            let other = &self.samples[i];
            other.normal.dot(&s.normal) > FLAT || (other.position - s.position).dot(&s.normal) < -0.5 * radius
        })
    }
}
