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
/// A place this deep in free space is outside, metres: less is the outline's blur.
pub(super) const OUTSIDE: f64 = 1e-3;
/// The line is searched for free space from here on, metres, in steps of this share of the distance, but no shorter than `OUTSIDE`.
const BELOW: f64 = 1.5e-3;
const STEP: f64 = 0.1;
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
    /// Whether a sample's part is known to be thin though its other side is not known: there is free space close behind it.
    pub(super) ends: Vec<bool>,
}

impl KnownSides {
    /// * `free` – positive in free space, metres
    pub(super) fn new(samples: Vec<Sample>, free: impl Fn(&Point) -> f64 + Sync) -> Self {
        let points: Vec<Point> = samples.iter().map(|s| s.position).collect();
        let mut known = Self { tree: KdTree::new(&points), samples, sides: Vec::new(), ends: Vec::new() };
        let behind = known.samples.par_iter().map(|s| known.behind(s, &free));
        (known.sides, known.ends) = behind.unzip();
        known
    }

    /// What is known straight behind a sample: the other side of its part, or that the part ends before.
    fn behind(&self, s: &Sample, free: impl Fn(&Point) -> f64) -> (Option<Side>, bool) {
        let side = self.far_side(s);
        let out = into_free_space(s, side.map_or(THICKEST, |side| side.depth - BELOW), free);
        (side.filter(|_| out.is_none()), out.is_some_and(|depth| depth < THICKEST))
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

/// The depth at which the line straight into the body comes out of it, if it does within that depth.
fn into_free_space(s: &Sample, within: f64, free: impl Fn(&Point) -> f64) -> Option<f64> {
    let next = |t: &f64| Some(t + (STEP * t).max(OUTSIDE));
    let mut depths = std::iter::successors(Some(BELOW), next).take_while(|t| *t < within);
    depths.find(|t| free(&(s.position - s.normal * *t)) > OUTSIDE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Provenance;
    use crate::geometry::Vector;

    /// A level square, 30 mm wide, that faces up (+1) or down (−1).
    fn level(height: f64, up: f64) -> impl Iterator<Item = Sample> {
        (0..100).map(move |k| {
            let position = Point::new(f64::from(k % 10) * 3e-3, f64::from(k / 10) * 3e-3, height);
            Sample { position, normal: Vector::z() * up, sigma: 1e-3, provenance: Provenance::Seen }
        })
    }

    /// What is known behind the middle of the uppermost square.
    fn behind(samples: impl Iterator<Item = Sample>, free: impl Fn(&Point) -> f64 + Sync) -> (Option<f64>, bool) {
        let known = KnownSides::new(samples.collect(), free);
        (known.sides[55].map(|side| side.depth), known.ends[55])
    }

    #[test]
    fn the_next_surface_that_faces_away_is_the_other_side() {
        let (depth, ends) = behind(level(0.1, 1.0).chain(level(0.088, -1.0)).chain(level(0.05, -1.0)), |_| -1.0);
        assert!((depth.expect("a side") - 0.012).abs() < 1e-12 && !ends, "{depth:?}, {ends}");
        assert_eq!(behind(level(0.1, 1.0), |_| -1.0), (None, false), "nothing is known behind it");
    }

    #[test]
    fn beyond_free_space_is_another_part() {
        // A wing over the tailplane: of both the camera sees the top, and between them it sees through.
        let tail = || level(0.1, 1.0).chain(level(0.04, -1.0));
        let between = |at: std::ops::Range<f64>| move |p: &Point| if at.contains(&p.z) { 5e-3 } else { -5e-3 };
        assert_eq!(behind(tail(), between(0.05..0.09)), (None, true), "it ends within 10 mm");
        assert_eq!(behind(tail(), between(0.05..0.07)), (None, false), "it ends, but 30 mm behind it may be thick");
        assert_eq!(behind(level(0.1, 1.0), between(0.05..0.07)), (None, false));
        let (depth, _) = behind(tail(), between(0.0..0.03));
        assert!(depth.is_some(), "what is free behind the other side does not matter");
    }
}
