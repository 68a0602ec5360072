//! Surfaces from oriented samples: ball pivoting, screened Poisson, the implicit function, marching cubes.

mod error;

pub use error::SurfaceError;
