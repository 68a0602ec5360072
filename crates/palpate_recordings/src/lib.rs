//! From what others recorded to a scene: MCAP files and rosbag2 folders of ROS 2, TUM RGB-D and BOP folders, clouds.
//!
//! The readers are our own and small: MCAP is a list of records, CDR a list of aligned numbers. The crate `mcap` would compile zstd and lz4 from
//! C and a second `syn`, ten times the cost of these files. Poses are `a_from_b`; times are nanoseconds.

mod bop;
mod cdr;
mod cloud;
mod error;
mod images;
mod mcap;
mod messages;
mod recording;
mod tf;
mod tum;
mod ycb_sight_real;

pub use bop::{BopFrame, import_bop};
pub use cdr::CdrReader;
pub use cloud::import_cloud;
pub use error::ImportError;
pub use mcap::{Mcap, Message, TopicSummary, summarise};
pub use messages::{CameraInfo, CompressedImage, Header, Image, PointCloud2, PoseStamped, TransformStamped};
pub use recording::{RecordingSpec, TouchSource, import_recording};
pub use tf::TfTree;
pub use tum::import_tum;
pub use ycb_sight_real::import_ycb_sight_real;

use palpate::geometry::Raster;
use palpate::scene::Scene;

/// A scene that was imported.
#[derive(Debug, Clone)]
pub struct Imported {
    /// The scene.
    pub scene: Scene,
    /// No-contact image of the tactile sensor, if there is one.
    pub tactile_background: Option<Raster<[u8; 3]>>,
    /// What was assumed.
    pub warnings: Vec<String>,
}
