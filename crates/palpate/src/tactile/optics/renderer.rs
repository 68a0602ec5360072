use super::photometry::surface_directions;
use super::{MarkerField, MarkerParams, OpticsError, PhotometricTable, PressedGel, ShadowTable};
use super::{cast_shadows, draw_markers, presets, soften};
use crate::geometry::Raster;
use crate::tactile::gaussian::{Border, blur_channels, kernel_of_sigma};
use crate::tactile::resample::resize;
use crate::tactile::{Contact, TactileSensor};
use std::sync::OnceLock;

/// Renders what a fingertip's camera sees of its gel.
///
/// Image = background + colour change of the whole surface, **the dome included**, so the no-contact image is not the background
/// photograph: it is [`Self::no_contact`], and that is what a decoder must be given.
#[derive(Debug, Clone)]
pub struct TactileOptics {
    sensor: TactileSensor,
    table: PhotometricTable,
    /// Processed background of the sensor's size, grey levels.
    background: Raster<[f32; 3]>,
}

impl TactileOptics {
    /// The optics of a sensor preset, with the background that ships with the crate.
    ///
    /// | preset | table | background |
    /// |---|---|---|
    /// | `ycb-sight` | Taxim's default gel | derived from Taxim's two published images |
    /// | `gelsight-mini` | **borrowed** from the default gel: right geometry, another sensor's colours | the same |
    /// | `gelsight-r15`, `digit` | Taxim's for that sensor | plain grey: none is published under a free licence |
    ///
    /// # Errors
    /// [`OpticsError::NoTable`] for other models.
    pub fn preset(sensor: &TactileSensor) -> Result<Self, OpticsError> {
        let table = presets::table(&sensor.model)?.clone();
        Self::new(sensor.clone(), table, &presets::background(&sensor.model))
    }

    /// Optics from a table and a photograph of the gel without contact, of any size.
    ///
    /// # Errors
    /// [`OpticsError::Sensor`] if the sensor is inconsistent.
    pub fn new(
        sensor: TactileSensor,
        table: PhotometricTable,
        background: &Raster<[u8; 3]>,
    ) -> Result<Self, OpticsError> {
        sensor.validate()?;
        let background = smooth(&background.map(|p| p.map(f32::from)));
        let background = resize(&background, sensor.height, sensor.width);
        Ok(Self { sensor, table, background })
    }

    /// The sensor whose images these are.
    pub fn sensor(&self) -> &TactileSensor {
        &self.sensor
    }

    /// Renders a deformed gel, without shadows: the images of YCB-Sight.
    ///
    /// * `height_map` – z of the gel surface in the sensor frame, metres, of the **sensor's** size
    ///
    /// Returns the sRGB image of the sensor's size.
    ///
    /// # Errors
    /// [`OpticsError::Size`] for a map of another size.
    ///
    /// # References
    /// Si & Yuan, *Taxim*, RA-L 2022, §IV-B; the background is smoothed as there.
    pub fn render(&self, height_map: &Raster<f32>) -> Result<Raster<[u8; 3]>, OpticsError> {
        let height_px = self.height_px(height_map)?;
        Ok(self.on_background(self.table.colour_change(&height_px)).map(quantised))
    }

    /// Renders a contact with the shadows that its rim casts: nearer to a real sensor's image, six times as slow.
    ///
    /// Shadow lengths are those of Taxim's gel at 640 × 480; other sensors borrow them.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub fn render_with_shadows(&self, contact: &Contact) -> Result<Raster<[u8; 3]>, OpticsError> {
        static TABLE: OnceLock<ShadowTable> = OnceLock::new();
        let height_px = self.height_px(&contact.height_map)?;
        let direction = surface_directions(&height_px).map(|d| d.1);
        let (rows, cols) = height_px.shape();
        let contact_height_mm = Raster::from_fn(rows, cols, |row, col| {
            1e3 * (self.sensor.relaxed_z(row, col, rows, cols) as f32 - contact.height_map[(row, col)])
        });
        // The table's channels are B, G, R.
        let turned = |[a, b, c]: &[f32; 3]| [*c, *b, *a];
        let mut change = self.table.colour_change(&height_px).map(turned);
        let gel = PressedGel {
            height_px: &height_px,
            direction: &direction,
            contact_height_mm: &contact_height_mm,
            mask: &contact.mask,
        };
        cast_shadows(&mut change, &gel, TABLE.get_or_init(ShadowTable::taxim))?;
        let mut image = self.on_background(change.map(turned));
        soften(&mut image);
        Ok(image.map(quantised))
    }

    /// Draws marker dots on a rendered image, moved as the press moves the gel.
    ///
    /// * `shear` – drag of the contact along columns and rows, metres
    ///
    /// # Errors
    /// [`OpticsError::Marker`] for parameters out of range.
    pub fn draw_markers(
        &self,
        image: &mut Raster<[u8; 3]>,
        contact: &Contact,
        shear: (f64, f64),
        params: &MarkerParams,
    ) -> Result<(), OpticsError> {
        let (rows, cols) = contact.height_map.shape();
        let depth_mm = Raster::from_fn(rows, cols, |row, col| {
            1e3 * (self.sensor.relaxed_z(row, col, rows, cols) as f32 - contact.height_map[(row, col)])
        });
        let pitch = self.sensor.map_pitch(cols);
        let field = MarkerField::new(pitch)?;
        let moved = field.displacement(&depth_mm, &contact.mask, (shear.0 * 1e3, shear.1 * 1e3))?;
        Ok(draw_markers(image, &moved, pitch, params)?)
    }

    /// H: how far the gel is pressed in, dome included, in pixels.
    fn height_px(&self, height_map: &Raster<f32>) -> Result<Raster<f32>, OpticsError> {
        let needed = (self.sensor.height, self.sensor.width);
        if height_map.shape() != needed {
            return Err(OpticsError::Size { what: "height map", found: height_map.shape(), needed });
        }
        let per_pixel = -1.0 / self.sensor.pixel_pitch as f32;
        Ok(height_map.map(|z| z * per_pixel))
    }

    fn on_background(&self, mut change: Raster<[f32; 3]>) -> Raster<[f32; 3]> {
        for (pixel, background) in change.as_mut_slice().iter_mut().zip(self.background.as_slice()) {
            for (value, b) in pixel.iter_mut().zip(background) {
                *value += b;
            }
        }
        change
    }

    /// What the camera sees when nothing touches the gel.
    pub fn no_contact(&self) -> Raster<[u8; 3]> {
        let relaxed = self.sensor.relaxed(self.sensor.height, self.sensor.width);
        self.render(&relaxed).expect("the relaxed gel has the sensor's size")
    }
}

/// Rounded to grey levels; what is out of range is cut.
fn quantised(pixel: &[f32; 3]) -> [u8; 3] {
    pixel.map(|v| v.round() as u8)
}

/// σ of the wide blur of the background, in widths of the image: 50 px of 640.
const BACKGROUND_SIGMA: f64 = 50.0 / 640.0;

/// Taxim's processed background: the photograph itself, but dark specks replaced and the rest mixed with a wide blur.
///
/// f = blur of [`BACKGROUND_SIGMA`]; where the mean over channels of f − photo is under 5 levels: 0.15 f + 0.85 photo; elsewhere f.
fn smooth(photo: &Raster<[f32; 3]>) -> Raster<[f32; 3]> {
    // A quarter of the size is enough for so wide a blur, and sixteen times as fast.
    let mut small = resize(photo, photo.rows().div_ceil(4), photo.cols().div_ceil(4));
    let taps = kernel_of_sigma(BACKGROUND_SIGMA * small.cols() as f64);
    blur_channels(&mut small, &taps, Border::Reflect);
    let wide = resize(&small, photo.rows(), photo.cols());
    let mix = |(f, p): (&[f32; 3], &[f32; 3])| {
        let darker = (0..3).map(|k| f[k] - p[k]).sum::<f32>() / 3.0;
        std::array::from_fn(|k| if darker < 5.0 { 0.15 * f[k] + 0.85 * p[k] } else { f[k] })
    };
    let data = wide.as_slice().iter().zip(photo.as_slice()).map(mix).collect();
    Raster::from_vec(photo.rows(), photo.cols(), data).expect("same size")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_renders_an_image_that_a_press_changes() {
        for name in TactileSensor::PRESETS {
            let sensor = TactileSensor::preset(name).expect("listed");
            let optics = TactileOptics::preset(&sensor).expect("has a table");
            let (rows, cols) = (sensor.height, sensor.width);
            let rest = optics.no_contact();
            assert_eq!(rest.shape(), (rows, cols));
            // A bump of half a millimetre in the middle.
            let bump = Raster::from_fn(rows, cols, |r, c| {
                let (x, y) = sensor.pixel_position(r, c, rows, cols);
                sensor.relaxed_z(r, c, rows, cols) as f32 - 0.5e-3 * (-(x * x + y * y) / 8e-6).exp() as f32
            });
            let pressed = optics.render(&bump).expect("the sensor's size");
            let change = |r: usize, c: usize| {
                let (a, b) = (rest[(r, c)], pressed[(r, c)]);
                (0..3).map(|k| a[k].abs_diff(b[k]) as u32).sum::<u32>()
            };
            assert!(change(rows / 2, cols / 2 + cols / 10) > 8, "{name}");
            assert!(change(3, 3) <= 3, "{name}: {}", change(3, 3));
        }
    }

    #[test]
    fn a_map_of_another_size_is_refused() {
        let sensor = TactileSensor::preset("ycb-sight").expect("listed");
        let optics = TactileOptics::preset(&sensor).expect("has a table");
        assert!(matches!(
            optics.render(&Raster::filled(240, 320, 0.0)),
            Err(OpticsError::Size { needed: (480, 640), .. })
        ));
    }
}
