use super::BoardView;
use crate::geometry::Raster;

/// Cells along the width and height over which coverage is counted.
const CELLS: (usize, usize) = (8, 6);

/// How much of the image the boards covered.
#[derive(Debug, Clone, PartialEq)]
pub struct Coverage {
    /// Corners in each cell, 6 rows of 8.
    pub cells: Raster<usize>,
    /// Share of the cells with at least one corner.
    pub share: f64,
    /// Corners of the image (as "upper left") near which there was none: distortion is a guess there.
    pub bare: Vec<&'static str>,
}

/// Where in the image the corners of all views fell.
pub fn coverage(views: &[BoardView], (width, height): (usize, usize)) -> Coverage {
    let mut cells = Raster::filled(CELLS.1, CELLS.0, 0usize);
    let cell = |v: f64, size: usize, n: usize| ((v / size as f64 * n as f64).max(0.0) as usize).min(n - 1);
    for corner in views.iter().flat_map(|v| &v.corners) {
        cells[(cell(corner[1], height, CELLS.1), cell(corner[0], width, CELLS.0))] += 1;
    }
    let filled = cells.as_slice().iter().filter(|n| **n > 0).count();
    let quarter = |rows: std::ops::Range<usize>, cols: std::ops::Range<usize>| {
        rows.flat_map(|r| cols.clone().map(move |c| (r, c))).map(|at| cells[at]).sum::<usize>()
    };
    let corners = [
        ("upper left", quarter(0..2, 0..2)),
        ("upper right", quarter(0..2, 6..8)),
        ("lower left", quarter(4..6, 0..2)),
        ("lower right", quarter(4..6, 6..8)),
    ];
    let bare = corners.iter().filter(|c| c.1 == 0).map(|c| c.0).collect();
    Coverage { share: filled as f64 / cells.as_slice().len() as f64, cells, bare }
}

/// A picture of the coverage: each view's corners in a colour of its own on grey cells, the darker the more corners they hold.
pub fn draw_coverage(views: &[BoardView], (width, height): (usize, usize)) -> Raster<[u8; 3]> {
    let coverage = coverage(views, (width, height));
    let most = coverage.cells.as_slice().iter().copied().max().unwrap_or(0).max(1) as f64;
    let mut picture = Raster::from_fn(height, width, |row, col| {
        let cell = (row * CELLS.1 / height, col * CELLS.0 / width);
        let share = coverage.cells[cell] as f64 / most;
        [(250.0 - 110.0 * share) as u8; 3]
    });
    let radius = (width.max(height) / 320).max(1) as isize;
    for (i, view) in views.iter().enumerate() {
        // Neighbouring hues far apart: steps of the golden angle.
        let hue = (i as f64 * 0.618_034).fract() * 6.0;
        let part = |shift: f64| ((((hue + shift) % 6.0) - 3.0).abs() - 1.0).clamp(0.0, 1.0);
        let color = [part(0.0), part(4.0), part(2.0)].map(|v| (200.0 * v) as u8);
        for corner in &view.corners {
            let (u, v) = (corner[0].round() as isize, corner[1].round() as isize);
            for row in v - radius..=v + radius {
                for col in u - radius..=u + radius {
                    if row >= 0 && col >= 0 && (row as usize) < height && (col as usize) < width {
                        picture[(row as usize, col as usize)] = color;
                    }
                }
            }
        }
    }
    picture
}
