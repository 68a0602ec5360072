use super::{KdTree, Point};
use rayon::prelude::*;
use std::collections::HashMap;

/// Disjoint sets of 0..n with path halving; the smallest member represents a set, so results do not depend on the order of unions.
#[derive(Debug, Clone)]
pub struct UnionFind {
    parent: Vec<u32>,
}

impl UnionFind {
    /// Every element alone.
    pub fn new(len: usize) -> Self {
        Self { parent: (0..len as u32).collect() }
    }

    /// The smallest member of the element's set.
    #[inline]
    pub fn find(&mut self, mut i: u32) -> u32 {
        while self.parent[i as usize] != i {
            let up = self.parent[self.parent[i as usize] as usize];
            self.parent[i as usize] = up;
            i = up;
        }
        i
    }

    /// Joins two sets.
    #[inline]
    pub fn union(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }
}

/// Euclidean clusters: two points share a label if a chain of points with gaps below `radius` joins them.
///
/// Labels count from 0 in the order of each cluster's first point. Points must be finite.
///
/// Cells of side `radius`/√3 hold only points that belong together, so one close pair per pair of cells settles it.
pub fn euclidean_clusters(points: &[Point], radius: f64) -> Vec<u32> {
    let side = radius / 3.0_f64.sqrt();
    let key = |p: &Point| [0, 1, 2].map(|i| (p[i] / side).floor() as i64);
    let mut by_cell: Vec<([i64; 3], u32)> = points.iter().enumerate().map(|(i, p)| (key(p), i as u32)).collect();
    by_cell.sort_unstable();
    let mut cells: Vec<([i64; 3], &[([i64; 3], u32)])> = Vec::new();
    for members in by_cell.chunk_by(|a, b| a.0 == b.0) {
        cells.push((members[0].0, members));
    }
    let index: HashMap<[i64; 3], usize> = cells.iter().enumerate().map(|(i, (key, _))| (*key, i)).collect();
    let mut sets = UnionFind::new(points.len());
    for (key, members) in &cells {
        for (_, i) in &members[1..] {
            sets.union(members[0].1, *i);
        }
        for offset in forward_offsets() {
            let Some(&other) = index.get(&[key[0] + offset[0], key[1] + offset[1], key[2] + offset[2]]) else {
                continue;
            };
            let others = cells[other].1;
            if sets.find(members[0].1) == sets.find(others[0].1) {
                continue;
            }
            let close = |a: u32, b: u32| (points[a as usize] - points[b as usize]).norm_squared() < radius * radius;
            if members.iter().any(|(_, a)| others.iter().any(|(_, b)| close(*a, *b))) {
                sets.union(members[0].1, others[0].1);
            }
        }
    }
    compact_labels(&mut sets, points.len())
}

/// Half of the offsets within two cells: the other half is seen from the other cell.
fn forward_offsets() -> impl Iterator<Item = [i64; 3]> {
    (-2..=2)
        .flat_map(|x| (-2..=2).flat_map(move |y| (-2..=2).map(move |z| [x, y, z])))
        .filter(|offset| *offset > [0, 0, 0])
}

fn compact_labels(sets: &mut UnionFind, len: usize) -> Vec<u32> {
    let mut labels = vec![0; len];
    let mut next = 0;
    for i in 0..len as u32 {
        let root = sets.find(i);
        labels[i as usize] = if root == i {
            next += 1;
            next - 1
        } else {
            labels[root as usize]
        };
    }
    labels
}

/// Number of members of each label.
pub fn cluster_sizes(labels: &[u32]) -> Vec<usize> {
    let mut sizes = vec![0; labels.iter().max().map_or(0, |&m| m as usize + 1)];
    for &label in labels {
        sizes[label as usize] += 1;
    }
    sizes
}

/// True for points whose mean distance to their `neighbours` nearest lies more than `ratio` standard deviations above the
/// average over all points. Points must be finite.
///
/// # References
/// Rusu et al., *Towards 3D point cloud based object maps for household environments*, RAS 56(11), 2008, §4.1.
pub fn statistical_outliers(points: &[Point], neighbours: usize, ratio: f64) -> Vec<bool> {
    let tree = KdTree::new(points);
    let mean_distance: Vec<f64> = points
        .par_iter()
        .map(|p| {
            let found = tree.nearest_n(p, neighbours + 1);
            found.iter().map(|f| f.1).sum::<f64>() / found.len().saturating_sub(1).max(1) as f64
        })
        .collect();
    let limit = outlier_limit(&mean_distance, ratio);
    mean_distance.iter().map(|&d| d > limit).collect()
}

/// Mean + `ratio` standard deviations.
pub(crate) fn outlier_limit(values: &[f64], ratio: f64) -> f64 {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count;
    mean + ratio * variance.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn clusters_match_brute_force() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let points: Vec<Point> = (0..400).map(|_| Point::from([(); 3].map(|()| rng.random_range(-1.0..1.0)))).collect();
        for radius in [0.05, 0.15, 0.2, 0.4] {
            let mut sets = UnionFind::new(points.len());
            for i in 0..points.len() {
                for j in 0..i {
                    if (points[i] - points[j]).norm() < radius {
                        sets.union(i as u32, j as u32);
                    }
                }
            }
            assert_eq!(euclidean_clusters(&points, radius), compact_labels(&mut sets, points.len()), "radius {radius}");
        }
    }

    #[test]
    fn clusters_of_nothing_and_of_one_point() {
        assert!(euclidean_clusters(&[], 0.1).is_empty());
        assert_eq!(euclidean_clusters(&[Point::new(1.0, 2.0, 3.0)], 0.1), [0]);
        assert_eq!(cluster_sizes(&[0, 1, 1, 0, 1]), [2, 3]);
    }

    #[test]
    fn a_far_point_is_an_outlier() {
        let mut points: Vec<Point> =
            (0..400).map(|i| Point::new((i % 20) as f64 * 1e-3, (i / 20) as f64 * 1e-3, 0.5)).collect();
        points.push(Point::new(0.05, 0.05, 0.5));
        let outliers = statistical_outliers(&points, 8, 4.0);
        assert!(outliers[400]);
        assert_eq!(outliers.iter().filter(|&&o| o).count(), 1);
    }
}
