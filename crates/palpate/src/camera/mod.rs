//! The depth camera: its model, its image, and from a frame to the object's visible side.

mod depth_image;
mod intrinsics;
mod visible;

pub use depth_image::{Background, DepthNoise, Frame};
pub use intrinsics::PinholeCamera;
pub use visible::Visible;
