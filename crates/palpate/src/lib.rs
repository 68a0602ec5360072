//! palpate: the full 3D shape of an object from one RGB-D image and a few touches of a visuo-tactile fingertip.
//!
//! # Conventions
//! Metres, radians, seconds; anything else wears its unit in its name. Transforms are `a_from_b`.
//! Frames: `world` (z up), `camera` (x right, y down, z forward), `sensor` (origin at the apex of the relaxed gel in the
//! pressed pose, +z out of the gel into the object, x along columns, y along rows), `object` (ground-truth mesh).
//! Pixel (u, v) has integer coordinates at its centre; rasters are indexed (row, col).

pub mod calibrate;
pub mod camera;
pub mod capture;
pub mod completion;
pub mod evidence;
pub mod explore;
pub mod geometry;
pub mod io;
pub mod metrics;
pub mod pipeline;
pub mod render;
pub mod scene;
pub mod simulate;
pub mod surface;
pub mod symmetry;
pub mod tactile;
