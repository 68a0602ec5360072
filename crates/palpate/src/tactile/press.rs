use super::gaussian::{blur, kernel};
use super::{Contact, TactileSensor};
use crate::geometry::{Isometry, Point, Raster, TriangleMesh, Vector};
use serde::{Deserialize, Serialize};

/// How the fingertip is pressed, and how the gel answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PressParams {
    /// Travel after first contact, metres. Larger: wider, deeper imprints. 1 mm is the YCB-Sight protocol.
    pub depth: f64,
    /// Penetration that counts as contact, as a share of `depth`. Larger: smaller masks. 0.4 is Taxim's contact scale.
    pub contact_share_of_depth: f64,
    /// Largest retreat from the aimed point until nothing else is touched first, metres. Larger: presses in which the contact is
    /// at the pad's rim are kept. At 1 mm the aimed point is still inside the pad.
    pub max_retreat: f64,
    /// Smallest share of the pad that must be in contact. Larger: refuses tips and edges.
    pub min_contact: f64,
    /// Length of the fingertip behind the pad that must be free of the object, metres. Larger: refuses narrow cavities.
    pub body_length: f64,
    /// Gaussian kernels of the gel's membrane, pixels of a 640-wide pad of 18.9 mm, in order; the last pass repeats the last
    /// kernel without restoring the contact. More or larger: a wider skirt.
    pub kernels: Vec<usize>,
}

impl Default for PressParams {
    fn default() -> Self {
        Self {
            depth: 1.0e-3,
            contact_share_of_depth: 0.4,
            max_retreat: 1.0e-3,
            min_contact: 0.005,
            body_length: 0.03,
            kernels: vec![51, 31, 21, 11, 5],
        }
    }
}

impl PressParams {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`PressError::Params`] with field, value and rule.
    pub fn validate(&self) -> Result<(), PressError> {
        let check = |field, found: f64, ok: bool, needed| {
            if ok { Ok(()) } else { Err(PressError::Params { field, found, needed }) }
        };
        check("depth", self.depth, self.depth > 0.0 && self.depth < Contact::MAX_HEIGHT / 2.0, "in (0, 0.01) m")?;
        let share = self.contact_share_of_depth;
        check("contact_share_of_depth", share, (0.0..1.0).contains(&share), "in [0, 1)")?;
        check("max_retreat", self.max_retreat, self.max_retreat >= 0.0, "at least 0 m")?;
        check("min_contact", self.min_contact, (0.0..1.0).contains(&self.min_contact), "in [0, 1)")?;
        check("body_length", self.body_length, self.body_length >= self.max_retreat, "at least max_retreat")?;
        let even = self.kernels.iter().find(|&&k| k < 3 || k % 2 == 0);
        check("kernels", even.map_or(0.0, |&k| k as f64), even.is_none(), "odd and at least 3 px")
    }
}

/// Why a press gives nothing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PressError {
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
    /// The object is not under the pad.
    #[error("no part of the object lies under the pad")]
    Missed,
    /// Something else would be touched long before the aimed point.
    #[error("the pad meets the object {retreat} m before the aimed point; at most {limit} m is allowed")]
    Blocked {
        /// Retreat needed, metres.
        retreat: f64,
        /// Retreat allowed, metres.
        limit: f64,
    },
    /// The contact is too small to use.
    #[error("contact covers {share} of the pad; at least {needed} is required")]
    TooLittleContact {
        /// Share found.
        share: f64,
        /// Share needed.
        needed: f64,
    },
}

/// What a press recorded.
#[derive(Debug, Clone)]
pub struct Pressed {
    /// Height map and mask.
    pub contact: Contact,
    /// Pose of the sensor frame in the pressed pose.
    pub world_from_sensor: Isometry,
    /// How far the pad had to retreat from the aimed point to touch nothing before the press, metres, ≥ 0.
    pub retreat: f64,
}

/// Presses the sensor on a mesh and returns the deformed gel.
///
/// The pad comes along +z of `world_from_aim` until it first touches, anywhere, then travels `depth` further. With z the object's
/// height (nearest to the pad) and g ≤ 0 the relaxed gel, both at first contact: gel = min(z − depth, g); contact where
/// g − gel > 0.4 · depth; then Gaussian passes, the contact restored after each, imitate the membrane. The mask is **narrower
/// than physical contact**.
///
/// * `world_from_aim` – the aimed surface point and the approach: +z into the object, x along columns
/// * `cols` – width of the height map, pixels; its rows follow from the sensor
///
/// # Errors
/// [`PressError`] if the object is missed, in the way of the pad, or hardly touched.
///
/// # References
/// Si & Yuan, *Taxim: an example-based simulation model for GelSight tactile sensors*, RA-L 2022, §IV-A (deformation); Suresh et
/// al., *ShapeMap 3-D*, ICRA 2022 (protocol). Kernels are scaled with the map, so that 320 columns give the same imprint.
pub fn press(
    mesh: &TriangleMesh,
    world_from_aim: &Isometry,
    sensor: &TactileSensor,
    cols: usize,
    params: &PressParams,
) -> Result<Pressed, PressError> {
    params.validate()?;
    let rows = sensor.map_rows(cols);
    let object = nearest_surface(mesh, world_from_aim, sensor, (rows, cols), params);
    press_surface(&object, world_from_aim, sensor, params)
}

/// [`press`] on a surface that is already a raster.
///
/// * `object` – z of the object's surface nearest to the pad in the aim frame, metres, infinite where there is none; row and
///   col over the whole pad
///
/// # Errors
/// As [`press`].
pub fn press_surface(
    object: &Raster<f32>,
    world_from_aim: &Isometry,
    sensor: &TactileSensor,
    params: &PressParams,
) -> Result<Pressed, PressError> {
    params.validate()?;
    let (rows, cols) = object.shape();
    let relaxed = sensor.relaxed(rows, cols);
    let lowest = object.as_slice().iter().zip(relaxed.as_slice()).map(|(z, g)| z - g).fold(f32::INFINITY, f32::min);
    if !lowest.is_finite() {
        return Err(PressError::Missed);
    }
    // Where the surface curves away between pixel centres, `lowest` is a hair above zero: that is an advance.
    let retreat = f64::from(-lowest);
    if retreat > params.max_retreat {
        return Err(PressError::Blocked { retreat, limit: params.max_retreat });
    }
    let shift = lowest + params.depth as f32;
    let threshold = (params.contact_share_of_depth * params.depth) as f32;
    let pressed = zip_map(object, &relaxed, |z, g| (z - shift).min(g));
    let mask = zip_map(&pressed, &relaxed, |z, g| g - z > threshold);
    let share = mask.as_slice().iter().filter(|&&m| m).count() as f64 / (rows * cols) as f64;
    if share < params.min_contact {
        return Err(PressError::TooLittleContact { share, needed: params.min_contact });
    }
    let height_map = membrane(&pressed, &mask, params, sensor.pixel_pitch * sensor.width as f64);
    Ok(Pressed {
        contact: Contact { height_map, mask },
        world_from_sensor: world_from_aim * nalgebra::Translation3::new(0.0, 0.0, f64::from(shift)),
        retreat: retreat.max(0.0),
    })
}

fn zip_map<A: Copy, B: Copy, C>(a: &Raster<A>, b: &Raster<B>, f: impl Fn(A, B) -> C) -> Raster<C> {
    Raster::from_fn(a.rows(), a.cols(), |r, c| f(a[(r, c)], b[(r, c)]))
}

/// The gel's skirt: blur passes with the contact restored after each, and a last one over everything.
fn membrane(pressed: &Raster<f32>, mask: &Raster<bool>, params: &PressParams, pad_width: f64) -> Raster<f32> {
    /// Pixel pitch that the kernel sizes are stated for, metres.
    const KERNEL_PITCH: f64 = 0.0295e-3;
    let scale = KERNEL_PITCH * pressed.cols() as f64 / pad_width;
    let mut gel = pressed.clone();
    for &size in &params.kernels {
        blur(&mut gel, &kernel(size, scale));
        for ((z, &kept), &felt) in gel.as_mut_slice().iter_mut().zip(pressed.as_slice()).zip(mask.as_slice()) {
            if felt {
                *z = kept;
            }
        }
    }
    if let Some(&size) = params.kernels.last() {
        blur(&mut gel, &kernel(size, scale));
    }
    gel
}

/// z of the object's surface nearest to the pad at each pixel, aim frame, metres; infinite where there is none.
///
/// Orthographic z-buffer of the faces between the back of the fingertip and the deepest point that the gel can reach.
fn nearest_surface(
    mesh: &TriangleMesh,
    world_from_aim: &Isometry,
    sensor: &TactileSensor,
    (rows, cols): (usize, usize),
    params: &PressParams,
) -> Raster<f32> {
    let pitch = sensor.map_pitch(cols);
    let aim_from_world = world_from_aim.inverse();
    let center = Vector::new(0.5 * (cols as f64 - 1.0), 0.5 * (rows as f64 - 1.0), 0.0);
    // x, y in pixels, z in metres.
    let vertices: Vec<Point> = mesh
        .vertices
        .iter()
        .map(|v| {
            let p = aim_from_world * v;
            Point::new(p.x / pitch + center.x, p.y / pitch + center.y, p.z)
        })
        .collect();
    let mut depth = Raster::filled(rows, cols, f32::INFINITY);
    // First contact is at most a gel's sag beyond the aimed point; nothing deeper can matter.
    let reach = params.depth + Contact::MAX_HEIGHT;
    for face in &mesh.faces {
        let t = face.map(|i| vertices[i as usize]);
        let behind = t.iter().all(|p| p.z < -params.body_length);
        if !(behind || t.iter().all(|p| p.z > reach)) {
            rasterize(&t, &mut depth);
        }
    }
    depth
}

/// Lowers the raster to the triangle's z where a pixel centre lies in it; edges belong to both neighbours.
fn rasterize([a, b, c]: &[Point; 3], depth: &mut Raster<f32>) {
    let (rows, cols) = depth.shape();
    let range = |x: f64, y: f64, z: f64, n: usize| {
        let low = x.min(y).min(z).ceil().max(0.0);
        let high = x.max(y).max(z).floor().min(n as f64 - 1.0);
        (low <= high).then_some((low as usize, high as usize))
    };
    let (Some((c0, c1)), Some((r0, r1))) = (range(a.x, b.x, c.x, cols), range(a.y, b.y, c.y, rows)) else { return };
    let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    // Edge-on faces show no pixel that a neighbour does not show.
    if area.abs() < 1e-9 {
        return;
    }
    for row in r0..=r1 {
        let y = row as f64;
        for col in c0..=c1 {
            let x = col as f64;
            let wa = ((b.x - x) * (c.y - y) - (b.y - y) * (c.x - x)) / area;
            let wb = ((c.x - x) * (a.y - y) - (c.y - y) * (a.x - x)) / area;
            let wc = 1.0 - wa - wb;
            if wa.min(wb).min(wc) >= -1e-9 {
                let z = (wa * a.z + wb * b.z + wc * c.z) as f32;
                let pixel = &mut depth[(row, col)];
                *pixel = pixel.min(z);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square plate in z = `z`, wide enough for any pad.
    fn plate(z: f64) -> TriangleMesh {
        let p = |x: f64, y: f64| Point::new(x, y, z);
        let vertices = vec![p(-0.03, -0.03), p(0.03, -0.03), p(0.03, 0.03), p(-0.03, 0.03)];
        TriangleMesh::new(vertices, vec![[0, 2, 1], [0, 3, 2]]).expect("indices")
    }

    fn dome() -> TactileSensor {
        TactileSensor::preset("ycb-sight").expect("listed")
    }

    #[test]
    fn flat_plate_on_a_dome_presses_a_disc_of_the_closed_form_radius() {
        let pressed =
            press(&plate(0.0), &Isometry::identity(), &dome(), 320, &PressParams::default()).expect("contact");
        // Penetration d − r²/2R > 0.4 d inside r = sqrt(1.2 · 50 · 1) mm = 7.75 mm, clipped by the pad's height.
        let (rows, cols) = pressed.contact.mask.shape();
        for (row, col, &felt) in pressed.contact.mask.pixels() {
            let (x, y) = dome().pixel_position(row, col, rows, cols);
            let r = x.hypot(y);
            if (r - 7.72e-3).abs() > 0.1e-3 {
                assert_eq!(felt, r < 7.72e-3, "{row} {col}");
            }
        }
        // The pressed apex is 1 mm inside the plate; the plate itself is flat at −1 mm.
        assert!((pressed.world_from_sensor.translation.z - 1.0e-3).abs() < 1e-6);
        assert!((f64::from(pressed.contact.height_map[(120, 160)]) + 1.0e-3).abs() < 1e-6);
        assert!(pressed.retreat < 1e-6);
    }

    #[test]
    fn resolutions_agree() {
        let mesh = plate(0.0);
        let params = PressParams::default();
        let aim = Isometry::new(Vector::zeros(), Vector::new(0.15, 0.05, 0.0));
        let fine = press(&mesh, &aim, &dome(), 640, &params).expect("contact");
        let half = press(&mesh, &aim, &dome(), 320, &params).expect("contact");
        let mut worst = 0.0f32;
        for (row, col, &z) in half.contact.height_map.pixels() {
            let m = &fine.contact.height_map;
            let (r, c) = (2 * row, 2 * col);
            let mean = 0.25 * (m[(r, c)] + m[(r, c + 1)] + m[(r + 1, c)] + m[(r + 1, c + 1)]);
            worst = worst.max((z - mean).abs());
        }
        assert!(worst < 0.02e-3, "{worst}");
        let shift = fine.world_from_sensor.translation.vector - half.world_from_sensor.translation.vector;
        assert!(shift.norm() < 0.01e-3, "{shift:?}");
    }

    #[test]
    fn the_gel_never_pierces_the_object_by_more_than_the_membrane_blurs() {
        let aim = Isometry::new(Vector::zeros(), Vector::new(0.2, 0.0, 0.0));
        let pressed = press(&plate(0.0), &aim, &dome(), 320, &PressParams::default()).expect("contact");
        let (rows, cols) = pressed.contact.mask.shape();
        for (row, col, &z) in pressed.contact.height_map.pixels() {
            let (x, y) = dome().pixel_position(row, col, rows, cols);
            let world = pressed.world_from_sensor * Point::new(x, y, f64::from(z));
            // The object is z > 0; blurring may leave the gel inside where contact is lighter than the mask.
            assert!(world.z < 0.4e-3, "{row} {col}: {}", world.z);
            if pressed.contact.mask[(row, col)] {
                assert!(world.z.abs() < 0.02e-3, "{row} {col}: {}", world.z);
            }
        }
    }

    #[test]
    fn misses_obstacles_and_bad_parameters_are_told_apart() {
        let params = PressParams::default();
        let far = Isometry::translation(0.5, 0.0, 0.0);
        assert_eq!(press(&plate(0.0), &far, &dome(), 320, &params).err(), Some(PressError::Missed));
        let deep = Isometry::translation(0.0, 0.0, 0.005);
        assert!(matches!(
            press(&plate(0.0), &deep, &dome(), 320, &params),
            Err(PressError::Blocked { retreat, .. }) if (retreat - 0.005).abs() < 1e-5
        ));
        let even = PressParams { kernels: vec![50], ..params };
        assert!(matches!(even.validate(), Err(PressError::Params { field: "kernels", .. })));
    }
}
