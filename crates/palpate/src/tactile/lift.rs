use super::{Contact, ContactError, Patch, TactileSensor};
use crate::geometry::{Isometry, Point, Raster, Vector};
use serde::{Deserialize, Serialize};

/// How densely a contact is turned into oriented points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LiftParams {
    /// Distance between surface points on the pad, metres. Larger: fewer, faster, coarser. 0.7 mm keeps the detail that a
    /// 1–3 mm fusion grid can hold.
    pub spacing: f64,
    /// Distance between clearance points, metres. Larger: fewer. They only say that space is free: 1.8 mm is ample.
    pub clearance_spacing: f64,
    /// Half width of the central difference of the normals, metres. Larger: smoother normals, rounded edges, a wider rim
    /// without points. ±3 pixels of a 640-wide pad of 0.0295 mm.
    pub normal_half_width: f64,
    /// Steepest gel slope that is believed. Larger: keeps the walls of deep imprints, where the gel is stretched and wrong.
    pub max_slope: f64,
    /// Indentation up to which a gel pixel counts as relaxed, metres. Larger: clearance creeps under the gel's skirt, where the
    /// object may touch without being in the mask.
    pub relaxed_tolerance: f64,
}

impl Default for LiftParams {
    fn default() -> Self {
        Self {
            spacing: 0.7e-3,
            clearance_spacing: 1.8e-3,
            normal_half_width: 3.0 * 0.0295e-3,
            max_slope: 3.0,
            relaxed_tolerance: 0.05e-3,
        }
    }
}

/// Why a contact proves nothing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LiftError {
    /// The height map or mask is unusable.
    #[error(transparent)]
    Contact(#[from] ContactError),
    /// A parameter is out of range.
    #[error("{field} is {found}; it must be {needed}")]
    Params {
        /// Name of the field.
        field: &'static str,
        /// Value found.
        found: f64,
        /// Values allowed.
        needed: &'static str,
    },
    /// No pixel of the mask yields a point with a normal.
    #[error("contact mask covers {mask_pixels} px of {pixels}, none with a usable normal; press harder or elsewhere")]
    NoSurface {
        /// Pixels in the mask.
        mask_pixels: usize,
        /// Pixels of the map.
        pixels: usize,
    },
}

impl LiftParams {
    /// Checks that every length is positive and finite.
    ///
    /// # Errors
    /// [`LiftError::Params`] with field, value and rule.
    pub fn validate(&self) -> Result<(), LiftError> {
        let positive = [
            ("lift.spacing", self.spacing),
            ("lift.clearance_spacing", self.clearance_spacing),
            ("lift.normal_half_width", self.normal_half_width),
            ("lift.max_slope", self.max_slope),
            ("lift.relaxed_tolerance", self.relaxed_tolerance),
        ];
        match positive.into_iter().find(|(_, v)| !(*v > 0.0 && v.is_finite())) {
            Some((field, found)) => Err(LiftError::Params { field, found, needed: "positive and finite" }),
            None => Ok(()),
        }
    }
}

/// Lifts a contact to what it proves of the object: oriented surface points, and gel that touches nothing.
///
/// Mask pixel (row, col) becomes ((col − (W−1)/2)·p, (row − (H−1)/2)·p, z); the outward normal is ∝ (∂z/∂x, ∂z/∂y, −1) from
/// central differences whose neighbours are all in contact (method, §0). Pixels are taken on a regular grid of `spacing`.
/// Clearance: pixels outside the mask whose gel is relaxed. Between the two (the skirt of the imprint, or contact too light
/// for the mask) nothing is said.
///
/// * `world_from_sensor` – pose of the sensor frame in the pressed pose
///
/// Returns points, normals and clearance in the **world** frame, row-major order.
///
/// # Errors
/// [`LiftError::NoSurface`] if no point with a normal remains; [`LiftError::Contact`] for an invalid contact.
pub fn lift(
    contact: &Contact,
    sensor: &TactileSensor,
    world_from_sensor: &Isometry,
    params: &LiftParams,
) -> Result<Patch, LiftError> {
    params.validate()?;
    contact.validate(sensor)?;
    let (points, normals) = surface(contact, sensor, params);
    if points.is_empty() {
        let mask = contact.mask.as_slice();
        let mask_pixels = mask.iter().filter(|&&m| m).count();
        return Err(LiftError::NoSurface { mask_pixels, pixels: mask.len() });
    }
    Ok(Patch {
        points: points.into_iter().map(|p| world_from_sensor * p).collect(),
        normals: normals.into_iter().map(|n| world_from_sensor * n).collect(),
        clearance: clearance(contact, sensor, params).into_iter().map(|p| world_from_sensor * p).collect(),
        world_from_sensor: *world_from_sensor,
    })
}

/// Rows or columns `stride` apart, centred on the pad.
fn grid(length: usize, stride: usize) -> impl Iterator<Item = usize> {
    let first = (length.saturating_sub(1) % stride) / 2;
    (first..length).step_by(stride)
}

/// `distance` in whole pixels, at least one.
fn in_pixels(distance: f64, pitch: f64) -> usize {
    (distance / pitch).round().max(1.0) as usize
}

fn surface(contact: &Contact, sensor: &TactileSensor, params: &LiftParams) -> (Vec<Point>, Vec<Vector>) {
    let (rows, cols) = contact.height_map.shape();
    let pitch = sensor.map_pitch(cols);
    let stride = in_pixels(params.spacing, pitch);
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    for row in grid(rows, stride) {
        for col in grid(cols, stride) {
            if !contact.mask[(row, col)] {
                continue;
            }
            let Some((zx, zy)) = slope(contact, row, col, in_pixels(params.normal_half_width, pitch), pitch) else {
                continue;
            };
            if zx.hypot(zy) >= params.max_slope {
                continue;
            }
            let (x, y) = sensor.pixel_position(row, col, rows, cols);
            points.push(Point::new(x, y, f64::from(contact.height_map[(row, col)])));
            normals.push(Vector::new(zx, zy, -1.0).normalize());
        }
    }
    (points, normals)
}

/// (∂z/∂x, ∂z/∂y) by central differences over ±`step` pixels; `None` unless all four neighbours are in contact.
fn slope(contact: &Contact, row: usize, col: usize, step: usize, pitch: f64) -> Option<(f64, f64)> {
    let z = |r: usize, c: usize| -> Option<f64> {
        let felt: &Raster<bool> = &contact.mask;
        (*felt.get(r, c)?).then(|| f64::from(contact.height_map[(r, c)]))
    };
    let run = 2.0 * step as f64 * pitch;
    let zx = (z(row, col + step)? - z(row, col.checked_sub(step)?)?) / run;
    let zy = (z(row + step, col)? - z(row.checked_sub(step)?, col)?) / run;
    Some((zx, zy))
}

fn clearance(contact: &Contact, sensor: &TactileSensor, params: &LiftParams) -> Vec<Point> {
    let (rows, cols) = contact.height_map.shape();
    let stride = in_pixels(params.clearance_spacing, sensor.map_pitch(cols));
    let mut points = Vec::new();
    for row in grid(rows, stride) {
        for col in grid(cols, stride) {
            let (z, relaxed) = (f64::from(contact.height_map[(row, col)]), sensor.relaxed_z(row, col, rows, cols));
            if contact.mask[(row, col)] || relaxed - z > params.relaxed_tolerance {
                continue;
            }
            let (x, y) = sensor.pixel_position(row, col, rows, cols);
            // A gel that reads above its relaxed shape is a bulge or decoder noise: claim no more than the relaxed gel does.
            points.push(Point::new(x, y, z.min(relaxed)));
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    /// The exact imprint of a tilted plane z = z0 + a x + b y (indented where below the flat gel).
    fn tilted_plane(a: f64, b: f64, z0: f64) -> (Contact, TactileSensor) {
        let sensor = TactileSensor::preset("gelsight-mini").expect("listed");
        let plane = |r: usize, c: usize| {
            let (x, y) = sensor.pixel_position(r, c, 240, 320);
            z0 + a * x + b * y
        };
        let height_map = Raster::from_fn(240, 320, |r, c| plane(r, c).min(0.0) as f32);
        let mask = Raster::from_fn(240, 320, |r, c| plane(r, c) < -0.4e-3);
        (Contact::new(height_map, mask, &sensor).expect("valid"), sensor)
    }

    #[test]
    fn a_tilted_plane_comes_back_with_its_points_and_outward_normal() {
        let (contact, sensor) = tilted_plane(0.1, -0.05, -0.6e-3);
        let pose = Isometry::from_parts(
            nalgebra::Translation3::new(0.1, -0.2, 0.3),
            UnitQuaternion::from_euler_angles(0.3, -0.7, 1.1),
        );
        let patch = lift(&contact, &sensor, &pose, &LiftParams::default()).expect("contact");
        let expected = pose * Vector::new(0.1, -0.05, -1.0).normalize();
        assert!(patch.points.len() > 100);
        for (p, n) in patch.points.iter().zip(&patch.normals) {
            let local = pose.inverse_transform_point(p);
            assert!((local.z - (-0.6e-3 + 0.1 * local.x - 0.05 * local.y)).abs() < 1e-9);
            assert!((n - expected).norm() < 1e-4, "{n:?} {expected:?}");
        }
        // Outward of the object is against the press.
        assert!(expected.dot(&patch.press_direction()) < 0.0);
    }

    #[test]
    fn clearance_lies_on_relaxed_gel_only_and_never_in_light_contact() {
        let (contact, sensor) = tilted_plane(0.1, 0.0, -0.3e-3);
        let patch = lift(&contact, &sensor, &Isometry::identity(), &LiftParams::default()).expect("contact");
        assert!(!patch.clearance.is_empty());
        for p in &patch.clearance {
            // The plane is at -0.3 mm + 0.1 x: relaxed within 0.05 mm means x > 2.5 mm.
            assert!(p.x > 2.4e-3, "{p}");
            assert!(p.z <= 0.0);
        }
        assert!(patch.points.iter().all(|p| p.x < -1.0e-3));
    }

    #[test]
    fn points_are_spaced_alike_at_every_resolution() {
        let sensor = TactileSensor::preset("ycb-sight").expect("listed");
        for cols in [640usize, 320, 160] {
            let rows = sensor.map_rows(cols);
            let relaxed = sensor.relaxed(rows, cols);
            let contact = Contact::new(relaxed.map(|z| z - 0.5e-3), relaxed.map(|_| true), &sensor).expect("valid");
            let patch = lift(&contact, &sensor, &Isometry::identity(), &LiftParams::default()).expect("contact");
            let (w, h) = sensor.pad_size();
            let expected = w * h / 0.7e-3f64.powi(2);
            let found = patch.points.len() as f64;
            assert!((found / expected - 1.0).abs() < 0.15, "{cols}: {found} of {expected}");
        }
    }

    #[test]
    fn an_empty_mask_is_an_error_that_says_so() {
        let (mut contact, sensor) = tilted_plane(0.0, 0.0, -0.6e-3);
        contact.mask = contact.mask.map(|_| false);
        let error = lift(&contact, &sensor, &Isometry::identity(), &LiftParams::default());
        assert!(matches!(error, Err(LiftError::NoSurface { mask_pixels: 0, pixels: 76800 })));
    }
}
