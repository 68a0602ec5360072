use super::Point;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use std::num::NonZero;

/// Nearest-neighbour search over a fixed set of points. The only file that names the k-d tree crate.
///
/// Build O(n log n), query O(log n) on average. Ties in distance go to the smaller index.
pub struct KdTree {
    tree: Option<ImmutableKdTree<f64, 3>>,
}

impl KdTree {
    /// Builds the tree; an empty set is allowed and finds nothing. Points must be finite.
    pub fn new(points: &[Point]) -> Self {
        debug_assert!(points.iter().all(|p| p.iter().all(|c| c.is_finite())));
        let entries: Vec<[f64; 3]> = points.iter().map(|p| [p.x, p.y, p.z]).collect();
        let tree = if entries.is_empty() { None } else { ImmutableKdTree::new_from_slice(&entries).ok() };
        Self { tree }
    }

    /// Index of the nearest point and its distance, metres.
    pub fn nearest(&self, p: &Point) -> Option<(usize, f64)> {
        let found = self.tree.as_ref()?.query(&[p.x, p.y, p.z]).nearest_one::<SquaredEuclidean<f64>>().execute();
        Some((found.item as usize, found.distance.sqrt()))
    }

    /// The `count` nearest points, nearest first, as (index, distance).
    pub fn nearest_n(&self, p: &Point, count: usize) -> Vec<(usize, f64)> {
        let (Some(tree), Some(count)) = (&self.tree, NonZero::new(count)) else { return Vec::new() };
        let found = tree.query(&[p.x, p.y, p.z]).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        sorted(found.into_iter().map(|f| (f.item as usize, f.distance)).collect())
    }

    /// All points within `radius` metres, nearest first, as (index, distance).
    pub fn within(&self, p: &Point, radius: f64) -> Vec<(usize, f64)> {
        let Some(tree) = &self.tree else { return Vec::new() };
        let found = tree.query(&[p.x, p.y, p.z]).within::<SquaredEuclidean<f64>>(radius * radius).unsorted().execute();
        sorted(found.into_iter().map(|f| (f.item as usize, f.distance)).collect())
    }
}

fn sorted(mut found: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    found.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    for f in &mut found {
        f.1 = f.1.sqrt();
    }
    found
}
