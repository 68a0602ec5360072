use crate::geometry::{Isometry, Point, Vector};

/// What one touch proves of the object, **world** frame.
#[derive(Debug, Clone)]
pub struct Patch {
    /// Surface points in contact, metres.
    pub points: Vec<Point>,
    /// Outward unit normal of the object at each point.
    pub normals: Vec<Vector>,
    /// Points of the gel surface that touch nothing: the object is not on the sensor's side of them.
    pub clearance: Vec<Point>,
    /// Pose the points were lifted with.
    pub world_from_sensor: Isometry,
}

impl Patch {
    /// The sensor's +z in the world: into the object.
    pub fn press_direction(&self) -> Vector {
        self.world_from_sensor * Vector::z()
    }
}
