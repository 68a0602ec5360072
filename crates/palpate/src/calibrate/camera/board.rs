use super::BoardError;
use super::corners::{self, Corner};
use super::grid::{self, Grid};
use super::subpixel;
use crate::geometry::{Point, Raster};

/// A chessboard, by its inner corners: where four squares meet.
///
/// Board frame: origin at the first corner, x along the columns, y along the rows, z into the board (away from who looks at it).
/// The first corner is the one whose square, towards the others, is dark, if the number of columns is even and that of the rows
/// odd or the reverse; any other board looks the same turned by half, and the first corner is then the one nearer to the image's
/// upper left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Board {
    /// Inner corners along x.
    pub cols: usize,
    /// Inner corners along y.
    pub rows: usize,
    /// Side of a square, metres.
    pub square: f64,
}

/// A board as an image shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardView {
    /// Pixel (u, v) of each corner, row by row: corner (i, j) of column i is the `j · cols + i`-th.
    pub corners: Vec<[f64; 2]>,
}

impl Board {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`BoardError::Description`].
    pub fn validate(&self) -> Result<(), BoardError> {
        for (field, value) in [("columns", self.cols), ("rows", self.rows)] {
            if !(3..=64).contains(&value) {
                let rule = "between 3 and 64 inner corners";
                return Err(BoardError::Description { field, value: value as f64, rule });
            }
        }
        // Written so that NaN fails too.
        if !(1e-4..=1.0).contains(&self.square) {
            let rule = "between 0.0001 and 1 m (25 mm is 0.025)";
            return Err(BoardError::Description { field: "square", value: self.square, rule });
        }
        Ok(())
    }

    /// Number of corners.
    pub fn len(&self) -> usize {
        self.cols * self.rows
    }

    /// Whether it has no corner.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether it looks the same turned by half, so that its first corner cannot be told.
    pub fn is_ambiguous(&self) -> bool {
        (self.cols + self.rows).is_multiple_of(2)
    }

    /// Corner `i` in the board frame, metres.
    pub fn point(&self, i: usize) -> Point {
        Point::new((i % self.cols) as f64 * self.square, (i / self.cols) as f64 * self.square, 0.0)
    }
}

/// How boards are looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BoardSearch {
    /// Half the side of the window in which a corner is refined, pixels; `None`: 0.35 of the distance to the next corner, 10 at
    /// most. A window that reaches over the board's edge pulls the outer corners to it; a small one is noisier.
    pub window: Option<usize>,
}

impl BoardSearch {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`BoardError::Description`].
    pub fn validate(&self) -> Result<(), BoardError> {
        match self.window {
            Some(window) if !(2..=50).contains(&window) => {
                let rule = "between 2 and 50 pixels";
                Err(BoardError::Description { field: "corner window", value: window as f64, rule })
            }
            _ => Ok(()),
        }
    }
}

/// Finds the board and its corners to a fraction of a pixel.
///
/// * `image` – grey values of any range; dim and noisy ones (infrared) are stretched and smoothed as far as needed
///
/// # Errors
/// [`BoardError`], which says what was found instead.
pub fn find_board(image: &Raster<f32>, board: &Board, search: &BoardSearch) -> Result<BoardView, BoardError> {
    board.validate()?;
    search.validate()?;
    let (rows, cols) = image.shape();
    if rows < 32 || cols < 32 {
        return Err(BoardError::Size { cols, rows });
    }
    let (low, high) = corners::range(image);
    // Written so that NaN fails too.
    if !(high - low > 2.0) {
        return Err(BoardError::NoContrast { range: (high - low).max(0.0) });
    }
    let mut best = (0, (0, 0));
    let (mut larger, mut edge) = (None, false);
    for attempt in corners::ATTEMPTS {
        let picture = corners::prepare(image, (low, high), attempt);
        let found = corners::detect(&picture, attempt.shrink);
        for grid in grid::assemble(&found) {
            match choose(&grid, &found, &picture, attempt.shrink, board) {
                Choice::Board(view) => return Ok(finish(view, image, board, search)),
                Choice::Larger(size) => larger = larger.or(Some(size)),
                Choice::Edge => edge = true,
                Choice::No => {}
            }
            if grid.size().0 * grid.size().1 > best.1.0 * best.1.1 {
                best = (found.len(), grid.size());
            }
        }
        best.0 = best.0.max(found.len());
    }
    let Board { cols, rows, .. } = *board;
    Err(match larger {
        Some(found) => BoardError::Larger { cols, rows, found },
        None if edge => BoardError::Edge { cols, rows },
        None => BoardError::NotFound { cols, rows, corners: best.0, largest: best.1 },
    })
}

enum Choice {
    Board(Vec<[f64; 2]>),
    Larger((usize, usize)),
    /// One of its lines is the edge of a board.
    Edge,
    No,
}

/// The board among a grid's corners, missing ones filled in.
fn choose(grid: &Grid, found: &[Corner], picture: &Raster<f32>, scale: usize, board: &Board) -> Choice {
    let mut candidates = Vec::new();
    for turned in [grid.clone(), grid.turned()] {
        if board.cols == board.rows && !candidates.is_empty() {
            break;
        }
        candidates.extend(turned.windows(board.cols, board.rows).into_iter().map(|w| (turned.clone(), w)));
    }
    candidates.sort_by(|a, b| b.1.filled.cmp(&a.1.filled).then(b.1.response.total_cmp(&a.1.response)));
    let mut choice = Choice::No;
    for (grid, window) in candidates.iter().take(4) {
        let Some(places) = grid.complete(window, (board.cols, board.rows), found, picture) else { continue };
        if !grid::rimmed(picture, &places, board.cols) {
            choice = Choice::Edge;
            continue;
        }
        if let Some(size) = grid.grows(window, (board.cols, board.rows), found) {
            return Choice::Larger(size);
        }
        let scale = scale as f64;
        // Pixel centres of a picture shrunk by n lie at n·u + (n − 1)/2.
        return Choice::Board(places.into_iter().map(|p| p.map(|v| v * scale + 0.5 * (scale - 1.0))).collect());
    }
    choice
}

/// Corners to a fraction of a pixel, and the first one first.
fn finish(mut corners: Vec<[f64; 2]>, image: &Raster<f32>, board: &Board, search: &BoardSearch) -> BoardView {
    subpixel::refine(image, &mut corners, (board.cols, board.rows), search.window);
    let first_is_dark = grid::chequer(image, &corners, (board.cols, board.rows)) < 0.0;
    let last = corners[corners.len() - 1];
    let turn = if board.is_ambiguous() { last[0] + last[1] < corners[0][0] + corners[0][1] } else { !first_is_dark };
    if turn {
        corners.reverse();
    }
    BoardView { corners }
}
