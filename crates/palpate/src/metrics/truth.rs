use super::comparison::MetricsError;
use super::distances::SampleDistances;
use super::inside::InsideRule;
use super::surface_samples::SurfaceSamples;
use crate::camera::PinholeCamera;
use crate::geometry::{Bvh, Isometry, Point, TriangleMesh, Vector};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Where the object was seen from: decides what its hidden side is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Viewpoint {
    /// The depth camera.
    pub camera: PinholeCamera,
    /// Its pose, in the frame of the meshes.
    pub world_from_camera: Isometry,
}

/// How two meshes are compared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CompareParams {
    /// Samples on each surface. More: less random error (0.3 % of a mean distance at 100 000) and proportionally more time.
    pub samples: usize,
    /// Seed of the samples and of the lines of the volumetric IoU.
    pub seed: u64,
    /// Lines along each axis for the volumetric IoU; see [`super::IouParams::lines`].
    pub iou_lines: usize,
    /// The view whose hidden side is judged apart; none by default.
    #[serde(skip)]
    pub viewpoint: Option<Viewpoint>,
}

impl Default for CompareParams {
    fn default() -> Self {
        Self { samples: 100_000, seed: 0, iou_lines: super::IouParams::default().lines, viewpoint: None }
    }
}

impl CompareParams {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`MetricsError::Parameter`] naming the field, its value and the rule.
    pub fn validate(&self) -> Result<(), MetricsError> {
        let positive = |field, value: usize| {
            (value > 0).then_some(()).ok_or(MetricsError::Parameter { field, value, rule: "at least 1" })
        };
        positive("samples", self.samples)?;
        positive("iou_lines", self.iou_lines)
    }
}

/// One surface prepared for judging: its samples, its tree and its inside.
pub(super) struct Judged {
    pub(super) mesh: TriangleMesh,
    pub(super) samples: SurfaceSamples,
    pub(super) inside: InsideRule,
    pub(super) watertight: bool,
    bvh: Bvh,
    /// Unit normal of each face.
    normals: Vec<Vector>,
}

impl Judged {
    pub(super) fn new(mesh: &TriangleMesh, what: &'static str, params: &CompareParams) -> Result<Self, MetricsError> {
        if let Some(vertex) = mesh.vertices.iter().position(|p| p.iter().any(|c| !c.is_finite())) {
            return Err(MetricsError::NotFinite { what, vertex });
        }
        let samples = SurfaceSamples::draw(mesh, params.samples, params.seed);
        if samples.is_empty() {
            return Err(MetricsError::NoSurface { what, faces: mesh.faces.len() });
        }
        let (inside, watertight) = InsideRule::of(mesh);
        // A zero-area face has no normal and its points lie on its neighbours as well.
        let mut solid = TriangleMesh { vertices: mesh.vertices.clone(), faces: mesh.faces.clone(), colors: None };
        solid.faces =
            (0..mesh.faces.len()).filter(|&f| mesh.face_normal(f) != Vector::zeros()).map(|f| mesh.faces[f]).collect();
        let normals = (0..solid.faces.len()).map(|f| solid.face_normal(f)).collect();
        let bvh = Bvh::new(&solid);
        Ok(Self { mesh: mesh.clone(), samples, inside, watertight, bvh, normals })
    }

    /// Exact distances of another surface's samples to this surface's triangles, and the nearest points.
    pub(super) fn measure(&self, other: &Self) -> (SampleDistances, Vec<Point>) {
        let found: Vec<(f64, f64, Point)> = other
            .samples
            .points
            .par_iter()
            .zip(&other.samples.faces)
            .with_min_len(1024)
            .map(|(p, &face)| {
                let nearest = self.bvh.closest_point(p).expect("a judged mesh has a face");
                let dot = other.mesh.face_normal(face).dot(&self.normals[nearest.face]);
                (nearest.distance, dot, nearest.point)
            })
            .collect();
        let distances = found.iter().map(|f| f.0).collect();
        let normal_dots = found.iter().map(|f| f.1).collect();
        (SampleDistances { distances, normal_dots }, found.into_iter().map(|f| f.2).collect())
    }

    /// For points on this surface: whether the camera does **not** see them (outside the image, or something in front).
    pub(super) fn hidden_from(&self, view: &Viewpoint, points: &[Point]) -> Vec<bool> {
        let eye = Point::from(view.world_from_camera.translation.vector);
        let camera_from_world = view.world_from_camera.inverse();
        let in_image = |p: &Point| {
            view.camera.project(&(camera_from_world * p)).is_some_and(|(u, v)| {
                let inside = |x: f64, size: usize| x >= -0.5 && x < size as f64 - 0.5;
                inside(u, view.camera.width) && inside(v, view.camera.height)
            })
        };
        points
            .par_iter()
            .with_min_len(1024)
            .map(|p| {
                let ray = p - eye;
                // The point itself is at 1: anything before 1 − 1e-6 (below 1 µm at 0.7 m) is in front of it.
                !in_image(p) || self.bvh.cast_ray(&eye, &ray, 1.0 - 1e-6).is_some()
            })
            .collect()
    }
}

/// The truth, prepared once for any number of comparisons.
pub struct TruthReference {
    pub(super) surface: Judged,
    pub(super) params: CompareParams,
    /// Which of the truth's samples the camera does not see.
    pub(super) hidden: Option<Vec<bool>>,
}

impl TruthReference {
    /// Samples the truth, builds its tree and finds its hidden side.
    ///
    /// # Errors
    /// [`MetricsError`] if the parameters are out of range or the mesh has no area or a coordinate that is not finite.
    pub fn new(truth: &TriangleMesh, params: &CompareParams) -> Result<Self, MetricsError> {
        params.validate()?;
        let surface = Judged::new(truth, "truth", params)?;
        let hidden = params.viewpoint.as_ref().map(|view| surface.hidden_from(view, &surface.samples.points));
        Ok(Self { surface, params: params.clone(), hidden })
    }

    /// The truth mesh.
    pub fn mesh(&self) -> &TriangleMesh {
        &self.surface.mesh
    }
}
