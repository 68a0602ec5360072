use rayon::prelude::*;
use std::ops::{Index, IndexMut};

/// A dense image: `rows × cols` values, row-major, indexed `(row, col)`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Raster<T> {
    rows: usize,
    cols: usize,
    data: Vec<T>,
}

impl<T> Raster<T> {
    /// Wraps row-major values; `None` if their number is not `rows · cols`.
    pub fn from_vec(rows: usize, cols: usize, data: Vec<T>) -> Option<Self> {
        (rows.checked_mul(cols)? == data.len()).then_some(Self { rows, cols, data })
    }

    /// Makes each pixel from its `(row, col)`.
    pub fn from_fn(rows: usize, cols: usize, mut value: impl FnMut(usize, usize) -> T) -> Self {
        let mut data = Vec::with_capacity(rows * cols);
        for row in 0..rows {
            for col in 0..cols {
                data.push(value(row, col));
            }
        }
        Self { rows, cols, data }
    }

    /// Number of rows (image height).
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns (image width).
    pub fn cols(&self) -> usize {
        self.cols
    }

    /// `(rows, cols)`.
    pub fn shape(&self) -> (usize, usize) {
        (self.rows, self.cols)
    }

    /// All values, row-major.
    pub fn as_slice(&self) -> &[T] {
        &self.data
    }

    /// All values, row-major.
    pub fn as_mut_slice(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// The value at `(row, col)`, or `None` outside the image.
    pub fn get(&self, row: usize, col: usize) -> Option<&T> {
        (row < self.rows && col < self.cols).then(|| &self.data[row * self.cols + col])
    }

    /// The value at a signed position, or `None` outside the image.
    pub fn at(&self, row: isize, col: isize) -> Option<&T> {
        (row >= 0 && col >= 0).then(|| self.get(row as usize, col as usize))?
    }

    /// A raster of the same shape with each value mapped.
    pub fn map<U>(&self, value: impl FnMut(&T) -> U) -> Raster<U> {
        Raster { rows: self.rows, cols: self.cols, data: self.data.iter().map(value).collect() }
    }

    /// Each `(row, col, value)`, row-major.
    pub fn pixels(&self) -> impl Iterator<Item = (usize, usize, &T)> {
        let cols = self.cols.max(1);
        self.data.iter().enumerate().map(move |(i, v)| (i / cols, i % cols, v))
    }
}

impl<T: Send> Raster<T> {
    /// Like [`Self::from_fn`], rows in parallel; the order of the values does not depend on the thread count.
    pub fn par_from_fn(rows: usize, cols: usize, value: impl Fn(usize, usize) -> T + Sync) -> Self {
        let width = cols.max(1);
        let data = (0..rows * cols).into_par_iter().with_min_len(width).map(|i| value(i / width, i % width)).collect();
        Self { rows, cols, data }
    }
}

impl<T: Clone> Raster<T> {
    /// A raster with the same value everywhere.
    pub fn filled(rows: usize, cols: usize, value: T) -> Self {
        Self { rows, cols, data: vec![value; rows * cols] }
    }
}

impl<T> Index<(usize, usize)> for Raster<T> {
    type Output = T;
    fn index(&self, (row, col): (usize, usize)) -> &T {
        debug_assert!(row < self.rows && col < self.cols);
        &self.data[row * self.cols + col]
    }
}

impl<T> IndexMut<(usize, usize)> for Raster<T> {
    fn index_mut(&mut self, (row, col): (usize, usize)) -> &mut T {
        debug_assert!(row < self.rows && col < self.cols);
        &mut self.data[row * self.cols + col]
    }
}
