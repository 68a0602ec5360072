use crate::geometry::Raster;

/// Shape of the relaxed gel in the sensor frame: z, metres, 0 at the apex, ≤ 0 elsewhere.
#[derive(Debug, Clone, PartialEq)]
pub enum RelaxedGel {
    /// z = 0 everywhere.
    Flat,
    /// A sphere cap with its apex at the pad's centre.
    Dome {
        /// Radius of the sphere, metres.
        radius: f64,
    },
    /// A measured surface of any resolution that spans the pad.
    Map(Raster<f32>),
}

/// Geometry of a visuo-tactile fingertip.
#[derive(Debug, Clone, PartialEq)]
pub struct TactileSensor {
    /// Preset name, or "custom".
    pub model: String,
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Size of a sensor pixel on the gel, metres.
    pub pixel_pitch: f64,
    /// Shape of the gel when nothing touches it.
    pub relaxed_gel: RelaxedGel,
}

/// What is wrong with the description of a sensor.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SensorError {
    /// No preset of this name.
    #[error("no tactile sensor is called '{found}'; known: {}", TactileSensor::PRESETS.join(", "))]
    UnknownPreset {
        /// The name asked for.
        found: String,
    },
    /// The image has no pixel.
    #[error("sensor image is {width} × {height} px; both must be at least 2")]
    Size {
        /// Image width, pixels.
        width: usize,
        /// Image height, pixels.
        height: usize,
    },
    /// The pitch is no plausible pixel size of a fingertip.
    #[error("pixel_pitch is {found} m; a fingertip's pixel lies between 1e-6 and 1e-3 m")]
    Pitch {
        /// Pitch found, metres.
        found: f64,
    },
    /// The dome cannot span the pad.
    #[error("gel dome radius is {radius} m; the pad's half diagonal needs more than {needed} m")]
    Dome {
        /// Radius found, metres.
        radius: f64,
        /// Half the pad's diagonal, metres.
        needed: f64,
    },
    /// A relaxed map holds an impossible height.
    #[error("relaxed gel at (row {row}, col {col}) is {found} m; it must lie in [-0.02, 0] m (is it in mm or pixels?)")]
    RelaxedHeight {
        /// Row of the map.
        row: usize,
        /// Column of the map.
        col: usize,
        /// Value found, metres.
        found: f32,
    },
}

impl TactileSensor {
    /// Names that [`Self::preset`] knows.
    pub const PRESETS: [&'static str; 4] = ["ycb-sight", "gelsight-r15", "gelsight-mini", "digit"];

    /// A known fingertip.
    ///
    /// | name | image | pitch | gel |
    /// |---|---|---|---|
    /// | `ycb-sight` | 640 × 480 | 0.0295 mm | dome, r 50 mm (fit of Taxim's measured gel, rms 0.6 µm) |
    /// | `gelsight-r15` | 240 × 320 | 0.0877 mm | flat |
    /// | `gelsight-mini` | 320 × 240 | 0.0634 mm | flat |
    /// | `digit` | 320 × 240 | 0.0532 mm | flat (the real one is slightly domed); landscape, as its photometric table |
    ///
    /// # Errors
    /// [`SensorError::UnknownPreset`], which lists the names.
    ///
    /// # References
    /// Si & Yuan, *Taxim*, RA-L 2022 (pitches of the default and the DIGIT gel); Suresh et al., *ShapeMap 3-D*, ICRA 2022.
    pub fn preset(name: &str) -> Result<Self, SensorError> {
        let (width, height, pixel_pitch, relaxed_gel) = match name {
            "ycb-sight" => (640, 480, 0.0295e-3, RelaxedGel::Dome { radius: 0.050 }),
            "gelsight-r15" => (240, 320, 0.0877e-3, RelaxedGel::Flat),
            "gelsight-mini" => (320, 240, 0.0634e-3, RelaxedGel::Flat),
            "digit" => (320, 240, 0.0532e-3, RelaxedGel::Flat),
            _ => return Err(SensorError::UnknownPreset { found: name.to_owned() }),
        };
        Ok(Self { model: name.to_owned(), width, height, pixel_pitch, relaxed_gel })
    }

    /// Checks sizes, units and the relaxed surface.
    ///
    /// # Errors
    /// The first [`SensorError`] found.
    pub fn validate(&self) -> Result<(), SensorError> {
        if self.width < 2 || self.height < 2 {
            return Err(SensorError::Size { width: self.width, height: self.height });
        }
        if !(1e-6..=1e-3).contains(&self.pixel_pitch) {
            return Err(SensorError::Pitch { found: self.pixel_pitch });
        }
        match &self.relaxed_gel {
            RelaxedGel::Flat => Ok(()),
            RelaxedGel::Dome { radius } => {
                let (w, h) = self.pad_size();
                let needed = 0.5 * w.hypot(h);
                // Written so that NaN fails too.
                if *radius > needed { Ok(()) } else { Err(SensorError::Dome { radius: *radius, needed }) }
            }
            RelaxedGel::Map(map) => {
                // A measured map's largest value is its apex; a micrometre above zero is rounding.
                match map.pixels().find(|(_, _, z)| !(-0.02..=1e-6).contains(*z)) {
                    Some((row, col, &found)) => Err(SensorError::RelaxedHeight { row, col, found }),
                    None if map.rows() == 0 || map.cols() == 0 => {
                        Err(SensorError::Size { width: map.cols(), height: map.rows() })
                    }
                    None => Ok(()),
                }
            }
        }
    }

    /// Width and height of the pad, metres.
    pub fn pad_size(&self) -> (f64, f64) {
        (self.width as f64 * self.pixel_pitch, self.height as f64 * self.pixel_pitch)
    }

    /// Size on the gel of a pixel of a map that is `cols` wide, metres. Maps may be coarser than the sensor.
    pub fn map_pitch(&self, cols: usize) -> f64 {
        self.pixel_pitch * self.width as f64 / cols as f64
    }

    /// Rows of a map that is `cols` wide and has the sensor's aspect.
    pub fn map_rows(&self, cols: usize) -> usize {
        ((self.height * cols) as f64 / self.width as f64).round() as usize
    }

    /// Position (x, y) of a pixel centre of a `rows × cols` map in the sensor frame, metres.
    #[inline]
    pub fn pixel_position(&self, row: usize, col: usize, rows: usize, cols: usize) -> (f64, f64) {
        let pitch = self.map_pitch(cols);
        ((col as f64 - 0.5 * (cols as f64 - 1.0)) * pitch, (row as f64 - 0.5 * (rows as f64 - 1.0)) * pitch)
    }

    /// z of the relaxed gel at a pixel of a `rows × cols` map, metres, ≤ 0.
    pub fn relaxed_z(&self, row: usize, col: usize, rows: usize, cols: usize) -> f64 {
        match &self.relaxed_gel {
            RelaxedGel::Flat => 0.0,
            RelaxedGel::Dome { radius } => {
                let (x, y) = self.pixel_position(row, col, rows, cols);
                (radius * radius - x * x - y * y).max(0.0).sqrt() - radius
            }
            RelaxedGel::Map(map) => {
                // Both rasters span the pad, so pixel areas (not centres) are what scales.
                let v = (row as f64 + 0.5) * map.rows() as f64 / rows as f64 - 0.5;
                let u = (col as f64 + 0.5) * map.cols() as f64 / cols as f64 - 0.5;
                bilinear(map, v, u).min(0.0)
            }
        }
    }

    /// [`Self::relaxed_z`] of every pixel of a `rows × cols` map.
    pub fn relaxed(&self, rows: usize, cols: usize) -> Raster<f32> {
        Raster::from_fn(rows, cols, |row, col| self.relaxed_z(row, col, rows, cols) as f32)
    }
}

/// Bilinear value at (v, u) = (row, col), clamped to the raster's edge.
fn bilinear(map: &Raster<f32>, v: f64, u: f64) -> f64 {
    let split = |x: f64, n: usize| {
        let x = x.clamp(0.0, n as f64 - 1.0);
        let low = (x.floor() as usize).min(n.saturating_sub(2));
        (low, (low + 1).min(n - 1), x - low as f64)
    };
    let (r0, r1, fv) = split(v, map.rows());
    let (c0, c1, fu) = split(u, map.cols());
    let z = |r, c| f64::from(map[(r, c)]);
    (z(r0, c0) * (1.0 - fu) + z(r0, c1) * fu) * (1.0 - fv) + (z(r1, c0) * (1.0 - fu) + z(r1, c1) * fu) * fv
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_unknown_names_are_listed() {
        for name in TactileSensor::PRESETS {
            TactileSensor::preset(name).expect("listed").validate().expect("valid");
        }
        let message = TactileSensor::preset("gelsight").expect_err("unknown").to_string();
        assert!(message.contains("'gelsight'") && message.contains("ycb-sight"), "{message}");
    }

    #[test]
    fn dome_sags_by_the_cap_height_in_the_corner() {
        // Measured on Taxim's gel: 1.400 mm in the corner of 640 × 480 at 0.0295 mm.
        let sensor = TactileSensor::preset("ycb-sight").expect("listed");
        let corner = sensor.relaxed_z(0, 0, 480, 640);
        assert!((corner + 1.4e-3).abs() < 0.02e-3, "{corner}");
        let closed_form = {
            let r2 = (319.5f64.powi(2) + 239.5f64.powi(2)) * 0.0295e-3f64.powi(2);
            (0.05f64 * 0.05 - r2).sqrt() - 0.05
        };
        assert!((corner - closed_form).abs() < 1e-15);
    }

    #[test]
    fn a_relaxed_map_agrees_with_the_dome_it_was_sampled_from_at_any_resolution() {
        let dome = TactileSensor::preset("ycb-sight").expect("listed");
        let measured = TactileSensor { relaxed_gel: RelaxedGel::Map(dome.relaxed(480, 640)), ..dome.clone() };
        for (row, col) in [(0, 0), (60, 80), (119, 159), (33, 101)] {
            let (a, b) = (dome.relaxed_z(row, col, 120, 160), measured.relaxed_z(row, col, 120, 160));
            assert!((a - b).abs() < 1e-6, "{row} {col}: {a} {b}");
        }
    }

    #[test]
    fn wrong_units_are_refused() {
        let good = TactileSensor::preset("ycb-sight").expect("listed");
        assert!(TactileSensor { pixel_pitch: 0.0295, ..good.clone() }.validate().is_err());
        assert!(TactileSensor { pixel_pitch: f64::NAN, ..good.clone() }.validate().is_err());
        let map = RelaxedGel::Map(Raster::filled(4, 4, -1.4f32));
        let message = TactileSensor { relaxed_gel: map, ..good }.validate().expect_err("mm").to_string();
        assert!(message.contains("mm or pixels"), "{message}");
    }
}
