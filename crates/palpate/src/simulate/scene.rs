use super::camera::take_frame;
use super::touches::make_touches;
use super::{CameraParams, TouchParams};
use crate::geometry::{Isometry, Raster, TriangleMesh};
use crate::scene::{PoseSigma, Scene};
use crate::tactile::optics::OpticsError;
use crate::tactile::{PressError, SensorError};
use serde::{Deserialize, Serialize};

/// One simulated scene: which view, which touches, which noise. The defaults are the benchmark's protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub struct SimulateParams {
    /// Number of the view: chooses the elevation and draws its own azimuth, noise and touches.
    pub view: usize,
    /// Seed of everything random.
    pub seed: u64,
    /// The depth camera.
    pub camera: CameraParams,
    /// The touches.
    pub touch: TouchParams,
}

/// A scene and what it was made of.
#[derive(Debug, Clone)]
pub struct SimulatedScene {
    /// What a robot would have recorded.
    pub scene: Scene,
    /// The object's surface in the world frame.
    pub truth: TriangleMesh,
    /// Image of the gel that nothing touches, if tactile images were asked for.
    pub tactile_background: Option<Raster<[u8; 3]>>,
}

/// Why a scene could not be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SimulateError {
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
    /// The sensor is unknown or inconsistent.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// The press parameters are out of range.
    #[error("press: {0}")]
    Press(#[from] PressError),
    /// The tactile images cannot be rendered.
    #[error("tactile image: {0}")]
    Optics(#[from] OpticsError),
    /// The mesh has no area.
    #[error("mesh '{name}' has {faces} faces with an area of {area} m² together; a surface is required")]
    EmptyMesh {
        /// Name of the object.
        name: String,
        /// Its faces.
        faces: usize,
        /// Their area, m².
        area: f64,
    },
    /// The mesh is no graspable object, most likely for its unit.
    #[error("mesh '{name}' is {size} m long; between 0.005 and 2 m is expected (is it in mm?)")]
    Size {
        /// Name of the object.
        name: String,
        /// Longest edge of its box, metres.
        size: f64,
    },
}

impl SimulateParams {
    /// Checks all ranges.
    ///
    /// # Errors
    /// The first [`SimulateError`] found.
    pub fn validate(&self) -> Result<(), SimulateError> {
        self.camera.validate()?;
        self.touch.validate().map(|_| ())
    }
}

/// The mesh stood on z = 0 with its box centred in x and y: where the benchmark puts every object.
pub fn place(mesh: &TriangleMesh) -> TriangleMesh {
    mesh.bounds().map_or_else(TriangleMesh::default, |b| {
        let c = b.center();
        mesh.transformed(&Isometry::translation(-c.x, -c.y, -b.min.z))
    })
}

/// Simulates one scene of an object by the benchmark's protocol.
///
/// The object is placed ([`place`]), seen from a seeded azimuth at the view's elevation, and touched where the fingertip can
/// reach it. **Fewer touches than asked for are made if no reachable point is left**: compare `scene.touches.len()`.
///
/// * `object` – name; part of the seed, and with the view the scene's name
/// * `mesh` – metres, z up, any position
///
/// # Errors
/// [`SimulateError`] for a parameter out of range or a mesh without surface or of absurd size.
pub fn simulate_scene(
    object: &str,
    mesh: &TriangleMesh,
    params: &SimulateParams,
) -> Result<SimulatedScene, SimulateError> {
    params.validate()?;
    check_mesh(object, mesh)?;
    let truth = place(mesh);
    let (view, seed) = (params.view, params.seed);
    let frame = take_frame(object, &truth, &params.camera, view, seed);
    let touches = make_touches(object, &truth, frame.support.as_ref(), &params.touch, view, seed)?;
    let scene = Scene {
        name: format!("{object}_view{view}"),
        frame,
        sensor: if params.touch.count > 0 { Some(params.touch.validate()?) } else { None },
        pose_sigma: PoseSigma {
            translation: params.touch.pose_sigma_translation,
            rotation: params.touch.pose_sigma_rotation,
        },
        touches,
    };
    let tactile_background = match &scene.sensor {
        Some(sensor) => match params.touch.images.optics(sensor)? {
            Some(optics) => Some(params.touch.images.no_contact(&optics)?),
            None => None,
        },
        None => None,
    };
    Ok(SimulatedScene { scene, truth, tactile_background })
}

pub(super) fn check_mesh(name: &str, mesh: &TriangleMesh) -> Result<(), SimulateError> {
    let area = mesh.area();
    if mesh.is_empty() || area.is_nan() || area <= 0.0 {
        return Err(SimulateError::EmptyMesh { name: name.to_owned(), faces: mesh.faces.len(), area });
    }
    let size = mesh.bounds().map_or(0.0, |b| b.size().max());
    if !(0.005..=2.0).contains(&size) {
        return Err(SimulateError::Size { name: name.to_owned(), size });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::Solid;
    use super::*;

    fn params(count: usize) -> SimulateParams {
        SimulateParams {
            touch: TouchParams { count, map_width: 80, ..TouchParams::default() },
            ..SimulateParams::default()
        }
    }

    #[test]
    fn same_seed_same_scene_other_view_other_scene() {
        let mesh = Solid::named("pyramid").expect("listed").mesh(1e-5, 4e-3);
        let make = |view, seed| {
            let p = SimulateParams { view, seed, ..params(2) };
            simulate_scene("pyramid", &mesh, &p).expect("valid").scene
        };
        let (a, b, c, d) = (make(0, 1), make(0, 1), make(1, 1), make(0, 2));
        let bits = |s: &Scene| s.frame.depth.as_slice().iter().map(|z| z.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&a), bits(&b));
        assert_eq!(a.touches[1].contact, b.touches[1].contact);
        assert_ne!(bits(&a), bits(&c));
        assert_ne!(bits(&a), bits(&d));
        assert_ne!(a.touches[1].world_from_sensor, d.touches[1].world_from_sensor);
        assert_eq!(c.name, "pyramid_view1");
    }

    #[test]
    fn depth_pixels_lie_on_the_placed_truth() {
        let solid = Solid::named("torus").expect("listed");
        let far = Isometry::translation(0.3, -0.2, 1.0);
        let p = SimulateParams { camera: CameraParams { sigma: 0.0, ..CameraParams::default() }, ..params(0) };
        let made = simulate_scene("torus", &solid.mesh(5e-6, 3e-3).transformed(&far), &p).expect("valid");
        let frame = &made.scene.frame;
        let mut seen = 0;
        for (row, col, &z) in frame.depth.pixels().filter(|(_, _, z)| z.is_finite()) {
            let p = frame.world_from_camera
                * nalgebra::Point3::from(frame.camera.ray(col as f64, row as f64) * f64::from(z));
            assert!(solid.signed_distance(&p).abs() < 10e-6, "{row} {col}");
            seen += 1;
        }
        assert!(seen > 1000);
        assert!(made.scene.sensor.is_none() && made.scene.touches.is_empty());
    }

    #[test]
    fn meshes_in_millimetres_and_empty_meshes_are_refused() {
        let mm = Solid::Cuboid { size: [60.0; 3] }.mesh(0.01, 30.0);
        let message = simulate_scene("cube", &mm, &params(0)).expect_err("mm").to_string();
        assert!(message.contains("in mm"), "{message}");
        let none = simulate_scene("none", &TriangleMesh::default(), &params(0));
        assert!(matches!(none, Err(SimulateError::EmptyMesh { faces: 0, .. })));
    }
}
