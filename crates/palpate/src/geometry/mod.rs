//! Shapes and containers that everything else is made of: rasters, grids, clouds, meshes, planes, boxes and the trees that search them.
//!
//! Metres and `f64` throughout; rasters are indexed (row, col) and hold what their user needs.

mod aabb;
mod bvh;
mod cluster;
mod decimate;
mod distance_transform;
mod downsample;
mod half_edges;
mod kd_tree;
mod mass_properties;
mod mesh_repair;
mod normals;
mod pieces;
mod plane;
mod point_cloud;
mod ransac;
mod raster;
mod self_intersection;
mod sphere;
mod taubin;
mod topology;
mod triangle_mesh;
mod voxel_grid;

pub use aabb::Aabb;
pub use bvh::{Bvh, RayHit, SurfacePoint};
pub(crate) use cluster::outlier_limit;
pub use cluster::{UnionFind, cluster_sizes, euclidean_clusters, statistical_outliers};
pub use decimate::decimated;
pub use distance_transform::{distance_to_true, distance_to_true_3d};
pub use downsample::voxel_average;
pub use kd_tree::KdTree;
pub use mass_properties::MassProperties;
pub use mesh_repair::{Repair, repaired, worst_aspect_ratio};
pub use normals::estimate_normals;
pub(crate) use pieces::in_largest_piece;
pub use pieces::{drop_small_pieces, largest_piece, pieces, split_fans, without_unused_vertices};
pub use plane::Plane;
pub use point_cloud::PointCloud;
pub use ransac::{PlaneFit, PlaneRansac, fit_plane};
pub use raster::Raster;
pub use self_intersection::self_intersections;
pub use sphere::Sphere;
pub use taubin::taubin_smoothed;
pub use topology::Topology;
pub use triangle_mesh::TriangleMesh;
pub use voxel_grid::VoxelGrid;

/// A point in space, metres.
pub type Point = nalgebra::Point3<f64>;
/// A direction or displacement, metres.
pub type Vector = nalgebra::Vector3<f64>;
/// A rigid motion; named `a_from_b` after the frames it joins.
pub type Isometry = nalgebra::Isometry3<f64>;
