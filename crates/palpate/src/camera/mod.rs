//! The depth camera: its model, its image, and from a frame to the object's visible side.

mod cloud;
mod depth_image;
mod error;
mod fragments;
mod fringe;
mod intrinsics;
mod raster_filter;
mod raster_normals;
mod register;
mod segment;
mod segment_params;
mod smooth;
mod support;
mod undistort;
mod visible;
mod window_fit;

pub use cloud::{CleanCloud, clean_cloud};
pub use depth_image::{Background, DepthNoise, Frame};
pub use error::CameraError;
pub use intrinsics::PinholeCamera;
pub use raster_normals::raster_normals;
pub use register::{register_color, register_depth};
pub use segment::segment_object;
pub use segment_params::{SegmentError, SegmentParams};
pub use smooth::{SmoothParams, smooth_depth};
pub use undistort::{undistort_color, undistort_depth, undistort_gray};
pub use visible::Visible;
