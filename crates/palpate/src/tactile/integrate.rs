//! Gradients to height on a raster: the Poisson equation solved in one pass by sine or cosine transforms, O(n log n).

use super::sine::{SineBuffers, SineTransform};
use crate::geometry::Raster;
use rustdct::{DctPlanner, TransformType2And3};
use std::f64::consts::PI;
use std::sync::{Arc, Mutex};

/// Integrates gradients of rasters of one size; keeps transform plans, eigenvalues and buffers between calls.
///
/// Gradients are per pixel, `[along columns, along rows]`, height per pixel. The step between two neighbours is taken as the mean
/// of their gradients, and the divergence as the matching backward difference: exact for heights that are quadratic in the pixel
/// index with central-difference gradients. (The fast Poisson of the YCB-Sight scripts takes the first pixel's gradient alone,
/// which shifts the result by half a pixel.)
pub struct Integrator {
    rows: usize,
    cols: usize,
    cosine: [Arc<dyn TransformType2And3<f32>>; 2],
    /// Absent where no pixel lies inside the border ring.
    sine: Option<[SineTransform; 2]>,
    /// Eigenvalues of the second difference along columns and rows, Neumann borders.
    neumann: [Vec<f32>; 2],
    /// The same of the inner pixels, zero border.
    dirichlet: [Vec<f32>; 2],
    buffers: Mutex<Vec<Buffers>>,
}

#[derive(Default)]
struct Buffers {
    field: Vec<f32>,
    transposed: Vec<f32>,
    scratch: Vec<f32>,
    sine: SineBuffers,
}

impl std::fmt::Debug for Integrator {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Integrator").field("rows", &self.rows).field("cols", &self.cols).finish_non_exhaustive()
    }
}

/// 2 cos(π (i + first) / period) − 2 for i in 0..n.
fn eigenvalues(n: usize, first: usize, period: usize) -> Vec<f32> {
    // −4 sin² keeps the digits that 2 cos − 2 cancels.
    (first..first + n).map(|i| (-4.0 * (0.5 * PI * i as f64 / period as f64).sin().powi(2)) as f32).collect()
}

impl Integrator {
    /// Plans for rasters of `rows × cols`, both at least 1.
    pub fn new(rows: usize, cols: usize) -> Self {
        let (rows, cols) = (rows.max(1), cols.max(1));
        let mut planner = DctPlanner::new();
        let inner = (rows.saturating_sub(2), cols.saturating_sub(2));
        let sine = (inner.0 > 0 && inner.1 > 0).then(|| [SineTransform::new(inner.1), SineTransform::new(inner.0)]);
        Self {
            rows,
            cols,
            cosine: [planner.plan_dct2(cols), planner.plan_dct2(rows)],
            sine,
            neumann: [eigenvalues(cols, 0, cols), eigenvalues(rows, 0, rows)],
            dirichlet: [
                eigenvalues(inner.1, 1, cols.saturating_sub(1).max(1)),
                eigenvalues(inner.0, 1, rows.saturating_sub(1).max(1)),
            ],
            buffers: Mutex::new(Vec::new()),
        }
    }

    /// `(rows, cols)` of the rasters.
    pub fn shape(&self) -> (usize, usize) {
        (self.rows, self.cols)
    }

    /// Height that is 0 on the border ring. False wherever a contact runs out of the image: the classic failure on flat faces.
    ///
    /// # Panics
    /// If the raster is not of this size (as the other solvers).
    ///
    /// # References
    /// Simchony, Chellappa & Shao, *Direct analytical methods for solving Poisson equations in computer vision*, PAMI 1990.
    pub fn poisson_dirichlet(&self, gradients: &Raster<[f32; 2]>) -> Raster<f32> {
        assert_eq!(gradients.shape(), self.shape(), "the integrator is made for one size");
        let mut height = Raster::filled(self.rows, self.cols, 0.0f32);
        let Some(sine) = &self.sine else { return height };
        let (rows, cols) = (self.rows - 2, self.cols - 2);
        let mut buffers = self.take_buffers();
        let Buffers { field, transposed, sine: lines, .. } = &mut buffers;
        field.clear();
        for row in 1..=rows {
            let line = divergence_line(gradients, row);
            field.extend((1..=cols).map(line));
        }
        sine[0].process(field, lines);
        transpose(field, transposed, rows, cols);
        sine[1].process(transposed, lines);
        // Each sine transform is its own inverse up to (n + 1)/2.
        let scale = 4.0 / ((rows + 1) as f32 * (cols + 1) as f32);
        for (line, lx) in transposed.chunks_exact_mut(rows).zip(&self.dirichlet[0]) {
            line.iter_mut().zip(&self.dirichlet[1]).for_each(|(v, ly)| *v *= scale / (lx + ly));
        }
        sine[1].process(transposed, lines);
        transpose(transposed, field, cols, rows);
        sine[0].process(field, lines);
        for (row, line) in field.chunks_exact(cols).enumerate() {
            let start = (row + 1) * self.cols + 1;
            height.as_mut_slice()[start..start + cols].copy_from_slice(line);
        }
        self.give_back(buffers);
        height
    }

    /// Height with free borders, mean 0 (gradients do not tell the level).
    pub fn poisson_neumann(&self, gradients: &Raster<[f32; 2]>) -> Raster<f32> {
        assert_eq!(gradients.shape(), self.shape(), "the integrator is made for one size");
        self.cosine_solve(0.0, |row, out| out.extend((0..self.cols).map(divergence_line(gradients, row))))
    }

    /// Height with free borders, mean 0, of which every **step** to the next column and the next row is given: exact if the steps
    /// are those of a height, least squares if not. Steps over the border are ignored.
    pub fn integrate_steps(&self, steps: &Raster<[f32; 2]>) -> Raster<f32> {
        assert_eq!(steps.shape(), self.shape(), "the integrator is made for one size");
        let (rows, cols) = self.shape();
        let line = |row: usize| &steps.as_slice()[row * cols..][..cols];
        self.cosine_solve(0.0, |row, out| {
            let (here, above) = (line(row), (row > 0).then(|| line(row - 1)));
            out.extend((0..cols).map(|col| {
                let right = if col + 1 < cols { here[col][0] } else { 0.0 };
                let left = if col > 0 { here[col - 1][0] } else { 0.0 };
                let down = if row + 1 < rows { here[col][1] } else { 0.0 };
                right - left + down - above.map_or(0.0, |above| above[col][1])
            }));
        })
    }

    /// The height h that minimises Σ |∇h − gradients|² + λ Σ (h − prior)², free borders: the detail of the gradients on the level
    /// of the prior. The mean is the prior's.
    ///
    /// * `lambda` – per pixel². Larger: nearer to the prior; structures wider than 2π/√λ pixels are the prior's, narrower ones
    ///   the gradients'. 0 leaves the prior only its mean.
    ///
    /// # References
    /// Bhat et al., *Fourier analysis of the 2D screened Poisson equation for gradient domain problems*, ECCV 2008.
    pub fn poisson_screened(&self, gradients: &Raster<[f32; 2]>, prior: &Raster<f32>, lambda: f32) -> Raster<f32> {
        assert_eq!(gradients.shape(), self.shape(), "the integrator is made for one size");
        assert_eq!(prior.shape(), self.shape(), "the integrator is made for one size");
        // Solved for h − mean: in f32 a large level would cost digits.
        let mean = (prior.as_slice().iter().map(|&p| f64::from(p)).sum::<f64>() / prior.as_slice().len() as f64) as f32;
        let mut height = self.cosine_solve(lambda, |row, out| {
            let line = divergence_line(gradients, row);
            let prior = &prior.as_slice()[row * self.cols..][..self.cols];
            out.extend(prior.iter().enumerate().map(|(col, p)| line(col) - lambda * (p - mean)));
        });
        height.as_mut_slice().iter_mut().for_each(|h| *h += mean);
        height
    }

    /// Solves (Laplacian − λ) h = right side with free borders, mean 0; `fill` appends one row of the right side.
    fn cosine_solve(&self, lambda: f32, fill: impl Fn(usize, &mut Vec<f32>)) -> Raster<f32> {
        let (rows, cols) = self.shape();
        let mut buffers = self.take_buffers();
        let Buffers { field, transposed, scratch, .. } = &mut buffers;
        field.clear();
        (0..rows).for_each(|row| fill(row, field));
        let transform = |data: &mut [f32], axis: usize, forward: bool, scratch: &mut Vec<f32>| {
            let plan = &self.cosine[axis];
            scratch.resize(plan.get_scratch_len(), 0.0);
            for line in data.chunks_exact_mut(if axis == 0 { cols } else { rows }) {
                if forward {
                    plan.process_dct2_with_scratch(line, scratch);
                } else {
                    plan.process_dct3_with_scratch(line, scratch);
                }
            }
        };
        transform(field, 0, true, scratch);
        transpose(field, transposed, rows, cols);
        transform(transposed, 1, true, scratch);
        // DCT-III undoes DCT-II up to n/2.
        let scale = 4.0 / (rows as f32 * cols as f32);
        for (line, lx) in transposed.chunks_exact_mut(rows).zip(&self.neumann[0]) {
            line.iter_mut().zip(&self.neumann[1]).for_each(|(v, ly)| *v *= scale / (lx + ly - lambda));
        }
        transposed[0] = 0.0;
        transform(transposed, 1, false, scratch);
        transpose(transposed, field, cols, rows);
        transform(field, 0, false, scratch);
        let height = Raster::from_vec(rows, cols, field.clone()).expect("one value a pixel");
        self.give_back(buffers);
        height
    }

    /// Buffers that no call is using, or new ones: calls from several threads do not wait for each other.
    fn take_buffers(&self) -> Buffers {
        self.buffers.lock().map_or_else(|_| None, |mut free| free.pop()).unwrap_or_default()
    }

    fn give_back(&self, buffers: Buffers) {
        if let Ok(mut free) = self.buffers.lock() {
            free.push(buffers);
        }
    }
}

/// Divergence at each column of a row: differences of the steps to the neighbours, steps over the border being 0.
fn divergence_line(gradients: &Raster<[f32; 2]>, row: usize) -> impl Fn(usize) -> f32 {
    let (rows, cols) = gradients.shape();
    let line = |row: usize| &gradients.as_slice()[row * cols..][..cols];
    let (here, above) = (line(row), (row > 0).then(|| line(row - 1)));
    let below = (row + 1 < rows).then(|| line(row + 1));
    move |col| {
        let [gx, gy] = here[col];
        let right = if col + 1 < cols { gx + here[col + 1][0] } else { 0.0 };
        let left = if col > 0 { here[col - 1][0] + gx } else { 0.0 };
        let down = below.map_or(0.0, |below| gy + below[col][1]);
        let up = above.map_or(0.0, |above| above[col][1] + gy);
        0.5 * (right - left + down - up)
    }
}

/// `rows × cols` to `cols × rows`, in tiles that stay in the cache.
fn transpose(source: &[f32], target: &mut Vec<f32>, rows: usize, cols: usize) {
    const TILE: usize = 16;
    target.resize(rows * cols, 0.0);
    for row0 in (0..rows).step_by(TILE) {
        for col0 in (0..cols).step_by(TILE) {
            for col in col0..(col0 + TILE).min(cols) {
                for row in row0..(row0 + TILE).min(rows) {
                    target[col * rows + row] = source[row * cols + col];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gradients whose mean over two neighbours is exactly the step between them.
    fn gradients_of(height: &Raster<f32>, slope: impl Fn(f32, f32) -> [f32; 2]) -> Raster<[f32; 2]> {
        Raster::from_fn(height.rows(), height.cols(), |r, c| slope(r as f32, c as f32))
    }

    fn worst(a: &Raster<f32>, b: &Raster<f32>) -> f32 {
        a.as_slice().iter().zip(b.as_slice()).fold(0.0, |m, (a, b)| m.max((a - b).abs()))
    }

    fn mean_free(mut map: Raster<f32>) -> Raster<f32> {
        let mean = map.as_slice().iter().sum::<f32>() / map.as_slice().len() as f32;
        map.as_mut_slice().iter_mut().for_each(|h| *h -= mean);
        map
    }

    #[test]
    fn neumann_recovers_a_quadratic_exactly_at_any_size() {
        for (rows, cols) in [(2, 2), (2, 9), (7, 5), (24, 32), (31, 17)] {
            // h = 0.02 c² − 0.03 r² + 0.01 r c: a step is the mean of the analytic slopes at its ends.
            let height = Raster::from_fn(rows, cols, |r, c| {
                let (r, c) = (r as f32, c as f32);
                0.02 * c * c - 0.03 * r * r + 0.01 * r * c
            });
            let g = gradients_of(&height, |r, c| [0.04 * c + 0.01 * r, -0.06 * r + 0.01 * c]);
            let found = Integrator::new(rows, cols).poisson_neumann(&g);
            assert!(worst(&found, &mean_free(height)) < 2e-4, "{rows} {cols}");
        }
    }

    #[test]
    fn the_steps_of_any_height_give_it_back() {
        let (rows, cols) = (13, 20);
        let hash = |i: usize| ((i * 2_654_435_761) % 1000) as f32 / 1000.0 - 0.5;
        let height = mean_free(Raster::from_fn(rows, cols, |r, c| hash(r * 31 + c * 7)));
        let steps = Raster::from_fn(rows, cols, |r, c| {
            let at = |r: usize, c: usize| height.get(r, c).copied().unwrap_or(7.0);
            [at(r, c + 1) - at(r, c), at(r + 1, c) - at(r, c)]
        });
        assert!(worst(&Integrator::new(rows, cols).integrate_steps(&steps), &height) < 1e-5);
    }

    #[test]
    fn dirichlet_recovers_a_sine_that_is_zero_on_the_border() {
        // Lengths that the transforms handle directly and through a Fourier transform.
        let (rows, cols) = (25, 97);
        let (ky, kx) = (PI as f32 * 2.0 / 24.0, PI as f32 * 3.0 / 96.0);
        let height = Raster::from_fn(rows, cols, |r, c| (kx * c as f32).sin() * (ky * r as f32).sin());
        // A step of sin(k c) is the mean of k' cos at its ends with k' = 2 tan(k/2).
        let slope = |k: f32| 2.0 * (0.5 * k).tan();
        let g = gradients_of(&height, |r, c| {
            [slope(kx) * (kx * c).cos() * (ky * r).sin(), slope(ky) * (kx * c).sin() * (ky * r).cos()]
        });
        let integrator = Integrator::new(rows, cols);
        assert!(worst(&integrator.poisson_dirichlet(&g), &height) < 2e-5);
        // Buffers are used again without a trace of the last call.
        assert_eq!(integrator.poisson_dirichlet(&g), integrator.poisson_dirichlet(&g));
        let ring = integrator.poisson_dirichlet(&Raster::filled(rows, cols, [1.0, -2.0]));
        assert!((0..cols).all(|c| ring[(0, c)] == 0.0 && ring[(rows - 1, c)] == 0.0));
    }

    #[test]
    fn neumann_recovers_a_cosine_at_the_size_of_the_decoders() {
        let (rows, cols) = (240, 320);
        let (ky, kx) = (PI as f32 * 4.0 / 240.0, PI as f32 * 7.0 / 320.0);
        let at = |i: f32, k: f32| k * (i + 0.5);
        let height = Raster::from_fn(rows, cols, |r, c| at(c as f32, kx).cos() * at(r as f32, ky).cos());
        let slope = |k: f32| -2.0 * (0.5 * k).tan();
        let g = gradients_of(&height, |r, c| {
            [slope(kx) * at(c, kx).sin() * at(r, ky).cos(), slope(ky) * at(c, kx).cos() * at(r, ky).sin()]
        });
        assert!(worst(&Integrator::new(rows, cols).poisson_neumann(&g), &height) < 5e-5);
    }

    #[test]
    fn dirichlet_without_inner_pixels_is_zero() {
        let flat = Integrator::new(2, 8).poisson_dirichlet(&Raster::filled(2, 8, [1.0, 1.0]));
        assert!(flat.as_slice().iter().all(|&h| h == 0.0));
    }

    #[test]
    fn screened_goes_from_the_prior_to_the_gradients() {
        let (rows, cols) = (24, 32);
        let shape = Raster::from_fn(rows, cols, |r, c| 0.01 * (c as f32 - 10.0).powi(2) + 0.005 * (r as f32).powi(2));
        let g = gradients_of(&shape, |r, c| [0.02 * (c - 10.0), 0.01 * r]);
        let prior = Raster::from_fn(rows, cols, |r, c| 5.0 + (0.7 * r as f32).sin() + (0.4 * c as f32).cos());
        let integrator = Integrator::new(rows, cols);
        let mean = prior.as_slice().iter().sum::<f32>() / prior.as_slice().len() as f32;
        let level = mean_free(shape.clone()).map(|h| h + mean);
        assert!(worst(&integrator.poisson_screened(&g, &prior, 0.0), &level) < 1e-4);
        assert!(worst(&integrator.poisson_screened(&g, &prior, 1e-8), &level) < 1e-3);
        assert!(worst(&integrator.poisson_screened(&g, &prior, 1e6), &prior) < 1e-4);
        // A prior that has these gradients is a fixed point at any λ.
        assert!(worst(&integrator.poisson_screened(&g, &shape, 1e-2), &shape) < 1e-4);
    }

    #[test]
    fn screened_is_the_minimum_of_its_energy() {
        let (rows, cols) = (6, 7);
        let hash = |i: usize| ((i * 2_654_435_761) % 1000) as f32 / 1000.0 - 0.5;
        let g = Raster::from_fn(rows, cols, |r, c| [hash(r * 31 + c), hash(r * 17 + c * 5 + 3)]);
        let prior = Raster::from_fn(rows, cols, |r, c| hash(r * 7 + c * 13 + 1));
        let lambda = 0.3;
        let energy = |h: &Raster<f32>| {
            let mut sum = 0.0f64;
            for (r, c, &z) in h.pixels() {
                if c + 1 < cols {
                    sum += f64::from(h[(r, c + 1)] - z - 0.5 * (g[(r, c)][0] + g[(r, c + 1)][0])).powi(2);
                }
                if r + 1 < rows {
                    sum += f64::from(h[(r + 1, c)] - z - 0.5 * (g[(r, c)][1] + g[(r + 1, c)][1])).powi(2);
                }
                sum += f64::from(lambda * (z - prior[(r, c)]).powi(2));
            }
            sum
        };
        let best = Integrator::new(rows, cols).poisson_screened(&g, &prior, lambda);
        let least = energy(&best);
        for pixel in 0..rows * cols {
            for step in [-0.01, 0.01] {
                let mut other = best.clone();
                other.as_mut_slice()[pixel] += step;
                assert!(energy(&other) > least, "pixel {pixel}");
            }
        }
    }
}
