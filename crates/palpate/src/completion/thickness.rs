use super::inscribed::Ball;
use super::known_sides::{KnownSides, Side, THICKEST, THINNEST};
use super::kriging::{Grid, Kriging, Place};
use crate::evidence::Sample;

/// Fewer known thicknesses than this prove no thin part.
const LEAST: usize = 12;
/// In the logarithm of the thickness.
const GRID: Grid = Grid {
    sigmas: &[0.15, 0.3, 0.6, 1.2],
    lengths: &[20e-3, 40e-3, 80e-3, 160e-3],
    noises: &[0.08, 0.16, 0.3],
    usual: 0.5,
    across: 2.0,
    facing: 2,
    or_noise: false,
};
/// Of being thin (1) or thick (0).
const THIN_GRID: Grid = Grid { sigmas: &[0.5, 1.0], noises: &[0.1, 0.2, 0.4], usual: 1.0, ..GRID };
/// Parts are thin where the process says so by this much, of 1 for thin and 0 for thick and for nothing known. A wing whose far side is not guessed
/// bulges; a body whose far side is guessed where it is thick is hollow: the latter costs more, but thick parts are seldom mistaken.
const THIN: f64 = 0.3;

/// How thick parts are, as a function of place.
pub(super) struct Thickness {
    /// Of the logarithm of the thickness, less `usual`.
    depth: Kriging,
    /// Whether thin.
    thin: Kriging,
    usual: f64,
}

impl Thickness {
    /// From the known sides that touch took part in, the balls at the contour, and where parts are known to end; `None` if hardly any part is thin.
    pub(super) fn learn(known: &KnownSides, balls: &[Ball]) -> Option<Self> {
        let felt =
            |(s, side): (&Sample, &Option<Side>)| Some(((s.position, s.normal), side.filter(|side| side.felt)?.depth));
        let felt = known.samples.iter().zip(&known.sides).filter_map(felt);
        let all: Vec<(Place, f64)> = felt.chain(balls.iter().map(|b| (b.opposite, b.diameter))).collect();
        let mut thin: Vec<f64> = all.iter().map(|k| k.1).filter(|depth| *depth <= THICKEST).collect();
        if thin.len() < LEAST {
            return None;
        }
        let middle = thin.len() / 2;
        let usual = thin.select_nth_unstable_by(middle, f64::total_cmp).1.ln();
        let ends =
            known.samples.iter().zip(&known.ends).filter(|(_, ends)| **ends).map(|(s, _)| (s.position, s.normal));
        let is_thin = all.iter().map(|(at, d)| (*at, f64::from(*d <= THICKEST)));
        let is_thin: Vec<(Place, f64)> = is_thin.chain(ends.map(|at| (at, 1.0))).collect();
        let depth: Vec<(Place, f64)> =
            all.iter().filter(|(_, d)| *d <= THICKEST).map(|(at, d)| (*at, d.ln() - usual)).collect();
        Some(Self { depth: Kriging::fit(&depth, &GRID)?, thin: Kriging::fit(&is_thin, &THIN_GRID)?, usual })
    }

    /// The thickness at a place, metres, and how much of the process' variance is left; `None` where parts are not thin.
    pub(super) fn at(&self, place: &Place) -> Option<(f64, f64)> {
        if self.thin.mean(place) < THIN {
            return None;
        }
        let (mean, doubt) = self.depth.mean_and_doubt(place);
        let depth = (self.usual + mean).exp();
        (THINNEST..=THICKEST).contains(&depth).then_some((depth, doubt))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Provenance;
    use crate::geometry::{Point, Vector};

    #[test]
    fn free_space_close_behind_shows_that_a_part_is_thin() {
        // A board 8 mm thick, felt on both sides, and far from it a second one of which the upper side alone was seen.
        let level = |x: f64, z: f64, up: f64, provenance: Provenance| {
            (0..100).map(move |k| {
                let position = Point::new(x + f64::from(k % 10) * 3e-3, f64::from(k / 10) * 3e-3, z);
                Sample { position, normal: Vector::z() * up, sigma: 1e-4, provenance }
            })
        };
        let felt = Provenance::Felt { touch: 0 };
        let first = level(0.0, 0.1, 1.0, felt).chain(level(0.0, 0.092, -1.0, felt));
        let samples: Vec<Sample> = first.chain(level(0.4, 0.1, 1.0, Provenance::Seen)).collect();
        let middle = |x: f64| (Point::new(x + 0.015, 0.015, 0.1), Vector::z());
        let thickness = |free: fn(&Point) -> f64| {
            Thickness::learn(&KnownSides::new(samples.clone(), free), &[]).expect("a board is thin")
        };
        let closed = thickness(|_| -1.0);
        let (depth, doubt) = closed.at(&middle(0.0)).expect("the first board");
        assert!((depth - 8e-3).abs() < 5e-4 && doubt < 0.2, "{depth}, {doubt}");
        assert!(closed.at(&middle(0.4)).is_none(), "nothing is known of the second");
        let (_, doubt) = thickness(|p| if p.x > 0.3 { 0.09 - p.z } else { -1.0 }).at(&middle(0.4)).expect("the second");
        assert!(doubt > 0.9, "that it is thin is known, not how thin: {doubt}");
    }
}
