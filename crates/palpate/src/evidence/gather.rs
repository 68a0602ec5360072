use super::contour::{ContourPoint, occluding_contour};
use super::{
    EvidenceError, EvidenceParams, FreeSpace, Provenance, Sample, SampleIndex, average_in_voxels, pose_sigma_at,
};
use crate::camera::{Frame, Visible};
use crate::geometry::{Aabb, Plane, Point, Vector};
use crate::tactile::Patch;
use nalgebra::{Matrix6, Unit, Vector6};

/// Spacing and reach of the sample index, metres: the score's widest tolerance.
pub(super) const INDEX_SPACING: f64 = 0.002;
pub(super) const INDEX_REACH: f64 = 0.0125;
/// Fewer samples than this carry no shape.
const LEAST_SAMPLES: usize = 10;

/// All that was measured of one object, **world** frame.
pub struct Evidence {
    /// The measured surface: seen samples first, then the felt ones touch by touch.
    pub samples: Vec<Sample>,
    /// Every measured point, not averaged: seen ones row by row, then felt ones touch by touch.
    pub measured: Vec<Sample>,
    /// Where the surface turns away from the camera.
    pub contour: Vec<ContourPoint>,
    /// Nearest-sample look-up over `samples`.
    pub index: SampleIndex,
    /// The space that is proven free.
    pub free_space: FreeSpace,
    /// The box of the space that the object may fill, joined with the samples' box.
    pub bounds: Aabb,
    /// The support plane, normal up, if known.
    pub support: Option<Plane>,
    /// Where the camera was.
    pub camera_center: Point,
}

impl Evidence {
    /// Joins the camera's view and the touches: lifts, weighs and averages the samples, and carves the free space.
    ///
    /// * `patches` – in the order taken; `Provenance::Felt` counts them from 0
    ///
    /// # Errors
    /// [`EvidenceError`] if the rasters disagree in size, a parameter is out of range, or almost nothing was measured.
    pub fn gather(
        frame: &Frame,
        visible: &Visible,
        patches: &[Patch],
        params: &EvidenceParams,
    ) -> Result<Self, EvidenceError> {
        let (r, t) = (params.pose_sigma_rotation, params.pose_sigma_translation);
        let stated = Matrix6::from_diagonal(&Vector6::new(r, r, r, t, t, t).map(|s| s * s));
        Self::gather_posed(frame, visible, patches, &vec![stated; patches.len()], params)
    }

    /// [`Self::gather`] with the covariance of each touch's pose, in the sensor's frame: rotation (radians), then translation (metres).
    /// The pose σ of `params` is not used.
    ///
    /// # Errors
    /// As [`Self::gather`].
    pub fn gather_posed(
        frame: &Frame,
        visible: &Visible,
        patches: &[Patch],
        covariances: &[Matrix6<f64>],
        params: &EvidenceParams,
    ) -> Result<Self, EvidenceError> {
        params.validate()?;
        let ((rows, cols), (found_rows, found_cols)) = (frame.depth.shape(), visible.depth.shape());
        if (rows, cols) != (found_rows, found_cols) || visible.mask.shape() != (rows, cols) {
            return Err(EvidenceError::SizeMismatch { found_rows, found_cols, rows, cols });
        }
        let mut measured = seen_samples(frame, visible, params);
        let mut samples = average_in_voxels(&measured, params.seen_voxel);
        for (touch, (patch, covariance)) in patches.iter().zip(covariances).enumerate() {
            let felt = felt_samples(patch, touch as u32, covariance, params);
            samples.extend(average_in_voxels(&felt, params.felt_voxel));
            measured.extend(felt);
        }
        if samples.len() < LEAST_SAMPLES {
            return Err(EvidenceError::TooFewSamples { found: samples.len(), needed: LEAST_SAMPLES });
        }
        let free_space = FreeSpace::new(frame, visible, patches, covariances, &samples, params);
        Ok(Self {
            index: SampleIndex::new(&samples, INDEX_SPACING, INDEX_REACH),
            contour: occluding_contour(frame, visible, params.depth_jump),
            bounds: free_space.hull_bounds(),
            free_space,
            support: visible.support,
            camera_center: frame.world_from_camera * Point::origin(),
            samples,
            measured,
        })
    }

    /// Which way is up: the support plane's normal, else the world's z.
    pub fn up(&self) -> Unit<Vector> {
        self.support.map_or(Vector::z_axis(), |s| s.normal)
    }

    /// Mean position of the samples.
    pub fn centroid(&self) -> Point {
        let sum: Vector = self.samples.iter().map(|s| s.position.coords).sum();
        Point::from(sum / self.samples.len().max(1) as f64)
    }
}

/// Pixels of the visible side as samples. σ grows with range (the sensor's model) and with incidence.
fn seen_samples(frame: &Frame, visible: &Visible, params: &EvidenceParams) -> Vec<Sample> {
    let mut samples = Vec::new();
    for (row, col, &z) in visible.depth.pixels() {
        if !z.is_finite() {
            continue;
        }
        let (z, ray) = (f64::from(z), frame.camera.ray(col as f64, row as f64));
        let normal = Vector::from(visible.normals[(row, col)].map(f64::from));
        let Some(normal) = normal.try_normalize(1e-6) else { continue };
        let incidence = (-normal.dot(&ray) / ray.norm()).clamp(0.25, 1.0);
        let sigma = params.seen_sigma_share * frame.noise.or_typical().sigma_at(z) / incidence;
        samples.push(Sample {
            position: frame.world_from_camera * Point::from(ray * z),
            normal: frame.world_from_camera * normal,
            sigma: sigma.max(params.seen_sigma_floor),
            provenance: Provenance::Seen,
        });
    }
    samples
}

/// Points of a patch as samples; a rotation error of the pose moves points far from the sensor's origin more.
pub(super) fn felt_samples(
    patch: &Patch,
    touch: u32,
    covariance: &Matrix6<f64>,
    params: &EvidenceParams,
) -> Vec<Sample> {
    patch
        .points
        .iter()
        .zip(&patch.normals)
        .filter_map(|(&position, normal)| {
            let normal = normal.try_normalize(1e-6)?;
            let pose = pose_sigma_at(&patch.world_from_sensor, covariance, &position, &normal);
            let sigma = params.felt_sigma.hypot(pose);
            let finite = position.iter().all(|c| c.is_finite());
            finite.then_some(Sample { position, normal, sigma, provenance: Provenance::Felt { touch } })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::testing::{Solid, touch, view};

    fn scene() -> Vec<Solid> {
        vec![Solid::Box(Point::new(0.0, 0.0, 0.03), Vector::new(0.04, 0.025, 0.03), 0.4)]
    }

    fn gather(solids: &[Solid], patches: &[Patch], sigma: f64) -> Evidence {
        let (frame, visible) = view(solids, sigma);
        Evidence::gather(&frame, &visible, patches, &EvidenceParams::default()).expect("the box is seen")
    }

    /// Points on the box's surface, hidden side included.
    fn surface(solids: &[Solid]) -> Vec<Point> {
        let steps = 25;
        let mut points = Vec::new();
        for i in 0..=steps {
            for j in 0..=steps {
                let (a, b) = (2.0 * i as f64 / steps as f64 - 1.0, 2.0 * j as f64 / steps as f64 - 1.0);
                for q in [[a, b, 1.0], [a, b, -1.0], [a, 1.0, b], [a, -1.0, b], [1.0, a, b], [-1.0, a, b]] {
                    let v = Vector::from(q).component_mul(&Vector::new(0.04, 0.025, 0.03));
                    points.push(
                        Point::new(0.0, 0.0, 0.03) + nalgebra::Rotation3::from_axis_angle(&Vector::z_axis(), 0.4) * v,
                    );
                }
            }
        }
        assert!(points.iter().all(|p| solids[0].distance(p).abs() < 1e-9));
        points
    }

    #[test]
    fn true_surface_points_are_never_in_free_space() {
        let solids = scene();
        let evidence = gather(&solids, &[], 0.0005);
        let h = evidence.free_space.grid().spacing();
        let points = surface(&solids);
        let mut clearance: Vec<f64> = points.iter().map(|p| evidence.free_space.clearance(p)).collect();
        clearance.sort_unstable_by(f64::total_cmp);
        // An edge stands out of the pixel grid by up to half a pixel (0.5 m / 400), the tip of a corner by up to one.
        let (worst, high) = (clearance[clearance.len() - 1], clearance[clearance.len() * 99 / 100]);
        assert!(worst < 0.5 / 400.0 && high < 0.5 / 400.0 * 0.45, "clearance on the surface: {worst}, 99 % {high}");
        let worst = points.iter().map(|p| evidence.free_space.signed_distance(p)).fold(f64::MIN, f64::max);
        assert!(worst < 0.7 * h, "grid distance on the surface: {worst}, cells of {h}");
    }

    #[test]
    fn free_space_is_a_lower_bound_and_not_a_trivial_one() {
        let solids = scene();
        let evidence = gather(&solids, &[], 0.0);
        let h = evidence.free_space.grid().spacing();
        let (mut proven, mut free) = (0, 0);
        for i in 0..14 * 14 * 14 {
            let p = Point::new(f64::from(i % 14), f64::from(i / 14 % 14), f64::from(i / 196)) * 0.01
                - Vector::new(0.065, 0.065, 0.02);
            let truth = solids[0].distance(&p);
            let (exact, grid) = (evidence.free_space.clearance(&p), evidence.free_space.signed_distance(&p));
            // Rays bound the distance along one line; near an edge of the box the true distance can be a little less.
            assert!(exact < truth.max(0.0) * 1.05 + 0.001, "{p}: clearance {exact}, distance {truth}");
            assert!(grid < truth.max(0.0) + 1.5 * h, "{p}: grid {grid}, distance {truth}");
            free += i32::from(truth > 0.005);
            proven += i32::from(truth > 0.005 && exact > 0.0);
        }
        assert!(proven * 10 > free * 5, "{proven} of {free} free points are proven free");
        assert!(evidence.bounds.size().max() < 0.2, "{:?}", evidence.bounds);
    }

    #[test]
    fn touches_become_samples_with_their_number_and_a_small_sigma() {
        let solids = scene();
        let patch = touch(&solids, Point::new(-0.2, 0.0, 0.03), Point::new(0.0, 0.0, 0.03));
        let evidence = gather(&solids, &[patch], 0.001);
        let felt: Vec<&Sample> =
            evidence.samples.iter().filter(|s| s.provenance == Provenance::Felt { touch: 0 }).collect();
        assert!(felt.len() > 20 && felt.len() < 81, "{} felt samples", felt.len());
        assert!(felt.iter().all(|s| s.sigma < 1e-4 && solids[0].distance(&s.position).abs() < 1e-6));
        let seen = evidence.samples.iter().filter(|s| s.provenance == Provenance::Seen);
        assert!(seen.clone().count() > 300 && seen.clone().all(|s| s.sigma >= 5e-4), "σ of the camera is kept");
    }

    #[test]
    fn an_empty_view_is_refused() {
        let (frame, mut visible) = view(&scene(), 0.0);
        visible.depth = visible.depth.map(|_| f32::NAN);
        let error =
            Evidence::gather(&frame, &visible, &[], &EvidenceParams::default()).err().expect("nothing was seen");
        assert!(error.to_string().starts_with("0 surface samples"), "{error}");
    }
}
