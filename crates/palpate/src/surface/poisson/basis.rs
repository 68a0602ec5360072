//! Degree-1 B-splines (hats) on a lattice and their integrals, in units of the lattice's cell.
//!
//! With m = [1, 4, 1]/6 the 1D mass, s = [−1, 2, −1] the 1D stiffness and g = [½, 0, −½] = ∫B_i′ B_j for j = i − 1, i, i + 1, the 3D stencils are the
//! tensor products ∫∇B_i·∇B_j = smm + msm + mms and ∫∂ₓB_i B_j = gmm.

/// Entries of the stiffness stencil ∫∇B_i·∇B_j: i = j, a neighbour along an edge diagonal, along a space diagonal (face neighbours cancel).
pub(super) const STIFFNESS: [f64; 3] = [8.0 / 3.0, -1.0 / 6.0, -1.0 / 12.0];

/// ∫B_i B_j in one dimension.
pub(super) const MASS: [f64; 3] = [1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0];
const DERIVATIVE: [f64; 3] = [0.5, 0.0, -0.5];

/// ∫∇B_i B_j for the 27 neighbours j of i, x fastest.
pub(super) fn gradient_stencil() -> [[f64; 3]; 27] {
    std::array::from_fn(|n| {
        let [x, y, z] = [n % 3, n / 3 % 3, n / 9];
        [DERIVATIVE[x] * MASS[y] * MASS[z], MASS[x] * DERIVATIVE[y] * MASS[z], MASS[x] * MASS[y] * DERIVATIVE[z]]
    })
}

/// Values of a cell's eight hats (corner bits x, y, z) at a place in the cell, 0 to 1 along each axis.
#[inline]
pub(super) fn hats(place: [f64; 3]) -> [f64; 8] {
    let [x, y, z] = place.map(|t| [1.0 - t, t]);
    std::array::from_fn(|c| x[c & 1] * y[(c >> 1) & 1] * z[c >> 2])
}

/// Values of the three quadratic B-splines, centred on this cell and its two neighbours, at a place in the cell.
#[inline]
pub(super) fn quadratic(t: f64) -> [f64; 3] {
    [0.5 * (1.0 - t) * (1.0 - t), 0.75 - (t - 0.5) * (t - 0.5), 0.5 * t * t]
}

/// Mean over offsets of Σ_j b_j² for the quadratic B-spline: what a plane of unit density measures when splatted and read with it.
pub(super) const QUADRATIC_SELF: f64 = 0.55;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stiffness_is_the_tensor_product_and_kills_constants() {
        let s = [-1.0, 2.0, -1.0];
        let mut sum = 0.0;
        for n in 0..27 {
            let [x, y, z] = [n % 3, n / 3 % 3, n / 9];
            let entry = s[x] * MASS[y] * MASS[z] + MASS[x] * s[y] * MASS[z] + MASS[x] * MASS[y] * s[z];
            let steps = [x, y, z].iter().filter(|&&i| i != 1).count();
            let expected = [STIFFNESS[0], 0.0, STIFFNESS[1], STIFFNESS[2]][steps];
            assert!((entry - expected).abs() < 1e-15, "{n}: {entry} against {expected}");
            sum += entry;
        }
        assert!(sum.abs() < 1e-14);
    }

    #[test]
    fn the_gradient_stencil_integrates_a_linear_field() {
        // ∫∇B·V = −∫B ∇·V: for V = (x, 0, 0), −1 whatever the place.
        let stencil = gradient_stencil();
        let sum: f64 = (0..27).map(|n| stencil[n][0] * (n % 3) as f64).sum();
        assert!((sum + 1.0).abs() < 1e-14);
        assert!(stencil.iter().map(|s| s[1]).sum::<f64>().abs() < 1e-14);
    }

    #[test]
    fn splines_are_partitions_of_unity() {
        for t in [0.0, 0.2, 0.5, 0.99] {
            assert!((hats([t, 0.3, 1.0 - t]).iter().sum::<f64>() - 1.0).abs() < 1e-14);
            assert!((quadratic(t).iter().sum::<f64>() - 1.0).abs() < 1e-14);
        }
        let steps = 1000;
        let mean: f64 = (0..steps)
            .map(|i| quadratic((i as f64 + 0.5) / steps as f64).iter().map(|b| b * b).sum::<f64>())
            .sum::<f64>()
            / steps as f64;
        assert!((mean - QUADRATIC_SELF).abs() < 1e-5);
    }
}
