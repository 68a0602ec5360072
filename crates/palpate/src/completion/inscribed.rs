use super::known_sides::OUTSIDE;
use super::kriging::Place;
use crate::evidence::{ContourPoint, Provenance, Sample, firsts};
use crate::geometry::{KdTree, Point, Vector};
use rayon::prelude::*;

/// Sides opposite are looked for this far from the contour, metres: a ball larger than this says "thick", not how thick.
const REACH: f64 = 60e-3;
/// Side of the cells that the contour is thinned to, metres.
const CELL: f64 = 3e-3;
/// Balls smaller than this are the outline's blur: diameter, metres.
const BLUR: f64 = 2e-3;
/// The side opposite to the contour faces away from it: greatest cosine between the two normals.
const TURNED: f64 = -0.3;
/// A sample, or free space, within this share of the radius shows that the ball spans two parts. Not 1: an edge beside the contour cuts the ball's rim.
const CORE: f64 = 0.6;

/// A ball inside the object that touches its surface at the occluding contour and at a sample opposite.
pub(super) struct Ball {
    center: Point,
    /// Metres: how thick the part is at `opposite`.
    pub(super) diameter: f64,
    /// The sample.
    pub(super) opposite: Place,
}

impl Ball {
    /// Whether a point is within `share` of the radius.
    pub(super) fn holds(&self, p: &Point, share: f64) -> bool {
        (p - self.center).norm() < 0.5 * share * self.diameter
    }
}

/// The balls at the contour: each shrunk until no measured sample that faces away is inside.
///
/// The camera sees a part's near side up to the contour and, beyond it, nothing: what it saw of the part ends there, so its far side begins.
/// The ball that touches the surface at the contour with the normal known there, and a side opposite, has the part's thickness for diameter,
/// if the edge between is round; if it is sharp, up to 2 / (1 + sin e) times that, seen at e above the part's plane.
///
/// # References
/// Ma, Bae & Choi, *3D medial axis point approximation using nearest neighbors and the normal field*, The Visual Computer 28, 2012,
/// eq. 1. Departure: samples of the same side do not shrink the ball, as their noise would; they may only forbid it.
///
/// * `free` – positive in free space, metres
///
/// O(cells of the contour · samples within 60 mm).
pub(super) fn inscribed_balls(
    contour: &[ContourPoint],
    samples: &[Sample],
    free: impl Fn(&Point) -> f64 + Sync,
) -> Vec<Ball> {
    let samples: Vec<&Sample> = samples.iter().filter(|s| !matches!(s.provenance, Provenance::Moved { .. })).collect();
    let points: Vec<Point> = samples.iter().map(|s| s.position).collect();
    let tree = KdTree::new(&points);
    let contour = firsts(contour.iter(), CELL, |c| (c.position, c.normal));
    let ball = |c: &ContourPoint| {
        let diameter = |i: usize| {
            let (s, d) = (samples[i], c.position - samples[i].position);
            let depth = d.dot(&c.normal);
            let opposite = depth > 0.0 && c.normal.dot(&s.normal) < TURNED;
            opposite.then(|| (i, d.norm_squared() / depth))
        };
        let near = tree.within(&c.position, REACH).into_iter();
        let (i, diameter) = near.filter_map(|(i, _)| diameter(i)).min_by(|a, b| a.1.total_cmp(&b.1))?;
        let ball = Ball {
            center: c.position - c.normal * (0.5 * diameter),
            diameter,
            opposite: (samples[i].position, samples[i].normal),
        };
        let core = CORE * 0.5 * diameter;
        let crossed = tree.nearest_n(&ball.center, 1).iter().any(|(_, distance)| *distance < core);
        let steps = [Vector::zeros(), Vector::x(), Vector::y(), Vector::z()].map(|d| d * core);
        let outside = || steps.iter().any(|d| free(&(ball.center + d)).max(free(&(ball.center - d))) > OUTSIDE);
        (diameter > BLUR && !crossed && !outside()).then_some(ball)
    };
    contour.par_iter().filter_map(ball).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::testing::{Solid, view};
    use crate::evidence::{Evidence, EvidenceParams, thinned};

    fn diameters(solid: Solid) -> Vec<f64> {
        let (frame, visible) = view(&[solid], 0.0);
        let evidence = Evidence::gather(&frame, &visible, &[], &EvidenceParams::default()).expect("it is seen");
        let free = |p: &Point| evidence.free_space.signed_distance(p);
        let balls = inscribed_balls(&evidence.contour, &thinned(evidence.samples.iter(), 3e-3), free);
        let mut diameters: Vec<f64> = balls.iter().map(|b| b.diameter).collect();
        diameters.sort_unstable_by(f64::total_cmp);
        diameters
    }

    #[test]
    fn balls_at_the_edge_of_a_board_are_about_as_thick_as_it_is() {
        for thickness in [0.006, 0.012] {
            let half = Vector::new(0.05, 0.04, 0.5 * thickness);
            let found = diameters(Solid::Box(Point::new(0.0, 0.0, 0.04), half, 0.3));
            assert!(found.len() > 20, "{} balls", found.len());
            // At a sharp edge, seen from 45°, the ball stands out of the wall beside it: 1.17 times the thickness.
            let (low, high) = (found[found.len() / 10], found[found.len() * 9 / 10]);
            assert!(low > 0.8 * thickness && high < 1.4 * thickness, "{low}, {high} for {thickness}");
        }
    }

    #[test]
    fn a_block_holds_no_small_ball() {
        let found = diameters(Solid::Box(Point::new(0.0, 0.0, 0.025), Vector::new(0.05, 0.04, 0.025), 0.3));
        assert!(!found.is_empty(), "no ball at all");
        assert!(found.iter().all(|d| *d > 0.03), "{:?}", &found[..found.len().min(5)]);
    }

    #[test]
    fn no_ball_spans_free_space() {
        // A sample that faces down and one 20 mm above it that faces up: of one part, or of two with a gap between.
        let at = |z: f64, up: f64| (Point::new(0.0, 0.0, z), Vector::z() * up);
        let (below, above) = (at(0.04, -1.0), at(0.06, 1.0));
        let contour = [ContourPoint { position: below.0, normal: below.1 }];
        let (position, normal) = above;
        let samples = [Sample { position, normal, sigma: 1e-3, provenance: Provenance::Seen }];
        let balls = |free: fn(&Point) -> f64| inscribed_balls(&contour, &samples, free).len();
        assert_eq!(balls(|_| -1.0), 1);
        assert_eq!(balls(|p| if (p.z - 0.05).abs() < 2e-3 { 2e-3 } else { -1.0 }), 0, "a gap in the middle");
        assert_eq!(balls(|p| if p.x > 5e-3 { p.x - 4e-3 } else { -1.0 }), 0, "free beside the middle");
        assert_eq!(
            balls(|p| if p.z > 0.058 { p.z - 0.058 } else { -1.0 }),
            1,
            "at its rim a ball may be in free space"
        );
    }
}
