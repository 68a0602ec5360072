//! palpate: the full 3D shape of an object from one RGB-D image and a few touches of a visuo-tactile fingertip.
//!
//! # Conventions
//! Metres, radians, seconds; anything else wears its unit in its name. Transforms are `a_from_b`.
//! Frames: `world` (z up), `camera` (x right, y down, z forward), `sensor` (origin at the apex of the relaxed gel in the
//! pressed pose, +z out of the gel into the object, x along columns, y along rows), `object` (ground-truth mesh).
//! Pixel (u, v) has integer coordinates at its centre; rasters are indexed (row, col).
//!
//! # Example
//! From a scene folder to a mesh:
//!
//! ```no_run
//! use palpate::io::{read_scene, write_mesh};
//! use palpate::pipeline::{ReconstructParams, Stages, reconstruct};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let file = read_scene("samples/mustard_bottle")?;
//! let result = reconstruct(&file.scene, &ReconstructParams::default(), &Stages::default())?;
//! for warning in &result.warnings {
//!     eprintln!("{warning}");
//! }
//! write_mesh("bottle.ply", &result.mesh)?;
//! # Ok(())
//! # }
//! ```
//!
//! Touches that are images alone need a decoder in [`pipeline::Stages`], such as [`tactile::compact::CompactDecoder`]. Touches that come one by
//! one are taken in by a [`pipeline::Session`]; where to touch next says [`explore::next_touches`].
//!
//! # Modules
//! In the order of what may use what:
//!
//! | module | what is in it |
//! |---|---|
//! | [`geometry`] | meshes, clouds, planes, rasters, trees, topology |
//! | [`camera`] | depth frames: segmentation, denoising, registration |
//! | [`tactile`] | sensors, contacts, decoders of tactile images, presses, optics |
//! | [`calibrate`] | cameras, gels, and where a sensor sits on the robot |
//! | [`capture`] | when a stream of tactile images shows a touch |
//! | [`scene`] | what is recorded of one object |
//! | [`evidence`] | measured samples and free space |
//! | [`surface`] | surfaces through points: implicit, Poisson, ball pivoting |
//! | [`metrics`] | a mesh against the truth |
//! | [`symmetry`] | symmetries that the evidence supports |
//! | [`simulate`] | scenes with exact truth |
//! | [`render`] | pictures without a graphics card |
//! | [`completion`] | what the evidence says elsewhere: copies, poses of touches, touches not believed |
//! | [`io`] | files |
//! | [`pipeline`] | from a scene to a mesh |
//! | [`explore`] | where to touch next |

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
