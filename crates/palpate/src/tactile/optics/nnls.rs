//! Least squares with loads that can only push.

use nalgebra::{DMatrix, DVector};

/// The x ≥ 0 that brings `matrix` · x closest to `target`, least squares; `matrix` has full column rank.
///
/// Block principal pivoting: all entries that break a condition change sides at once, one at a time if that does not help.
///
/// # References
/// Kim & Park, *Fast nonnegative matrix factorization: an active-set-like method*, SIAM J. Sci. Comput. 2011, Algorithm 1.
pub(super) fn nnls(matrix: &DMatrix<f64>, target: &DVector<f64>) -> DVector<f64> {
    /// Times that the number of broken conditions may fail to fall before entries change sides one at a time.
    const PATIENCE: usize = 3;
    let n = matrix.ncols();
    let mut normal = matrix.tr_mul(matrix);
    // Rounding must not make the normal matrix indefinite.
    let ridge = 1e-12 * normal.trace() / n.max(1) as f64;
    (0..n).for_each(|i| normal[(i, i)] += ridge);
    let right = matrix.tr_mul(target);
    let tolerance = 1e-10 * right.amax();
    // Most often all loads push: start there.
    let mut free = vec![true; n];
    let mut solution = DVector::zeros(n);
    let (mut fewest, mut patience) = (n + 1, PATIENCE);
    // Ends long before; the bound keeps a matrix that is none of full rank from turning in circles.
    for _ in 0..10 * (n + 1) {
        solution = restricted(&normal, &right, &free);
        let slope = &normal * &solution - &right;
        let broken: Vec<usize> =
            (0..n).filter(|&i| if free[i] { solution[i] < 0.0 } else { slope[i] < -tolerance }).collect();
        let Some(&last) = broken.last() else { break };
        if broken.len() < fewest {
            (fewest, patience) = (broken.len(), PATIENCE);
        } else if patience > 0 {
            patience -= 1;
        } else {
            free[last] = !free[last];
            continue;
        }
        for i in broken {
            free[i] = !free[i];
        }
    }
    solution.map(|x| x.max(0.0))
}

/// The least-squares solution whose entries outside `free` are zero.
fn restricted(normal: &DMatrix<f64>, right: &DVector<f64>, free: &[bool]) -> DVector<f64> {
    let chosen: Vec<usize> = (0..free.len()).filter(|&i| free[i]).collect();
    let sub = normal.select_rows(&chosen).select_columns(&chosen);
    let mut solution = DVector::zeros(free.len());
    let part = right.select_rows(&chosen);
    // A matrix without full rank gives nothing rather than noise.
    if let Some(factors) = sub.cholesky() {
        for (&i, x) in chosen.iter().zip(factors.solve(&part).iter()) {
            solution[i] = *x;
        }
    }
    solution
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};

    #[test]
    fn solves_what_has_a_non_negative_solution_exactly() {
        let a = DMatrix::from_row_slice(3, 2, &[2.0, 1.0, 1.0, 3.0, 0.0, 1.0]);
        let x = DVector::from_column_slice(&[0.5, 2.0]);
        assert!((nnls(&a, &(&a * &x)) - x).amax() < 1e-9);
        assert_eq!(nnls(&DMatrix::zeros(0, 0), &DVector::zeros(0)).len(), 0);
    }

    #[test]
    fn meets_the_optimality_conditions_on_random_problems() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(5);
        for n in [1, 2, 7, 30] {
            let a = DMatrix::from_fn(n + 4, n, |_, _| rng.random_range(-1.0..1.0));
            let b = DVector::from_fn(n + 4, |_, _| rng.random_range(-1.0..1.0));
            let x = nnls(&a, &b);
            let slope = a.tr_mul(&(&a * &x - &b));
            for (x, slope) in x.iter().zip(slope.iter()) {
                assert!(*x >= 0.0 && *slope > -1e-8 && x * slope < 1e-8, "{n}: {x} {slope}");
            }
        }
    }
}
