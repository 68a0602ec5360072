//! Dots in the gel, and how a press moves them.

use super::nnls::nnls;
use super::point_response::{Influence, InfluenceTable, PointResponse};
use crate::geometry::Raster;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Share of the motion that drag loads cause which the dots follow; press loads count in full. Taxim's friction factors.
const DRAG_SHARE: f64 = 0.07;
/// Smallest cell that carries one load, millimetres: the mesh size of the finite elements.
const SMALLEST_CELL_MM: f64 = 0.25;
/// Loads at most; larger contacts get larger cells.
const MAX_LOADS: usize = 160;

/// Dots printed in the gel on a square lattice around the pad's centre.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MarkerParams {
    /// Distance between neighbouring dots, metres. Larger: fewer dots. 1.3 mm is in the middle of what is sold.
    pub spacing: f64,
    /// Radius of a dot, metres. Larger: bigger dots.
    pub radius: f64,
    /// Share of the light that a dot swallows. Larger: darker dots; 1 is black.
    pub darkness: f64,
}

impl Default for MarkerParams {
    fn default() -> Self {
        Self { spacing: 1.3e-3, radius: 0.2e-3, darkness: 0.8 }
    }
}

impl MarkerParams {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`MarkerError::Params`] with field, value and rule.
    pub fn validate(&self) -> Result<(), MarkerError> {
        let check = |field, found: f64, ok: bool, needed| {
            if ok { Ok(()) } else { Err(MarkerError::Params { field, found, needed }) }
        };
        check("spacing", self.spacing, (1e-4..=0.1).contains(&self.spacing), "in [1e-4, 0.1] m")?;
        let radius = self.radius;
        check("radius", radius, radius > 0.0 && radius <= self.spacing / 2.0, "in (0, spacing / 2] m")?;
        check("darkness", self.darkness, (0.0..=1.0).contains(&self.darkness), "in [0, 1]")
    }
}

/// Why dots cannot be moved or drawn.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MarkerError {
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
    /// Two rasters do not belong together.
    #[error("{what} is {found:?} (rows, cols); {needed:?} is needed")]
    Shape {
        /// The raster.
        what: &'static str,
        /// Its rows and columns.
        found: (usize, usize),
        /// Rows and columns needed.
        needed: (usize, usize),
    },
    /// A depth in the contact is not a depth.
    #[error("contact depth at (row {row}, col {col}) is {found} mm; it must lie in [-10, 10] mm (is it in pixels?)")]
    Depth {
        /// Row of the raster.
        row: usize,
        /// Column of the raster.
        col: usize,
        /// Value found, millimetres.
        found: f32,
    },
}

/// A spot of the contact that carries a load.
#[derive(Debug, Clone, PartialEq)]
struct Spot {
    /// Row and column of its cell from the contact's middle.
    cell: (isize, isize),
    /// Imposed depth, millimetres.
    depth_mm: f64,
}

/// The contact cut into square cells around the middle of its bounding box.
struct Cells {
    /// The middle, (row, col), pixels.
    center: (f64, f64),
    /// Edge of a cell, pixels.
    size: usize,
    spots: Vec<Spot>,
}

impl Cells {
    /// Cells that the contact covers at least half; the fullest one if it covers none so far. `None` without contact.
    fn new(depth_mm: &Raster<f32>, mask: &Raster<bool>, smallest: usize) -> Option<Self> {
        let touched: Vec<(usize, usize)> = mask.pixels().filter(|(_, _, m)| **m).map(|(r, c, _)| (r, c)).collect();
        let middle = |at: fn(&(usize, usize)) -> usize| {
            let (low, high) = (touched.iter().map(at).min()?, touched.iter().map(at).max()?);
            Some(0.5 * (low + high) as f64)
        };
        let center = (middle(|p| p.0)?, middle(|p| p.1)?);
        let needed = (touched.len() as f64 / MAX_LOADS as f64).sqrt() as usize;
        let mut size = smallest.max(needed).max(1);
        loop {
            let spots = Self::spots(depth_mm, &touched, center, size);
            if spots.len() <= MAX_LOADS {
                return Some(Self { center, size, spots });
            }
            size += 1;
        }
    }

    fn spots(depth_mm: &Raster<f32>, touched: &[(usize, usize)], center: (f64, f64), size: usize) -> Vec<Spot> {
        let index = |at: usize, center: f64| ((at as f64 - center) / size as f64 + 0.5).floor() as isize;
        let (row_span, col_span) =
            (depth_mm.rows().div_ceil(size) as isize + 2, depth_mm.cols().div_ceil(size) as isize + 2);
        let mut sums = Raster::filled(2 * row_span as usize + 1, 2 * col_span as usize + 1, (0u32, 0.0f64));
        for &(row, col) in touched {
            let cell = (index(row, center.0) + row_span, index(col, center.1) + col_span);
            let (count, sum) = &mut sums[(cell.0 as usize, cell.1 as usize)];
            *count += 1;
            *sum += f64::from(depth_mm[(row, col)].max(0.0));
        }
        let fullest = sums.as_slice().iter().map(|(count, _)| *count).max().unwrap_or(0);
        let enough = fullest.min((size * size).div_ceil(2) as u32);
        let covered = sums.pixels().filter(|(_, _, (count, _))| *count >= enough.max(1));
        covered
            .map(|(row, col, (count, sum))| Spot {
                cell: (row as isize - row_span, col as isize - col_span),
                depth_mm: sum / f64::from(*count),
            })
            .collect()
    }
}

/// Loads on the spots of a contact that reproduce what is imposed there.
struct Loads {
    press: DVector<f64>,
    drag_x: DVector<f64>,
    drag_y: DVector<f64>,
}

impl Loads {
    /// One non-negative solve per axis, each with that axis's own response only, as Taxim does.
    fn solve(spots: &[Spot], table: &InfluenceTable, (shear_x, shear_y): (f64, f64)) -> Self {
        let n = spots.len();
        let matrix = |entry: fn(&Influence) -> f64| {
            DMatrix::from_fn(n, n, |i, j| {
                let (a, b) = (spots[i].cell, spots[j].cell);
                // The table's steps are half cells.
                entry(&table.at(2 * (a.0 - b.0), 2 * (a.1 - b.1)))
            })
        };
        let depths = DVector::from_iterator(n, spots.iter().map(|s| s.depth_mm));
        let drag = |shear: f64, entry| {
            if shear == 0.0 { DVector::zeros(n) } else { nnls(&matrix(entry), &DVector::repeat(n, 1.0)) * shear }
        };
        Self {
            press: nnls(&matrix(|t| t.zz), &depths),
            drag_x: drag(shear_x, |t| t.xx),
            drag_y: drag(shear_y, |t| t.yy),
        }
    }
}

/// How the gel's surface moves sideways when it is pressed and dragged.
///
/// The contact is covered by virtual point loads whose superposed answers reproduce the imposed motion; the same answers, summed
/// anywhere else, are how the gel moves there.
///
/// # References
/// Si & Yuan, *Taxim*, RA-L 2022 (marker motion by superposition), and its finite-element presses of a dome, MIT licence. Two
/// departures. The answers are reduced to those of a round dome: `assets/taxim/make_markers.py` fits the harmonics 0 and 1 to all
/// but 2 to 9 % (rms, 0.5 to 9 mm from the load) and leaves out the sideways lean of the computed press. And a load is spread over
/// its cell, so that the result hardly depends on how many loads there are.
#[derive(Debug, Clone)]
pub struct MarkerField {
    pixel_pitch_mm: f64,
    response: PointResponse,
}

impl MarkerField {
    /// The gel that Taxim computed, seen at a pitch.
    ///
    /// * `pixel_pitch` – of the rasters to come, metres
    ///
    /// # Errors
    /// [`MarkerError::Params`] if the pitch is no fingertip's.
    pub fn new(pixel_pitch: f64) -> Result<Self, MarkerError> {
        if !(1e-6..=1e-3).contains(&pixel_pitch) {
            let needed = "in [1e-6, 1e-3] m";
            return Err(MarkerError::Params { field: "pixel_pitch", found: pixel_pitch, needed });
        }
        Ok(Self { pixel_pitch_mm: pixel_pitch * 1e3, response: PointResponse::taxim() })
    }

    /// Sideways motion of every pixel, (along columns, along rows), **millimetres**; zero without contact.
    ///
    /// * `contact_depth_mm` – how far the gel is pressed in, **millimetres**; read in the contact only
    /// * `mask` – where the object touches
    /// * `shear_mm` – how far the object is dragged along (columns, rows), **millimetres**; the gel follows by 7 % of it
    ///
    /// # Errors
    /// [`MarkerError::Shape`] if the rasters differ; [`MarkerError::Depth`], [`MarkerError::Params`] for impossible values.
    pub fn displacement(
        &self,
        contact_depth_mm: &Raster<f32>,
        mask: &Raster<bool>,
        shear_mm: (f64, f64),
    ) -> Result<Raster<[f32; 2]>, MarkerError> {
        let (rows, cols) = mask.shape();
        check_imprint(contact_depth_mm, mask, shear_mm)?;
        let smallest = (SMALLEST_CELL_MM / self.pixel_pitch_mm).ceil() as usize;
        let Some(cells) = Cells::new(contact_depth_mm, mask, smallest) else {
            return Ok(Raster::filled(rows, cols, [0.0; 2]));
        };
        // Motion is computed on sites half a cell apart that cover the image, and is linear between them.
        let half = 0.5 * cells.size as f64;
        let sites = |n: usize, center: f64| {
            let first = (-center / half).floor() as isize;
            (first, (((n as f64 - 1.0 - center) / half).floor() as isize + 2 - first) as usize)
        };
        let ((row0, site_rows), (col0, site_cols)) = (sites(rows, cells.center.0), sites(cols, cells.center.1));
        let reach = |n: usize| 2 * n + 4;
        let step_mm = half * self.pixel_pitch_mm;
        let table = InfluenceTable::new(&self.response, (reach(site_rows), reach(site_cols)), step_mm, 2.0 * step_mm);
        let loads = Loads::solve(&cells.spots, &table, shear_mm);
        let motion = Raster::par_from_fn(site_rows, site_cols, |i, j| {
            superpose(&cells.spots, &loads, &table, (i as isize + row0, j as isize + col0))
        });
        Ok(Raster::par_from_fn(rows, cols, |row, col| {
            let place = |at: usize, center: f64, first: isize| (at as f64 - center) / half - first as f64;
            let (v, u) = (place(row, cells.center.0, row0), place(col, cells.center.1, col0));
            bilinear(&motion, v, u)
        }))
    }
}

/// Whether depth, mask and drag can be an imprint's.
fn check_imprint(contact_depth_mm: &Raster<f32>, mask: &Raster<bool>, shear_mm: (f64, f64)) -> Result<(), MarkerError> {
    let (found, needed) = (contact_depth_mm.shape(), mask.shape());
    if found != needed {
        return Err(MarkerError::Shape { what: "contact depth", found, needed });
    }
    for shear in [shear_mm.0, shear_mm.1] {
        if !(-10.0..=10.0).contains(&shear) {
            return Err(MarkerError::Params { field: "shear_mm", found: shear, needed: "in [-10, 10] mm" });
        }
    }
    let mut touched = contact_depth_mm.pixels().zip(mask.as_slice()).filter(|(_, felt)| **felt);
    match touched.find(|((_, _, depth), _)| !(-10.0..=10.0).contains(*depth)) {
        Some(((row, col, &found), _)) => Err(MarkerError::Depth { row, col, found }),
        None => Ok(()),
    }
}

/// Motion at a site, half cells from the contact's middle: the sum of what each load does there.
fn superpose(spots: &[Spot], loads: &Loads, table: &InfluenceTable, (row, col): (isize, isize)) -> [f32; 2] {
    let (mut x, mut y) = (0.0, 0.0);
    for (i, spot) in spots.iter().enumerate() {
        let t = table.at(row - 2 * spot.cell.0, col - 2 * spot.cell.1);
        let (drag_x, drag_y) = (DRAG_SHARE * loads.drag_x[i], DRAG_SHARE * loads.drag_y[i]);
        x += loads.press[i] * t.xz + drag_x * t.xx + drag_y * t.xy;
        y += loads.press[i] * t.yz + drag_x * t.xy + drag_y * t.yy;
    }
    [x as f32, y as f32]
}

/// Value between the four sites around (v, u) = (row, col), which lies on the raster.
fn bilinear(sites: &Raster<[f32; 2]>, v: f64, u: f64) -> [f32; 2] {
    let (row, col) = ((v as usize).min(sites.rows() - 2), (u as usize).min(sites.cols() - 2));
    let (fv, fu) = ((v - row as f64) as f32, (u - col as f64) as f32);
    [0, 1].map(|k| {
        let at = |r: usize, c: usize| sites[(r, c)][k];
        (at(row, col) * (1.0 - fu) + at(row, col + 1) * fu) * (1.0 - fv)
            + (at(row + 1, col) * (1.0 - fu) + at(row + 1, col + 1) * fu) * fv
    })
}

/// Draws the dots where the motion takes them.
///
/// * `image` – of the pad, darkened in place
/// * `displacement` – of every pixel, (along columns, along rows), millimetres, from [`MarkerField::displacement`]
/// * `pixel_pitch` – of both, metres
///
/// # Errors
/// [`MarkerError`] if parameters or pitch are out of range, or the rasters differ in shape.
pub fn draw_markers(
    image: &mut Raster<[u8; 3]>,
    displacement: &Raster<[f32; 2]>,
    pixel_pitch: f64,
    params: &MarkerParams,
) -> Result<(), MarkerError> {
    params.validate()?;
    if !(1e-6..=1e-3).contains(&pixel_pitch) {
        return Err(MarkerError::Params { field: "pixel_pitch", found: pixel_pitch, needed: "in [1e-6, 1e-3] m" });
    }
    let (found, needed) = (displacement.shape(), image.shape());
    if found != needed {
        return Err(MarkerError::Shape { what: "displacement", found, needed });
    }
    let (rows, cols) = needed;
    let spacing = params.spacing / pixel_pitch;
    for y in lattice(rows, spacing) {
        for x in lattice(cols, spacing) {
            let moved = displacement[(y.round() as usize, x.round() as usize)];
            let shift = moved.map(|d| f64::from(d) * 1e-3 / pixel_pitch);
            draw_dot(image, (x + shift[0], y + shift[1]), params.radius / pixel_pitch, params.darkness);
        }
    }
    Ok(())
}

/// Positions in `0..n` that are whole spacings from the middle.
fn lattice(n: usize, spacing: f64) -> impl Iterator<Item = f64> {
    let middle = 0.5 * (n as f64 - 1.0);
    let each_side = (middle / spacing).floor() as i64;
    // No pixel, no dot.
    let range = if n == 0 { 0..0 } else { -each_side..each_side + 1 };
    range.map(move |k| middle + k as f64 * spacing)
}

/// Darkens a disc; its rim is one pixel wide.
fn draw_dot(image: &mut Raster<[u8; 3]>, (x, y): (f64, f64), radius: f64, darkness: f64) {
    let (rows, cols) = image.shape();
    let range = |at: f64, n: usize| {
        let (low, high) = ((at - radius - 1.0).floor().max(0.0), (at + radius + 2.0).max(0.0));
        low as usize..(high as usize).min(n)
    };
    for row in range(y, rows) {
        for col in range(x, cols) {
            let distance = (col as f64 - x).hypot(row as f64 - y);
            let light = 1.0 - darkness * (radius + 0.5 - distance).clamp(0.0, 1.0);
            let pixel = &mut image[(row, col)];
            *pixel = pixel.map(|v| (f64::from(v) * light).round() as u8);
        }
    }
}

#[cfg(test)]
mod tests;
