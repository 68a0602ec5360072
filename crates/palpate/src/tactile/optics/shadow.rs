//! Cast shadows: where the imprint's rim keeps a light from the gel behind it.

use crate::geometry::Raster;
use crate::tactile::gaussian::{Border, blur_channels, kernel_of_sigma};
use std::f32::consts::PI;

/// Directions of the table, 0.1 rad apart.
const DIRECTIONS: usize = 63;
/// Depths of the table, 0.1 mm apart.
const DEPTHS: usize = 9;
/// Channels of the table: blue, green, red.
const CHANNELS: usize = 3;
/// Angle between two directions, radians.
const DIRECTION_STEP: f64 = 0.1;
/// Contact height at which [`BASE_DEPTH`] begins, millimetres.
const BASE_HEIGHT_MM: f64 = 0.4;
/// Taxim's choice, kept: the table is by depth of the press, and the rim lies lower than that.
const BASE_DEPTH: i64 = 6;
/// Contact height between two depths, millimetres.
const HEIGHT_STEP_MM: f64 = 0.1;
/// Advance along a ray from one value of a list to the next, pixels of the 640 × 480 image.
const RAY_STEP: f64 = 1.25;
/// Rays leave every boundary pixel in a fan this far to both sides of the direction, radians.
const FAN_ANGLE: f64 = 0.1;
/// Angle between two rays of a fan, radians.
const FAN_STEP: f64 = 0.05;
/// Pixels by which the contact grows to its boundary: two dilations by a 5 × 5 square.
const BOUNDARY_WIDTH: isize = 4;
/// Standard deviation of the blur that melts the rays together, pixels.
const SHADOW_SIGMA: f64 = 2.0;

/// What is wrong with a shadow table or with the rasters given.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ShadowError {
    /// A list of the table has the wrong number of entries.
    #[error("the shadow table has {found} {what}; {needed} are needed")]
    Count {
        /// What was counted.
        what: &'static str,
        /// Number found.
        found: usize,
        /// Number needed.
        needed: usize,
    },
    /// A direction is not where its index says.
    #[error("shadow direction {index} is {found} rad; it must be {needed} rad")]
    Direction {
        /// Index of the direction.
        index: usize,
        /// Angle found, radians.
        found: f64,
        /// Angle needed, radians.
        needed: f64,
    },
    /// A value brightens, or is no number.
    #[error("shadow value {index} is {found}; it must lie in [-255, 0] grey levels")]
    Value {
        /// Index among all values.
        index: usize,
        /// Value found, grey levels.
        found: f32,
    },
    /// The rasters do not belong together.
    #[error("{what} is {found:?} (rows, cols); the colour change is {needed:?}")]
    Shape {
        /// The raster.
        what: &'static str,
        /// Its rows and columns.
        found: (usize, usize),
        /// Rows and columns of the colour change.
        needed: (usize, usize),
    },
}

/// A pixel that a fan darkens, relative to the fan's origin.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Darkening {
    row: i16,
    col: i16,
    /// Largest colour change that the shadow leaves, per channel; infinite where the channel's list has ended.
    at_most: [f32; CHANNELS],
}

/// How dark a shadow is, by light, direction, contact height and distance from the rim.
///
/// Measured by the authors of Taxim on presses of a pin; the values replace the colour change where they are lower.
#[derive(Debug, Clone, PartialEq)]
pub struct ShadowTable {
    /// Where the list of (channel, direction, depth) begins in `values`; one more at the end.
    starts: Vec<usize>,
    values: Vec<f32>,
    /// Where the fan of (direction, depth) begins in `fans`; one more at the end.
    fan_starts: Vec<usize>,
    fans: Vec<Darkening>,
}

impl ShadowTable {
    /// Number of directions and of depths.
    pub const SHAPE: (usize, usize) = (DIRECTIONS, DEPTHS);

    /// The table of the GelSight that Taxim was calibrated on (640 × 480, 0.0295 mm).
    ///
    /// # References
    /// Si & Yuan, *Taxim*, RA-L 2022 (shadows); their `shadowTable.npz`, MIT licence, rounded to 1/256 grey level.
    pub fn taxim() -> Self {
        const PACKED: &[u8] = include_bytes!("../../../assets/taxim/shadow.bin");
        let (lengths, values) = PACKED.split_at(CHANNELS * DIRECTIONS * DEPTHS);
        let lengths: Vec<usize> = lengths.iter().map(|&n| usize::from(n)).collect();
        let level = |pair: &[u8]| f32::from(i16::from_le_bytes([pair[0], pair[1]])) / 256.0;
        let values: Vec<f32> = values.chunks_exact(2).map(level).collect();
        let directions: Vec<f64> = (0..DIRECTIONS).map(|n| n as f64 * DIRECTION_STEP).collect();
        Self::new(&directions, &lengths, values).expect("the shipped table is sound")
    }

    /// Checks and indexes a table.
    ///
    /// * `directions` – 63 angles from +column to +row, radians: 0, 0.1 … 6.2
    /// * `lengths` – of the lists: 3 channels (B, G, R) × 63 directions × 9 depths, last index fastest
    /// * `values` – all lists one after another, grey levels ≤ 0; entry s of a list is meant for 1.25·s px from the rim
    ///
    /// # Errors
    /// [`ShadowError`] if counts, angles or values are not as above.
    pub fn new(directions: &[f64], lengths: &[usize], values: Vec<f32>) -> Result<Self, ShadowError> {
        let count = |what, found, needed| {
            if found == needed { Ok(()) } else { Err(ShadowError::Count { what, found, needed }) }
        };
        count("directions", directions.len(), DIRECTIONS)?;
        count("lists", lengths.len(), CHANNELS * DIRECTIONS * DEPTHS)?;
        let total = lengths.iter().try_fold(0usize, |sum, &n| sum.checked_add(n)).unwrap_or(usize::MAX);
        count("values", values.len(), total)?;
        for (index, &found) in directions.iter().enumerate() {
            let needed = index as f64 * DIRECTION_STEP;
            // Written so that NaN fails too.
            if !((found - needed).abs() < 1e-6) {
                return Err(ShadowError::Direction { index, found, needed });
            }
        }
        if let Some(index) = values.iter().position(|v| !(-255.0..=0.0).contains(v)) {
            return Err(ShadowError::Value { index, found: values[index] });
        }
        let mut starts = Vec::with_capacity(lengths.len() + 1);
        starts.push(0);
        starts.extend(lengths.iter().scan(0, |end, n| {
            *end += n;
            Some(*end)
        }));
        let mut table = Self { starts, values, fan_starts: vec![0], fans: Vec::new() };
        for (n, &direction) in directions.iter().enumerate() {
            let angles = fan_angles(direction);
            for depth in 0..DEPTHS {
                let fan = table.fan_of(n, depth, &angles);
                table.fans.extend(fan);
                table.fan_starts.push(table.fans.len());
            }
        }
        Ok(table)
    }

    /// Colour changes along a ray, grey levels: of channel 0, 1, 2 = B, G, R, direction < 63 and depth < 9.
    pub fn list(&self, channel: usize, direction: usize, depth: usize) -> &[f32] {
        let i = (channel * DIRECTIONS + direction) * DEPTHS + depth;
        &self.values[self.starts[i]..self.starts[i + 1]]
    }

    /// The pixels that the fan of (direction, depth) darkens, each once: all channels and rays in one list.
    ///
    /// Truncating an integer plus an offset is that integer plus the offset's floor, so the list fits every origin.
    fn fan_of(&self, direction: usize, depth: usize, angles: &[f64]) -> Vec<Darkening> {
        let lists = [0, 1, 2].map(|channel| self.list(channel, direction, depth));
        let longest = lists.iter().map(|list| list.len()).max().unwrap_or(0);
        let mut fan = Vec::new();
        for angle in angles {
            for s in 1..longest {
                let along = RAY_STEP * s as f64;
                let (row, col) = ((along * angle.sin()).floor() as i16, (along * angle.cos()).floor() as i16);
                let at_most = lists.map(|list| list.get(s).copied().unwrap_or(f32::INFINITY));
                fan.push(Darkening { row, col, at_most });
            }
        }
        fan.sort_by_key(|d| (d.row, d.col));
        fan.dedup_by(|next, kept| {
            let same = (next.row, next.col) == (kept.row, kept.col);
            if same {
                kept.at_most = darker(kept.at_most, next.at_most);
            }
            same
        });
        fan
    }

    /// The fan for a rim pixel: the direction in which the height rises there (radians) and its contact height (mm).
    fn fan(&self, rise: f32, contact_height_mm: f32) -> &[Darkening] {
        // π as the raster has it: it lies beyond π, and -π would fall out of the table.
        let direction = ((f64::from(rise) + f64::from(PI)) / DIRECTION_STEP).floor();
        let depth = ((f64::from(contact_height_mm) - BASE_HEIGHT_MM) / HEIGHT_STEP_MM).floor() as i64 + BASE_DEPTH;
        if !(0.0..DIRECTIONS as f64).contains(&direction) || !(0..DEPTHS as i64).contains(&depth) {
            return &[];
        }
        let i = direction as usize * DEPTHS + depth as usize;
        &self.fans[self.fan_starts[i]..self.fan_starts[i + 1]]
    }
}

/// Angles of the rays of a fan: half-open like NumPy's `arange`, whose rounding decides between four and five.
fn fan_angles(direction: f64) -> Vec<f64> {
    let (start, stop) = (direction - FAN_ANGLE, direction + FAN_ANGLE);
    let count = ((stop - start) / FAN_STEP).ceil() as usize;
    (0..count).map(|i| start + i as f64 * ((start + FAN_STEP) - start)).collect()
}

fn darker(a: [f32; CHANNELS], b: [f32; CHANNELS]) -> [f32; CHANNELS] {
    [a[0].min(b[0]), a[1].min(b[1]), a[2].min(b[2])]
}

/// A pressed gel as the shadows need it: rasters of one shape.
#[derive(Debug, Clone, Copy)]
pub struct PressedGel<'a> {
    /// Height of the gel, dome included, **pixels** of its own pitch; larger is pressed further in.
    pub height_px: &'a Raster<f32>,
    /// Direction in which the height rises, atan2(∂/∂row, ∂/∂col), radians.
    pub direction: &'a Raster<f32>,
    /// Height above the relaxed gel, **millimetres**.
    pub contact_height_mm: &'a Raster<f32>,
    /// Where the object touches.
    pub mask: &'a Raster<bool>,
}

impl PressedGel<'_> {
    fn check(&self, needed: (usize, usize)) -> Result<(), ShadowError> {
        let shapes = [
            ("height map", self.height_px.shape()),
            ("direction map", self.direction.shape()),
            ("contact height", self.contact_height_mm.shape()),
            ("contact mask", self.mask.shape()),
        ];
        let wrong = shapes.into_iter().find(|(_, found)| *found != needed);
        wrong.map_or(Ok(()), |(what, found)| Err(ShadowError::Shape { what, found, needed }))
    }
}

/// Darkens the colour change of an imprint by the shadows of its rim, and melts them together (Gaussian, σ 2 px).
///
/// From each pixel of the rim a fan of rays runs downhill; where the gel is lower than at its origin, the colour change is
/// lowered to the table's value for (direction, contact height, distance). Lengths are those of 640 × 480 px at 0.0295 mm.
///
/// * `change` – colour change against the background, table channel order **B, G, R**, grey levels; changed in place
/// * `gel` – the deformed gel that the colour change was rendered from
///
/// Add the background afterwards and finish with [`soften`]. The blur runs without contact too.
///
/// # Errors
/// [`ShadowError::Shape`] if the rasters differ in shape.
///
/// # References
/// Si & Yuan, *Taxim*, RA-L 2022 (shadows). As there, rays that leave the image by less than a pixel darken its first row or column.
pub fn cast_shadows(
    change: &mut Raster<[f32; 3]>,
    gel: &PressedGel<'_>,
    table: &ShadowTable,
) -> Result<(), ShadowError> {
    gel.check(change.shape())?;
    let (rows, cols) = change.shape();
    for (row, col) in rim(gel.mask) {
        let origin = gel.height_px[(row, col)];
        for darkening in table.fan(gel.direction[(row, col)], gel.contact_height_mm[(row, col)]) {
            // Truncation towards zero takes what lies less than a pixel outside back in.
            let inside = |start: usize, offset: i16, n: usize| match start as isize + isize::from(offset) {
                -1 => Some(0),
                i => usize::try_from(i).ok().filter(|&i| i < n),
            };
            let (Some(r), Some(c)) = (inside(row, darkening.row, rows), inside(col, darkening.col, cols)) else {
                continue;
            };
            if origin > gel.height_px[(r, c)] {
                let pixel = &mut change[(r, c)];
                *pixel = darker(*pixel, darkening.at_most);
            }
        }
    }
    blur_channels(change, &kernel_of_sigma(SHADOW_SIGMA), Border::Repeat);
    Ok(())
}

/// The last step of a rendered image, background included: a 5 px Gaussian.
///
/// The weights are 1, 4, 6, 4, 1 sixteenths: OpenCV's for this size, not those of its σ rule for larger ones.
pub fn soften(image: &mut Raster<[f32; 3]>) {
    blur_channels(image, &[0.0625, 0.25, 0.375, 0.25, 0.0625], Border::Reflect);
}

/// Pixels outside the mask within a square of 9 × 9 px of it, row-major.
fn rim(mask: &Raster<bool>) -> Vec<(usize, usize)> {
    let (rows, cols) = mask.shape();
    let mut found = Vec::new();
    // Touched pixels in the window of rows around `row`, for each column.
    let mut in_column = vec![0u32; cols];
    let tally = |in_column: &mut [u32], row: isize, sign: u32| {
        if (0..rows as isize).contains(&row) {
            let start = row as usize * cols;
            for (n, &felt) in in_column.iter_mut().zip(&mask.as_slice()[start..start + cols]) {
                *n = n.wrapping_add(if felt { sign } else { 0 });
            }
        }
    };
    for row in 0..BOUNDARY_WIDTH {
        tally(&mut in_column, row, 1);
    }
    for row in 0..rows as isize {
        tally(&mut in_column, row + BOUNDARY_WIDTH, 1);
        tally(&mut in_column, row - BOUNDARY_WIDTH - 1, u32::MAX);
        let mut last_touched = -BOUNDARY_WIDTH - 1;
        let mut ahead = 0;
        for col in 0..cols as isize {
            while ahead < cols as isize && ahead <= col + BOUNDARY_WIDTH {
                if in_column[ahead as usize] > 0 {
                    last_touched = ahead;
                }
                ahead += 1;
            }
            let at = (row as usize, col as usize);
            if last_touched >= col - BOUNDARY_WIDTH && !mask[at] {
                found.push(at);
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn directions() -> Vec<f64> {
        (0..DIRECTIONS).map(|n| n as f64 * DIRECTION_STEP).collect()
    }

    /// A table whose red list of every direction at depth 8 is -10, -20, -30, and nothing else.
    fn red_only() -> ShadowTable {
        let mut lengths = vec![0; CHANNELS * DIRECTIONS * DEPTHS];
        for n in 0..DIRECTIONS {
            lengths[(2 * DIRECTIONS + n) * DEPTHS + 8] = 3;
        }
        ShadowTable::new(&directions(), &lengths, [-10.0, -20.0, -30.0].repeat(DIRECTIONS)).expect("sound")
    }

    #[test]
    fn unsound_tables_are_refused_with_the_numbers() {
        let lengths = vec![1; CHANNELS * DIRECTIONS * DEPTHS];
        let values = vec![-1.0f32; lengths.len()];
        let message = |d: &[f64], l: &[usize], v: Vec<f32>| ShadowTable::new(d, l, v).expect_err("unsound").to_string();
        assert!(message(&directions()[1..], &lengths, values.clone()).contains("62 directions; 63"));
        assert!(message(&directions(), &lengths[..9], values.clone()).contains("9 lists; 1701"));
        assert!(message(&directions(), &lengths, vec![-1.0]).contains("1 values; 1701"));
        let huge = vec![usize::MAX; lengths.len()];
        assert!(message(&directions(), &huge, values.clone()).contains("1701 values"));
        let mut bent = directions();
        bent[7] = f64::NAN;
        assert!(message(&bent, &lengths, values.clone()).contains("direction 7"));
        for wrong in [1.0, f32::NAN, -300.0] {
            let mut values = values.clone();
            values[5] = wrong;
            assert!(message(&directions(), &lengths, values).contains("value 5"));
        }
    }

    #[test]
    fn the_shipped_table_darkens_only() {
        let table = ShadowTable::taxim();
        let longest = (0..DIRECTIONS).map(|n| table.list(2, n, 8).len()).max().expect("directions");
        assert!(longest > 20 && table.values.iter().all(|v| (-76.0..=-9.99).contains(v)));
        assert!(table.fans.iter().all(|d| d.at_most.iter().any(|v| v.is_finite())));
    }

    #[test]
    fn fans_have_each_pixel_once_with_the_darkest_value_of_all_rays() {
        let table = red_only();
        let fan = table.fan(-PI, 0.65);
        // Direction 0: steps 1 and 2 are 1.25 and 2.5 columns ahead, on the row or just above it.
        let cells: Vec<_> = fan.iter().map(|d| (d.row, d.col, d.at_most[2])).collect();
        assert_eq!(cells, [(-1, 1, -20.0), (-1, 2, -30.0), (0, 1, -20.0), (0, 2, -30.0)]);
        assert!(fan.iter().all(|d| d.at_most[0] == f32::INFINITY));
    }

    #[test]
    fn heights_and_directions_outside_the_table_cast_nothing() {
        let table = red_only();
        for (rise, height) in [(0.0, 0.59), (0.0, 0.71), (0.0, f32::NAN), (f32::NAN, 0.65), (3.3, 0.65)] {
            assert!(table.fan(rise, height).is_empty(), "{rise} {height}");
        }
        assert!(!table.fan(0.0, 0.65).is_empty() && !table.fan(PI, 0.65).is_empty());
    }

    #[test]
    fn the_rim_is_two_dilations_by_five_less_the_mask() {
        let mask = Raster::from_fn(30, 41, |r, c| (r, c) == (10, 12) || (r, c) == (0, 40) || (r, c) == (29, 0));
        let within = |r: usize, c: usize, (y, x): (usize, usize)| r.abs_diff(y) <= 4 && c.abs_diff(x) <= 4;
        let expected: Vec<_> = mask
            .pixels()
            .filter(|&(r, c, &m)| !m && [(10, 12), (0, 40), (29, 0)].iter().any(|&p| within(r, c, p)))
            .map(|(r, c, _)| (r, c))
            .collect();
        assert_eq!(rim(&mask), expected);
        assert!(rim(&Raster::filled(3, 2, true)).is_empty() && rim(&Raster::filled(0, 0, true)).is_empty());
    }

    #[test]
    fn a_shadow_falls_downhill_of_the_rim_in_its_own_channel_and_nowhere_higher() {
        let shape = (40, 60);
        let filled = |v: f32| Raster::filled(shape.0, shape.1, v);
        let mask = Raster::from_fn(shape.0, shape.1, |r, c| (15..25).contains(&r) && c == 20);
        // The gel falls along +column, so it rises towards ±π.
        let height_px = Raster::from_fn(shape.0, shape.1, |_, c| 100.0 - c as f32);
        let (direction, contact_height_mm) = (filled(-PI), filled(0.65));
        let gel = PressedGel {
            height_px: &height_px,
            direction: &direction,
            contact_height_mm: &contact_height_mm,
            mask: &mask,
        };
        let mut change = Raster::filled(shape.0, shape.1, [5.0f32; 3]);
        cast_shadows(&mut change, &gel, &red_only()).expect("one shape");
        // Step 2 of the red list reaches the whole rim 17..=26; the blur leaves its middle.
        assert!(change[(20, 22)][2] < -25.0, "{:?}", change[(20, 22)]);
        assert!((change[(20, 22)][0] - 5.0).abs() < 1e-4);
        assert!((change[(20, 40)][2] - 5.0).abs() < 1e-4 && (change[(20, 5)][2] - 5.0).abs() < 1e-4);

        let uphill = height_px.map(|h| -h);
        let mut change = Raster::filled(shape.0, shape.1, [5.0f32; 3]);
        cast_shadows(&mut change, &PressedGel { height_px: &uphill, ..gel }, &red_only()).expect("one shape");
        assert!(change.as_slice().iter().flatten().all(|v| (v - 5.0).abs() < 1e-4));
    }

    #[test]
    fn rasters_of_different_shapes_are_refused() {
        let small = Raster::filled(3, 4, 0.0f32);
        let mask = Raster::filled(3, 5, false);
        let gel = PressedGel { height_px: &small, direction: &small, contact_height_mm: &small, mask: &mask };
        let message = cast_shadows(&mut Raster::filled(3, 4, [0.0; 3]), &gel, &red_only()).expect_err("5 ≠ 4");
        assert_eq!(message.to_string(), "contact mask is (3, 5) (rows, cols); the colour change is (3, 4)");
    }

    #[test]
    fn softening_keeps_a_constant_image_and_spreads_a_point() {
        let mut image = Raster::filled(9, 9, [0.0f32; 3]);
        image[(4, 4)] = [16.0, 0.0, 256.0];
        soften(&mut image);
        assert_eq!((image[(4, 4)], image[(3, 4)]), ([2.25, 0.0, 36.0], [1.5, 0.0, 24.0]));
    }
}
