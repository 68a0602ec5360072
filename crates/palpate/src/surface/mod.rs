//! Surfaces from oriented samples: ball pivoting, screened Poisson, the implicit function, marching cubes.

mod ball_pivoting;
mod error;
mod hole_filling;
mod implicit;
mod isosurface;
mod isosurface_cells;
mod isosurface_grid;
mod poisson;
#[cfg(test)]
mod testing;

pub use ball_pivoting::{BallPivotingParams, ball_pivoting};
pub use error::SurfaceError;
pub use hole_filling::fill_holes;
pub use implicit::{
    FreeBound, ImplicitField, ImplicitParams, ImplicitProblem, PriorParams, ShellParams, WeightedSample,
    implicit_surface, solve_implicit,
};
pub use isosurface::{LATTICE_LIMIT, crossing_cells, extract_isosurface};
pub use poisson::{Boundary, PoissonParams, PoissonSurface, screened_poisson};
