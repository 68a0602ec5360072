//! Scenes with exact truth: a depth frame and touches of a mesh or an analytic solid, by the benchmark's protocol.
//!
//! Seeded: the same object name, mesh, parameters and seed give the same bytes, with any number of threads, and the touches of a
//! shorter list are the first of a longer one.

mod camera;
mod presses;
mod scene;
mod seed;
mod shapes;
mod touches;
mod ycb_sight;

pub use camera::{CameraParams, look_at};
pub use presses::{
    Disturbance, LightParams, PressRecord, PressSample, PressSampler, PressSetParams, Primitive, simulated_lookup_table,
};
pub use scene::{SimulateError, SimulateParams, SimulatedScene, place, simulate_scene};
pub use shapes::Solid;
pub use touches::{TactileImages, TouchParams, TouchReach};
pub(crate) use touches::{aim, sample_surface};
pub use ycb_sight::{YcbSightObject, simulate_ycb_sight, ycb_sight_camera, ycb_sight_camera_pose};
