use crate::geometry::{Raster, UnionFind};

/// Centre `[column, row]` and radius of the largest region that changed by more than half of what the strongest pixels did:
/// contact and skirt of a ball. `None` if nothing changed.
pub fn outline(difference: &Raster<[f32; 3]>) -> Option<([f64; 2], f64)> {
    let (rows, cols) = difference.shape();
    let size = smoothed(&difference.map(|d| d.iter().map(|v| v * v).sum::<f32>().sqrt()));
    let mut sorted = size.as_slice().to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    // A small ball covers one pixel in two hundred.
    let limit = 0.5 * sorted[sorted.len() * 995 / 1000];
    // Written so that NaN fails too.
    if !(limit > 1.0) {
        return None;
    }
    let changed = |i: usize| size.as_slice()[i] > limit;
    let mut sets = UnionFind::new(rows * cols);
    for i in 0..rows * cols {
        if changed(i) {
            if i % cols > 0 && changed(i - 1) {
                sets.union(i as u32, (i - 1) as u32);
            }
            if i >= cols && changed(i - cols) {
                sets.union(i as u32, (i - cols) as u32);
            }
        }
    }
    let mut sums = std::collections::BTreeMap::<u32, [f64; 3]>::new();
    for i in (0..rows * cols).filter(|&i| changed(i)) {
        let sum = sums.entry(sets.find(i as u32)).or_default();
        *sum = [sum[0] + (i % cols) as f64, sum[1] + (i / cols) as f64, sum[2] + 1.0];
    }
    let [x, y, n] = sums.into_values().max_by(|a, b| a[2].total_cmp(&b[2]))?;
    Some(([x / n, y / n], (n / std::f64::consts::PI).sqrt()))
}

/// Mean over 5 × 5 pixels, borders repeated.
fn smoothed(image: &Raster<f32>) -> Raster<f32> {
    let (rows, cols) = image.shape();
    let near = |i: usize, k: usize, n: usize| (i + k).saturating_sub(2).min(n - 1);
    let across = Raster::from_fn(rows, cols, |r, c| (0..5).map(|k| image[(r, near(c, k, cols))]).sum::<f32>() / 5.0);
    Raster::from_fn(rows, cols, |r, c| (0..5).map(|k| across[(near(r, k, rows), c)]).sum::<f32>() / 5.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_region_counts_and_nothing_has_none() {
        let image = Raster::from_fn(120, 160, |r, c| {
            let at = |x: f64, y: f64| (c as f64 - x).hypot(r as f64 - y);
            if at(100.0, 50.0) < 20.0 || at(20.0, 100.0) < 6.0 { [60.0, -40.0, 10.0] } else { [0.5; 3] }
        });
        let (center, radius) = outline(&image).expect("a region");
        assert!((center[0] - 100.0).abs() < 0.5 && (center[1] - 50.0).abs() < 0.5 && (radius - 20.0).abs() < 1.5);
        assert_eq!(outline(&Raster::filled(60, 80, [0.1; 3])), None);
    }
}
