use super::super::SimulateError;
use super::super::seed::stream;
use super::super::touches::{aim, sample_surface};
use super::{LightParams, Primitive};
use crate::geometry::{Isometry, Raster, TriangleMesh, Vector};
use crate::tactile::optics::TactileOptics;
use crate::tactile::{Contact, PressParams, Pressed, TactileSensor, press, press_surface, resample};
use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// Which presses a data set holds. Each press depends on its index and these values alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PressSetParams {
    /// Preset name of the sensor.
    pub sensor: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Width of the images and maps kept, pixels. They are simulated at the sensor's size and averaged down.
    pub width: usize,
    /// Range of the press depth, metres. 0.3–1.5 mm covers a gel's use; equal ends for one depth (YCB-Sight: 1 mm).
    pub depth: (f64, f64),
    /// Share of presses on analytic primitives instead of meshes. Larger: more exact flat and round faces, fewer real shapes.
    pub primitives: f64,
    /// Largest tilt against the surface normal, radians; half of the presses on meshes are tilted.
    pub tilt: f64,
    /// Lights and camera.
    pub light: LightParams,
}

impl Default for PressSetParams {
    fn default() -> Self {
        Self {
            sensor: "ycb-sight".to_owned(),
            seed: 0,
            width: 320,
            depth: (0.3e-3, 1.5e-3),
            primitives: 0.4,
            tilt: 8f64.to_radians(),
            light: LightParams::default(),
        }
    }
}

/// What was pressed, and how.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PressRecord {
    /// Number of the press in its set.
    pub index: usize,
    /// Name of the mesh, or `primitive:<family>`.
    pub object: String,
    /// Press depth, metres.
    pub depth: f64,
    /// Share of the pad in contact.
    pub contact: f64,
}

/// One press: the image and what the gel really did.
#[derive(Debug, Clone, PartialEq)]
pub struct PressSample {
    /// sRGB image.
    pub image: Raster<[u8; 3]>,
    /// Height map (z in the sensor frame, metres) and mask; same size.
    pub contact: Contact,
}

/// Makes presses by index: unlimited, in any order, by any number of workers.
pub struct PressSampler {
    objects: Vec<(String, TriangleMesh)>,
    params: PressSetParams,
    optics: TactileOptics,
}

/// Attempts at one press before another object is drawn, and objects before the surface counts as unreachable.
const ATTEMPTS: usize = 40;

impl PressSampler {
    /// Checks parameters and prepares the optics.
    ///
    /// * `objects` – names and meshes, metres; may be empty if `params.primitives` is 1
    ///
    /// # Errors
    /// [`SimulateError`] for a parameter out of range, an unknown sensor, or meshes without area.
    pub fn new(objects: Vec<(String, TriangleMesh)>, params: PressSetParams) -> Result<Self, SimulateError> {
        let sensor = TactileSensor::preset(&params.sensor)?;
        let check = |field, found: f64, ok: bool, needed| {
            if ok { Ok(()) } else { Err(SimulateError::Params { field, found, needed }) }
        };
        let (low, high) = params.depth;
        check("depth", low, low > 0.0 && low <= high && high < 5e-3, "low to high in (0, 0.005) m")?;
        let share = params.primitives;
        check("primitives", share, (0.0..=1.0).contains(&share), "in [0, 1]")?;
        let enough = !objects.is_empty() || share == 1.0;
        check("primitives", share, enough, "1 when there is no mesh")?;
        check("tilt", params.tilt, (0.0..=0.7).contains(&params.tilt), "in [0, 0.7] rad")?;
        let width = params.width;
        let fits = width >= 32 && width <= sensor.width && sensor.width % width == 0;
        check("width", width as f64, fits, "at least 32 px and a whole part of the sensor's width")?;
        params.light.validate()?;
        for (name, mesh) in &objects {
            super::super::scene::check_mesh(name, mesh)?;
        }
        let optics = TactileOptics::preset(&sensor)?;
        Ok(Self { objects, params, optics })
    }

    /// The parameters in force.
    pub fn params(&self) -> &PressSetParams {
        &self.params
    }

    /// The sensor.
    pub fn sensor(&self) -> &TactileSensor {
        self.optics.sensor()
    }

    /// The no-contact image at the set's size, without disturbance.
    pub fn background(&self) -> Raster<[u8; 3]> {
        self.shrink(&self.optics.no_contact())
    }

    /// Makes press `index`.
    ///
    /// # Errors
    /// [`SimulateError::Params`] if the meshes cannot be pressed anywhere.
    pub fn sample(&self, index: usize) -> Result<(PressRecord, PressSample), SimulateError> {
        let mut rng = stream(self.params.seed, "presses", index, "press");
        for _ in 0..ATTEMPTS {
            let Some((object, pressed, depth)) = self.attempt(&mut rng) else { continue };
            let mut image = self.optics.render(&pressed.contact.height_map)?;
            self.params.light.apply(&mut image, &mut rng);
            let contact = self.shrink_contact(&pressed.contact);
            let felt = contact.mask.as_slice().iter().filter(|&&m| m).count();
            let share = felt as f64 / contact.mask.as_slice().len() as f64;
            let record = PressRecord { index, object, depth, contact: share };
            return Ok((record, PressSample { image: self.shrink(&image), contact }));
        }
        Err(SimulateError::Params {
            field: "objects",
            found: self.objects.len() as f64,
            needed: "meshes with a surface that the pad can reach",
        })
    }

    fn attempt(&self, rng: &mut Pcg64Mcg) -> Option<(String, Pressed, f64)> {
        let sensor = self.sensor();
        let (low, high) = self.params.depth;
        let depth = low + (high - low) * rng.random::<f64>();
        let press_params = PressParams { depth, max_retreat: 2e-3, ..PressParams::default() };
        if rng.random::<f64>() < self.params.primitives {
            let shape = Primitive::random(rng);
            let mut surface = shape.surface(sensor, sensor.height, sensor.width);
            // The primitive comes from where its highest point is, not from its own origin.
            let top = surface.as_slice().iter().copied().fold(f32::INFINITY, f32::min);
            surface.as_mut_slice().iter_mut().for_each(|z| *z -= top);
            let pressed = press_surface(&surface, &Isometry::identity(), sensor, &press_params).ok()?;
            return Some((format!("primitive:{}", shape.name()), pressed, depth));
        }
        let (name, mesh) = &self.objects[rng.random_range(0..self.objects.len())];
        (0..ATTEMPTS).find_map(|_| {
            let (point, normal) = sample_surface(mesh, 1, rng).pop()?;
            let mut pose = aim(&point, &normal, std::f64::consts::TAU * rng.random::<f64>());
            if rng.random::<bool>() {
                let (angle, way) =
                    (self.params.tilt * rng.random::<f64>().sqrt(), std::f64::consts::TAU * rng.random::<f64>());
                pose *= Isometry::new(Vector::zeros(), Vector::new(way.cos(), way.sin(), 0.0) * angle);
            }
            let pressed = press(mesh, &pose, sensor, sensor.width, &press_params).ok()?;
            Some((name.clone(), pressed, depth))
        })
    }

    fn shape(&self) -> (usize, usize) {
        (self.sensor().map_rows(self.params.width), self.params.width)
    }

    fn shrink(&self, image: &Raster<[u8; 3]>) -> Raster<[u8; 3]> {
        let (rows, cols) = self.shape();
        resample::resize(&image.map(|p| p.map(f32::from)), rows, cols).map(|p| p.map(|v| v.round() as u8))
    }

    fn shrink_contact(&self, contact: &Contact) -> Contact {
        let (rows, cols) = self.shape();
        let share = resample::resize(&contact.mask.map(|&m| f32::from(u8::from(m))), rows, cols);
        Contact { height_map: resample::resize(&contact.height_map, rows, cols), mask: share.map(|&s| s >= 0.5) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::Solid;
    use super::*;

    fn sampler(primitives: f64) -> PressSampler {
        let cube = Solid::named("cube").expect("listed").mesh(1e-5, 3e-3);
        let params = PressSetParams { primitives, ..PressSetParams::default() };
        PressSampler::new(vec![("cube".to_owned(), cube)], params).expect("valid")
    }

    #[test]
    fn a_press_depends_on_its_index_alone() {
        let s = sampler(0.5);
        let (record, sample) = s.sample(7).expect("reachable");
        s.sample(3).expect("reachable");
        assert_eq!(s.sample(7).expect("reachable"), (record.clone(), sample));
        assert_ne!(s.sample(8).expect("reachable").0, record);
    }

    #[test]
    fn depths_and_contacts_are_what_was_asked_for() {
        let s = sampler(0.5);
        for index in 0..12 {
            let (record, sample) = s.sample(index).expect("reachable");
            assert!((0.3e-3..=1.5e-3).contains(&record.depth) && record.contact >= 0.004, "{record:?}");
            let (rows, cols) = sample.image.shape();
            assert_eq!((rows, cols), (240, 320));
            let relaxed = s.sensor().relaxed(rows, cols);
            let deepest = sample
                .contact
                .height_map
                .as_slice()
                .iter()
                .zip(relaxed.as_slice())
                .map(|(z, g)| g - z)
                .fold(0.0f32, f32::max);
            // The membrane's last blur takes a little off a sharp peak.
            assert!(deepest < record.depth as f32 + 1e-5 && deepest > 0.5 * record.depth as f32, "{record:?}");
        }
    }

    #[test]
    fn impossible_sets_are_refused() {
        let params = PressSetParams { primitives: 0.5, ..PressSetParams::default() };
        assert!(PressSampler::new(Vec::new(), params.clone()).is_err());
        assert!(PressSampler::new(Vec::new(), PressSetParams { primitives: 1.0, width: 300, ..params }).is_err());
    }
}
