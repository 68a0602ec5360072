//! Exact Euclidean distance transforms, O(n), parallel over lines.
//!
//! # References
//! Felzenszwalb & Huttenlocher, *Distance Transforms of Sampled Functions*, Theory of Computing 8 (2012): the lower envelope of
//! parabolas, one dimension after the other.

use super::{Raster, VoxelGrid};
use rayon::prelude::*;

/// Distance of every pixel to the nearest `true` pixel, in pixels; infinite everywhere if there is none.
pub fn distance_to_true(sources: &Raster<bool>) -> Raster<f32> {
    let (rows, cols) = sources.shape();
    let mut squared: Vec<f32> = sources.as_slice().iter().map(|&s| if s { 0.0 } else { f32::INFINITY }).collect();
    if squared.is_empty() {
        return sources.map(|_| f32::INFINITY);
    }
    squared.par_chunks_mut(cols).for_each(scan_line);
    along_strided_axis(&mut squared, cols, rows);
    Raster::from_vec(rows, cols, squared.into_iter().map(f32::sqrt).collect()).expect("the shape did not change")
}

/// Distance of every node to the nearest `true` node, in cells; infinite everywhere if there is none.
pub fn distance_to_true_3d(sources: &VoxelGrid<bool>) -> VoxelGrid<f32> {
    let [nx, ny, nz] = sources.dims();
    let mut grid = VoxelGrid::filled(sources.origin(), sources.spacing(), sources.dims(), f32::INFINITY);
    let squared = grid.as_mut_slice();
    if squared.is_empty() {
        return grid;
    }
    for (d, &s) in squared.iter_mut().zip(sources.as_slice()) {
        if s {
            *d = 0.0;
        }
    }
    squared.par_chunks_mut(nx).for_each(scan_line);
    squared.par_chunks_mut(nx * ny).for_each(|slab| {
        let mut envelope = Envelope::new(ny);
        (0..nx).for_each(|i| envelope.transform(slab, i, nx));
    });
    along_strided_axis(squared, nx * ny, nz);
    squared.par_iter_mut().for_each(|d| *d = d.sqrt());
    grid
}

/// Squared distances along a line that holds 0 at the sources and ∞ elsewhere.
fn scan_line(line: &mut [f32]) {
    let mut steps = f32::INFINITY;
    for d in line.iter_mut() {
        steps = if *d == 0.0 { 0.0 } else { steps + 1.0 };
        *d = steps;
    }
    steps = f32::INFINITY;
    for d in line.iter_mut().rev() {
        steps = if *d == 0.0 { 0.0 } else { steps + 1.0 };
        let nearest = d.min(steps);
        *d = nearest * nearest;
    }
}

/// Transforms the slowest axis of `data`, whose neighbours lie `stride` apart.
fn along_strided_axis(data: &mut [f32], stride: usize, length: usize) {
    const BLOCK: usize = 64;
    let source = &*data;
    // Columns are gathered in blocks, so that the strided reads share cache lines.
    let blocks: Vec<Vec<f32>> = (0..stride.div_ceil(BLOCK))
        .into_par_iter()
        .map(|b| {
            let (start, width) = (b * BLOCK, BLOCK.min(stride - b * BLOCK));
            let mut block: Vec<f32> = (0..length)
                .flat_map(|k| source[k * stride + start..k * stride + start + width].iter().copied())
                .collect();
            let mut envelope = Envelope::new(length);
            (0..width).for_each(|i| envelope.transform(&mut block, i, width));
            block
        })
        .collect();
    for (b, block) in blocks.iter().enumerate() {
        let (start, width) = (b * BLOCK, BLOCK.min(stride - b * BLOCK));
        for (k, line) in block.chunks_exact(width).enumerate() {
            data[k * stride + start..k * stride + start + width].copy_from_slice(line);
        }
    }
}

/// The lower envelope of the parabolas f(q) + (x − q)² of one line.
struct Envelope {
    values: Vec<f32>,
    apex: Vec<usize>,
    from: Vec<f32>,
}

impl Envelope {
    fn new(length: usize) -> Self {
        Self { values: vec![0.0; length], apex: Vec::with_capacity(length), from: Vec::with_capacity(length) }
    }

    fn transform(&mut self, data: &mut [f32], start: usize, stride: usize) {
        for (k, v) in self.values.iter_mut().enumerate() {
            *v = data[start + k * stride];
        }
        self.apex.clear();
        self.from.clear();
        for q in 0..self.values.len() {
            if self.values[q].is_infinite() {
                continue;
            }
            let mut begin = f32::NEG_INFINITY;
            while let (Some(&p), Some(&z)) = (self.apex.last(), self.from.last()) {
                begin = (self.height(q) - self.height(p)) / (2.0 * (q - p) as f32);
                if begin > z {
                    break;
                }
                self.apex.pop();
                self.from.pop();
                begin = f32::NEG_INFINITY;
            }
            self.apex.push(q);
            self.from.push(begin);
        }
        if self.apex.is_empty() {
            return;
        }
        let mut current = 0;
        for x in 0..self.values.len() {
            while current + 1 < self.apex.len() && self.from[current + 1] < x as f32 {
                current += 1;
            }
            let q = self.apex[current];
            let d = x as f32 - q as f32;
            data[start + x * stride] = self.values[q] + d * d;
        }
    }

    fn height(&self, q: usize) -> f32 {
        self.values[q] + (q * q) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use rand::{Rng as _, RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn raster_distance_equals_brute_force() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mask = Raster::from_fn(23, 70, |_, _| rng.next_u32().is_multiple_of(61));
        let sources: Vec<(usize, usize)> = mask.pixels().filter(|p| *p.2).map(|(r, c, _)| (r, c)).collect();
        assert!(sources.len() > 5);
        for (row, col, &d) in distance_to_true(&mask).pixels() {
            let brute = sources
                .iter()
                .map(|s| (row.abs_diff(s.0).pow(2) + col.abs_diff(s.1).pow(2)) as f32)
                .fold(f32::INFINITY, f32::min);
            assert_eq!(d, brute.sqrt(), "pixel {row}, {col}");
        }
    }

    #[test]
    fn grid_distance_equals_brute_force() {
        let mut rng = Pcg64Mcg::seed_from_u64(2);
        let mut grid = VoxelGrid::filled(Point::origin(), 1.0, [11, 9, 13], false);
        grid.as_mut_slice().iter_mut().for_each(|s| *s = rng.random_bool(0.01));
        let node = |n: usize| [n % 11, (n / 11) % 9, n / 99];
        let sources: Vec<[usize; 3]> = (0..11 * 9 * 13).filter(|&n| grid.as_slice()[n]).map(node).collect();
        assert!(sources.len() > 5);
        for (n, &d) in distance_to_true_3d(&grid).as_slice().iter().enumerate() {
            let brute = sources
                .iter()
                .map(|s| (0..3).map(|a| node(n)[a].abs_diff(s[a]).pow(2)).sum::<usize>() as f32)
                .fold(f32::INFINITY, f32::min);
            assert_eq!(d, brute.sqrt(), "node {:?}", node(n));
        }
    }

    #[test]
    fn no_source_is_infinitely_far() {
        assert!(distance_to_true(&Raster::filled(3, 4, false)).as_slice().iter().all(|d| d.is_infinite()));
        let grid = VoxelGrid::filled(Point::origin(), 1.0, [2, 3, 4], false);
        assert!(distance_to_true_3d(&grid).as_slice().iter().all(|d| d.is_infinite()));
    }
}
