//! Ball pivoting: a mesh through the points themselves, made by rolling balls over them (Bernardini et al. 1999).

mod front;
mod grid;
mod params;
mod pivot;
mod prepare;
mod project;

pub use params::BallPivotingParams;
pub use pivot::ball_pivoting;
