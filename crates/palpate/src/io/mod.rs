//! Files: one per format. The only module that touches the file system.
//!
//! Every reader exists twice: `read_*` takes a path, `parse_*` the bytes and the name to use in messages. Readers survive any
//! input: what a header claims is compared with the bytes that are there **before** anything is allocated, so that a file of
//! a hundred bytes that claims 10¹² points is an error and not an exhausted machine.
//! Writers go through [`atomic_write`]: a file under its final name is always complete.

mod atomic;
mod camera_file;
mod error;
mod glb;
mod images;
mod lookup_table;
mod mesh_files;
mod npy;
mod obj;
mod object_split;
mod off;
mod pcd;
mod ply;
mod press_set;
mod raw;
mod scene;
mod scene_append;
mod scene_follow;
mod scene_format;
mod scene_write;
mod sensor_file;
mod stl;
mod text;
mod weights;
mod ycb_sight;

pub use atomic::atomic_write;
pub use camera_file::{CameraFile, pose, read_camera, read_extrinsics, write_camera, write_extrinsics};
pub use error::IoError;
pub use images::{
    Picture, parse_color, parse_depth_png, parse_mask, read_color, read_depth_png, read_gray, read_mask, read_picture,
    write_color, write_depth_png, write_jpeg, write_mask, write_picture,
};
pub use lookup_table::read_lookup_table;
pub use mesh_files::{
    CloudFile, parse_cloud, parse_mesh, read_cloud, read_cloud_file, read_mesh, read_mesh_with, write_cloud,
    write_mesh, write_mesh_with,
};
pub use npy::{NpyArray, parse_npy, read_height_map_npy, read_npy, write_height_map_npy, write_npy};
pub use object_split::{ObjectSplit, SplitPart, parse_object_split, read_object_split};
pub use ply::{PropertyValues, VertexProperty};
pub use press_set::{PressSet, PressSetHeader, begin_press_set, has_press_shard, write_press_shard};
pub use raw::VertexValues;
pub use scene::{SceneCheck, SceneFile, check_scene, read_scene};
pub use scene_append::SceneAppender;
pub use scene_follow::{SceneChange, SceneFollower};
pub use scene_write::{NewScene, SceneMade, SceneToWrite, depth_unit, init_scene, write_scene};
pub use sensor_file::{SensorFile, copy_sensor, read_sensor, write_sensor};
pub use text::{
    check_cloud_output, check_folder, check_mesh_output, check_writable, create_folder, read_text, write_text,
};
pub use weights::read_compact_weights;
pub use ycb_sight::{YcbSightFile, read_ycb_sight, read_ycb_sight_press, write_ycb_sight};
