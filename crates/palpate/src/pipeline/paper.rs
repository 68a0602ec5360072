//! The published method with its defects mended: one reflection plane, touches pasted on, guesses deleted along rays.
//!
//! M. Badosa: "3D object shape reconstruction combining a single depth image and visual tactile sensors", MSc thesis, 2024. Mended:
//! normals are oriented by how each point was measured, the mirrored copy stays where the plane puts it, touch poses are used as
//! given, and a ray deletes only mirrored points on its own side of the centre.

use super::reconstruct::{Reconstruction, Stages, cut_by_border, mesh_warnings};
use super::{ReconstructError, ReconstructParams, Surface, stages as step};
use crate::camera::{Frame, Visible, segment_object};
use crate::completion::{EliminationParams, best_plane, contradicted};
use crate::geometry::{Aabb, Plane, Point, PointCloud, TriangleMesh, voxel_average};
use crate::scene::Scene;
use crate::surface::{BallPivotingParams, PoissonParams, SurfaceError, ball_pivoting, screened_poisson};
use crate::tactile::Patch;
use serde::{Deserialize, Serialize};

/// How the joined cloud becomes a mesh.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PaperSurface {
    /// Ball pivoting: through the points.
    BallPivoting,
    /// Screened Poisson: closed.
    #[default]
    Poisson,
}

/// Parameters of the published method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PaperParams {
    /// Side of the cells over which the seen points are averaged, metres; larger smooths more. Default 2 mm: about 1000 points remain of
    /// a hand-sized object, as published.
    pub depth_cell: f64,
    /// Side of the cells over which the felt points are averaged, metres; larger smooths more. Default 1 mm, as published.
    pub touch_cell: f64,
    /// Which guesses a touch deletes.
    pub elimination: EliminationParams,
    /// How to mesh.
    pub surface: PaperSurface,
    /// Ball pivoting. By default it takes the points as they are, its holes are closed and crumbs under 1 % of the area dropped, since a closed mesh is asked for.
    pub ball_pivoting: BallPivotingParams,
    /// Screened Poisson, at automatic depth by default.
    pub poisson: PoissonParams,
}

impl Default for PaperParams {
    fn default() -> Self {
        Self {
            depth_cell: 0.002,
            touch_cell: 0.001,
            elimination: EliminationParams::default(),
            surface: PaperSurface::default(),
            ball_pivoting: BallPivotingParams {
                project: Some(0),
                fill_holes: true,
                min_piece_share: 0.01,
                ..Default::default()
            },
            poisson: PoissonParams::default(),
        }
    }
}

impl PaperParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`PaperError::InvalidParameter`] names the first field that is out of range.
    pub fn validate(&self) -> Result<(), PaperError> {
        let positive = |x: f64| x.is_finite() && x > 0.0;
        let invalid =
            |field, value| Err(PaperError::InvalidParameter { field, value, rule: "must be positive and finite" });
        if !positive(self.depth_cell) {
            return invalid("depth_cell", self.depth_cell);
        }
        if !positive(self.touch_cell) {
            return invalid("touch_cell", self.touch_cell);
        }
        if !(self.elimination.ray_radius == 0.0 || positive(self.elimination.ray_radius)) {
            let (field, value) = ("elimination.ray_radius", self.elimination.ray_radius);
            return Err(PaperError::InvalidParameter { field, value, rule: "must be zero or more and finite" });
        }
        self.poisson.validate()?;
        Ok(self.ball_pivoting.validate()?)
    }
}

/// Why the published method failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PaperError {
    /// Neither camera nor touch gave a point.
    #[error("nothing to mesh: no point was seen and none was felt")]
    NoPoints,
    /// The joined cloud could not be meshed.
    #[error("meshing the joined cloud")]
    Surface(#[from] SurfaceError),
    /// A parameter is out of its range.
    #[error("{field} = {value}: {rule}")]
    InvalidParameter {
        /// Name of the field.
        field: &'static str,
        /// The value found.
        value: f64,
        /// What is allowed.
        rule: &'static str,
    },
}

/// Every intermediate cloud and the mesh, **world** frame; all clouds have outward normals.
#[derive(Debug, Clone)]
pub struct PaperResult {
    /// What the camera measured, averaged.
    pub seen: PointCloud,
    /// The mirror image of `seen` without `removed`.
    pub mirrored: PointCloud,
    /// Mirrored points that a touch contradicted.
    pub removed: PointCloud,
    /// What the touches measured, averaged touch by touch.
    pub felt: PointCloud,
    /// `seen`, `mirrored` and `felt`.
    pub joined: PointCloud,
    /// The mesh through `joined`.
    pub mesh: TriangleMesh,
}

/// The published method on a scene: the best accepted plane mirrors; without one, only what was measured is meshed.
pub(super) fn reconstruct(
    scene: &Scene,
    params: &ReconstructParams,
    stages: &Stages,
) -> Result<Reconstruction, ReconstructError> {
    let mut warnings = Vec::new();
    stages.begin("see");
    let visible = segment_object(&scene.frame, &params.segment)?;
    warnings.extend(cut_by_border(&visible));
    stages.begin("feel");
    let patches = step::feel(scene, params, stages, &mut warnings)?;
    stages.begin("evidence");
    let (evidence, patches) = step::gather(scene, &visible, patches, params, &mut warnings)?;
    let patches: Vec<Patch> = patches.into_iter().map(|(_, patch)| patch).collect();
    stages.begin("symmetry");
    let symmetry = stages.estimator().estimate(&evidence);
    let view = evidence.bounds.center() - evidence.camera_center;
    let plane = best_plane(&symmetry, &view);
    stages.begin("mirror and mesh");
    let surface = match params.surface() {
        Surface::BallPivoting => PaperSurface::BallPivoting,
        Surface::Poisson => PaperSurface::Poisson,
        Surface::Implicit => return Err(ReconstructError::ImplicitPaper),
    };
    let paper = PaperParams { surface, ..params.paper.clone() };
    let result = reconstruct_paper(&scene.frame, &visible, &patches, plane.as_ref(), &paper)?;
    warnings.extend(mesh_warnings(&result.mesh));
    Ok(Reconstruction {
        mesh: result.mesh,
        visible: visible.cloud(&scene.frame),
        felt: result.felt,
        moved: result.mirrored,
        removed: result.removed,
        joined: result.joined,
        symmetry,
        touches_used: patches.len(),
        touches: Vec::new(),
        knowledge: None,
        warnings,
    })
}

/// Completes the seen side by its mirror image, corrects it by touch and meshes the result.
///
/// * `visible` – the object's visible side, of `frame`
/// * `patches` – what the touches felt, world frame; may be empty
/// * `plane` – reflection plane, world frame; `None` = no guess, only what was measured
///
/// # Errors
/// [`PaperError`] if there is no point at all, if the joined cloud cannot be meshed, or for a parameter out of range.
pub fn reconstruct_paper(
    frame: &Frame,
    visible: &Visible,
    patches: &[Patch],
    plane: Option<&Plane>,
    params: &PaperParams,
) -> Result<PaperResult, PaperError> {
    params.validate()?;
    // See, guess, mirror.
    let seen = voxel_average(&visible.cloud(frame), params.depth_cell);
    let guessed = plane.map_or_else(|| seen.filtered(|_| false), |plane| reflected(&seen, plane));
    // Feel: touch by touch, so that overlapping touches do not blur one another.
    let felt_each: Vec<PointCloud> = patches.iter().map(|p| voxel_average(&cloud_of(p), params.touch_cell)).collect();
    // Eliminate what a touch contradicts.
    let felt_points: Vec<&[Point]> = felt_each.iter().map(|c| c.points.as_slice()).collect();
    let measured = seen.points.iter().chain(felt_points.iter().copied().flatten());
    let center = Aabb::of(measured.chain(&guessed.points)).ok_or(PaperError::NoPoints)?.center();
    let marked = contradicted(&guessed.points, &felt_points, &center, &params.elimination);
    let (mirrored, removed) = (guessed.filtered(|i| !marked[i]), guessed.filtered(|i| marked[i]));
    // Concatenate and mesh.
    let mut felt = PointCloud { normals: Some(Vec::new()), ..PointCloud::default() };
    for cloud in &felt_each {
        felt.append(cloud);
    }
    let mut joined = PointCloud { colors: None, ..seen.clone() };
    joined.append(&mirrored);
    joined.append(&felt);
    let mesh = match params.surface {
        PaperSurface::BallPivoting => ball_pivoting(&joined, &params.ball_pivoting)?,
        PaperSurface::Poisson => screened_poisson(&joined, None, &params.poisson)?.mesh,
    };
    Ok(PaperResult { seen, mirrored, removed, felt, joined, mesh })
}

fn reflected(cloud: &PointCloud, plane: &Plane) -> PointCloud {
    PointCloud {
        points: cloud.points.iter().map(|p| plane.reflect_point(p)).collect(),
        normals: cloud.normals.as_ref().map(|n| n.iter().map(|n| plane.reflect_vector(n)).collect()),
        colors: cloud.colors.clone(),
    }
}

fn cloud_of(patch: &Patch) -> PointCloud {
    PointCloud { points: patch.points.clone(), normals: Some(patch.normals.clone()), colors: None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Background, DepthNoise, PinholeCamera};
    use crate::geometry::{Isometry, Raster, Topology, Vector};
    use std::f64::consts::PI;

    const RADIUS: f64 = 0.04;
    const CENTER: Point = Point::new(0.0, 0.0, 0.5);

    /// An exact frame of a sphere straight ahead of the camera; the world is the camera frame.
    fn sphere_frame() -> (Frame, Visible) {
        let (n, f) = (120, 420.0);
        let middle = (n as f64 - 1.0) / 2.0;
        let camera = PinholeCamera { width: n, height: n, fx: f, fy: f, cx: middle, cy: middle, distortion: [0.0; 5] };
        let mut depth = Raster::filled(n, n, f32::NAN);
        let mut normals = Raster::filled(n, n, [0.0_f32; 3]);
        for (row, col) in (0..n).flat_map(|row| (0..n).map(move |col| (row, col))) {
            let ray = camera.ray(col as f64, row as f64);
            let (a, b, c) =
                (ray.norm_squared(), ray.dot(&CENTER.coords), CENTER.coords.norm_squared() - RADIUS * RADIUS);
            let discriminant = b * b - a * c;
            if discriminant > 0.0 {
                let z = (b - discriminant.sqrt()) / a;
                depth[(row, col)] = z as f32;
                normals[(row, col)] = ((Point::from(ray * z) - CENTER) / RADIUS).map(|x| x as f32).into();
            }
        }
        let mask = Raster::filled(n, n, true);
        let frame = Frame {
            camera,
            world_from_camera: Isometry::identity(),
            depth: depth.clone(),
            background: Background::Absent,
            noise: DepthNoise { sigma: 0.0, sigma_quadratic: 0.0 },
            color: None,
            mask: None,
            support: None,
        };
        (frame, Visible { mask, depth, normals, support: None, border_share: 0.0 })
    }

    /// A cap of the sphere, 25° wide, round `direction`.
    fn touch(direction: Vector) -> Patch {
        let direction = direction.normalize();
        let normals: Vec<Vector> = (0..40_000)
            .map(|i| {
                let z = 1.0 - (2.0 * f64::from(i) + 1.0) / 40_000.0;
                let (sin, cos) = (f64::from(i) * PI * (3.0 - 5.0_f64.sqrt())).sin_cos();
                Vector::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
            })
            .filter(|n| n.dot(&direction) > 25.0_f64.to_radians().cos())
            .collect();
        let points = normals.iter().map(|n| CENTER + n * RADIUS).collect();
        Patch { points, normals, clearance: Vec::new(), world_from_sensor: Isometry::identity() }
    }

    fn params(surface: PaperSurface) -> PaperParams {
        PaperParams { surface, ..Default::default() }
    }

    #[test]
    fn half_a_sphere_and_its_mirror_are_a_sphere() {
        let (frame, visible) = sphere_frame();
        let plane = Plane::new(Vector::z(), &CENTER).expect("a plane");
        let patches = [touch(Vector::z()), touch(Vector::new(1.0, 0.0, 0.5))];
        for surface in [PaperSurface::BallPivoting, PaperSurface::Poisson] {
            let result = reconstruct_paper(&frame, &visible, &patches, Some(&plane), &params(surface)).expect("meshes");
            let t = Topology::of(&result.mesh);
            assert!(t.is_watertight() && t.components == 1, "{surface:?}: {t:?}");
            let ratio = result.mesh.volume() / (4.0 / 3.0 * PI * RADIUS.powi(3));
            assert!((ratio - 1.0).abs() < 0.03, "{surface:?}: {ratio}");
            assert_eq!(result.mirrored.len() + result.removed.len(), result.seen.len());
            assert_eq!(result.joined.len(), result.seen.len() + result.mirrored.len() + result.felt.len());
        }
    }

    #[test]
    fn a_touch_deletes_guesses_on_its_side_only() {
        let (frame, visible) = sphere_frame();
        // A plane 10 mm too far puts the mirrored side 20 mm behind the true one.
        let plane = Plane::new(Vector::z(), &(CENTER + Vector::z() * 0.01)).expect("a plane");
        let params = params(PaperSurface::BallPivoting);
        let result = reconstruct_paper(&frame, &visible, &[touch(Vector::z())], Some(&plane), &params).expect("meshes");
        assert!(result.removed.len() > 50);
        assert!(result.removed.points.iter().all(|p| p.z > CENTER.z + 0.03));
        let reflected_axis = CENTER + Vector::z() * (0.02 + RADIUS);
        assert!(result.mirrored.points.iter().all(|p| (p - reflected_axis).norm() > 0.01));
        let without = reconstruct_paper(&frame, &visible, &[], Some(&plane), &params).expect("meshes");
        assert!(without.removed.is_empty() && without.mirrored.len() == without.seen.len());
    }

    #[test]
    fn without_a_plane_only_measurements_remain() {
        let (frame, visible) = sphere_frame();
        let params = params(PaperSurface::BallPivoting);
        let result = reconstruct_paper(&frame, &visible, &[], None, &params).expect("meshes");
        assert!(result.mirrored.is_empty() && result.joined.len() == result.seen.len());
        assert!(Topology::of(&result.mesh).is_watertight());
    }

    #[test]
    fn nothing_at_all_is_an_error() {
        let (frame, mut visible) = sphere_frame();
        visible.depth.as_mut_slice().fill(f32::NAN);
        let error = reconstruct_paper(&frame, &visible, &[], None, &PaperParams::default());
        assert!(matches!(error, Err(PaperError::NoPoints)));
        let params = PaperParams { depth_cell: 0.0, ..Default::default() };
        let error = reconstruct_paper(&frame, &visible, &[], None, &params);
        assert!(matches!(error, Err(PaperError::InvalidParameter { field: "depth_cell", .. })));
    }
}
