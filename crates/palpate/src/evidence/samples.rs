use crate::geometry::{Point, Vector};
use std::collections::BTreeMap;

/// Where a sample comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Provenance {
    /// Measured by the camera.
    Seen,
    /// Measured by touch number `touch`.
    Felt {
        /// Index of the touch in the order taken.
        touch: u32,
    },
    /// A measured sample moved by a symmetry: a guess.
    Moved {
        /// Index of the motion in the orbit.
        motion: u32,
    },
}

/// The cell of side `size` that holds a point, and the rounded direction of its normal: both sides of a thin wall keep apart.
pub(crate) fn cell_and_side(p: &Point, normal: &Vector, size: f64) -> [i32; 6] {
    let cell = |a: usize| (p[a] / size).floor() as i32;
    let side = |a: usize| normal[a].round() as i32;
    [cell(0), cell(1), cell(2), side(0), side(1), side(2)]
}

/// The first sample of each cell and side, ordered by them.
pub(crate) fn thinned<'a>(samples: impl Iterator<Item = &'a Sample>, size: f64) -> Vec<Sample> {
    firsts(samples, size, |s| (s.position, s.normal))
}

/// The first of each cell and side, ordered by them.
///
/// * `place` – position and normal
pub(crate) fn firsts<'a, T: Copy + 'a>(
    all: impl Iterator<Item = &'a T>,
    size: f64,
    place: impl Fn(&T) -> (Point, Vector),
) -> Vec<T> {
    let mut firsts = BTreeMap::new();
    for one in all {
        let (position, normal) = place(one);
        firsts.entry(cell_and_side(&position, &normal, size)).or_insert(*one);
    }
    firsts.into_values().collect()
}

/// A point of the surface with its outward normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Position, world frame, metres.
    pub position: Point,
    /// Outward unit normal, world frame.
    pub normal: Vector,
    /// Standard deviation along the normal, metres.
    pub sigma: f64,
    /// Where it comes from.
    pub provenance: Provenance,
}

impl Sample {
    /// Whether a touch measured it.
    pub fn is_felt(&self) -> bool {
        matches!(self.provenance, Provenance::Felt { .. })
    }
}
