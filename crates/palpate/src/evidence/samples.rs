use crate::geometry::{Point, Vector};

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
