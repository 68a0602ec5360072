use crate::geometry::{Point, PointCloud, TriangleMesh};

/// The colours that say where a thing comes from, the same in every picture (sRGB).
pub mod palette {
    /// Measured by the camera: blue grey.
    pub const SEEN: [u8; 3] = [96, 134, 172];
    /// Moved by a symmetry: orange.
    pub const GUESSED: [u8; 3] = [236, 148, 58];
    /// Measured by touch: green.
    pub const FELT: [u8; 3] = [62, 158, 92];
    /// No evidence is near: grey.
    pub const EXTRAPOLATED: [u8; 3] = [150, 150, 154];
    /// A guess that was contradicted: dark red.
    pub const REMOVED: [u8; 3] = [168, 60, 62];
    /// A mesh: light grey.
    pub const MESH: [u8; 3] = [206, 206, 210];
    /// The picture's background.
    pub const PAPER: [u8; 3] = [255, 255, 255];
    /// Text.
    pub const INK: [u8; 3] = [70, 74, 82];
}

/// What is drawn.
#[derive(Debug, Clone, Copy)]
pub enum Shape<'a> {
    /// Triangles; faces seen from behind are drawn darker and redder, so that holes show.
    Mesh(&'a TriangleMesh),
    /// Points, each a small disc across its normal (facing the viewer where there is none).
    Cloud(&'a PointCloud),
}

/// Where the colour comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Paint {
    /// One sRGB colour.
    Plain([u8; 3]),
    /// The colours stored with the shape; this one where there are none.
    Own([u8; 3]),
    /// The direction of the outward normal, (n + 1)/2 as red, green, blue; not shaded.
    Normal,
}

/// A shape and its paint.
#[derive(Debug, Clone, Copy)]
pub struct Item<'a> {
    /// What is drawn.
    pub shape: Shape<'a>,
    /// Its colour.
    pub paint: Paint,
}

impl<'a> Item<'a> {
    /// A mesh in one colour.
    pub fn mesh(mesh: &'a TriangleMesh, color: [u8; 3]) -> Self {
        Self { shape: Shape::Mesh(mesh), paint: Paint::Plain(color) }
    }

    /// A cloud in one colour.
    pub fn cloud(cloud: &'a PointCloud, color: [u8; 3]) -> Self {
        Self { shape: Shape::Cloud(cloud), paint: Paint::Plain(color) }
    }

    /// Vertices or points.
    pub(super) fn points(&self) -> &'a [Point] {
        match self.shape {
            Shape::Mesh(mesh) => &mesh.vertices,
            Shape::Cloud(cloud) => &cloud.points,
        }
    }

    /// The sRGB colour of a vertex or point.
    pub(super) fn color(&self, index: usize) -> [u8; 3] {
        let own = match self.shape {
            Shape::Mesh(mesh) => mesh.colors.as_ref(),
            Shape::Cloud(cloud) => cloud.colors.as_ref(),
        };
        match self.paint {
            Paint::Plain(color) => color,
            Paint::Own(fallback) => own.and_then(|c| c.get(index)).copied().unwrap_or(fallback),
            Paint::Normal => [128; 3],
        }
    }
}
