use super::{Aabb, Point, Vector};
use rayon::prelude::*;
use std::ops::Range;

/// Most points of a leaf: they share the search.
const LEAF: usize = 32;

/// What `f` makes of each point and its `count` nearest, itself included: squared distances and indices, in a fixed order that is not by distance. Fewer if there
/// are fewer points; ties go to the smaller index, but for those of a heap of equal points. Points must be finite; one that is not finds less.
///
/// O(n log n) on average, in parallel: the points of a k-d tree's leaf share one search, which a tree asked point by point repeats.
pub(crate) fn map_nearest<T: Clone + Default + Send>(
    points: &[Point],
    count: usize,
    f: impl Fn(usize, &[(f64, u32)]) -> T + Sync,
) -> Vec<T> {
    if points.is_empty() || count == 0 {
        return (0..points.len()).map(|i| f(i, &[])).collect();
    }
    let tree = Tree::new(points, count);
    let of_leaf = |leaf: &usize| {
        let mut search = Search::default();
        tree.gather(*leaf, &mut search);
        let own = tree.nodes[*leaf].points.clone();
        let made = own.map(|k| (tree.order[k], f(tree.order[k] as usize, tree.nearest(k, &mut search))));
        made.collect::<Vec<_>>()
    };
    let leaves: Vec<usize> = (0..tree.nodes.len()).filter(|&n| tree.nodes[n].children == 0).collect();
    let mut all = vec![T::default(); points.len()];
    for (i, made) in leaves.par_iter().flat_map_iter(of_leaf).collect::<Vec<_>>() {
        all[i as usize] = made;
    }
    all
}

struct Node {
    bounds: Aabb,
    /// Places in the order.
    points: Range<usize>,
    /// The first child, the second follows; 0 for a leaf.
    children: usize,
    /// The smallest node round this one with enough points.
    enough: usize,
}

struct Tree {
    /// From the root on.
    nodes: Vec<Node>,
    /// Indices of the points by leaf.
    order: Vec<u32>,
    place: Vec<Point>,
    count: usize,
}

/// What the points of a leaf share.
#[derive(Default)]
struct Search {
    /// Leaves whose points may be near, by node.
    leaves: Vec<usize>,
    /// Squared distance, of each of the leaf's points, within which its nearest are.
    reach: Vec<f64>,
    /// Places of enough points, where those of the leaf and these are all equal.
    equal: Option<Range<usize>>,
    /// The leaf's first point.
    first: usize,
    found: Vec<(f64, u32)>,
    near: Vec<f64>,
}

impl Tree {
    fn new(points: &[Point], count: usize) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let mut nodes = vec![Node { bounds: bounds(points, &order), points: 0..points.len(), children: 0, enough: 0 }];
        let mut at = 0;
        while at < nodes.len() {
            let Range { start, end } = nodes[at].points;
            if end - start > LEAF {
                let axis = nodes[at].bounds.size().imax();
                let middle = (end - start) / 2;
                let by_place =
                    |a: &u32, b: &u32| points[*a as usize][axis].total_cmp(&points[*b as usize][axis]).then(a.cmp(b));
                order[start..end].select_nth_unstable_by(middle, by_place);
                nodes[at].children = nodes.len();
                for part in [start..start + middle, start + middle..end] {
                    let bounds = bounds(points, &order[part.clone()]);
                    let enough = if part.len() >= 2 * count { nodes.len() } else { nodes[at].enough };
                    nodes.push(Node { bounds, points: part, children: 0, enough });
                }
            }
            at += 1;
        }
        let place = order.iter().map(|&i| points[i as usize]).collect();
        Self { nodes, order, place, count: count.min(points.len()) }
    }

    /// Prepares the search for a leaf's points.
    fn gather(&self, leaf: usize, search: &mut Search) {
        let node = &self.nodes[leaf];
        let some = self.nodes[node.enough].points.clone();
        search.first = node.points.start;
        for p in &self.place[node.points.clone()] {
            search.near.clear();
            search.near.extend(self.place[some.clone()].iter().map(|q| (q - p).norm_squared()));
            let (_, reach, _) = search.near.select_nth_unstable_by(self.count - 1, f64::total_cmp);
            search.reach.push(*reach);
        }
        let furthest = search.reach.iter().copied().fold(0.0, f64::max);
        if furthest == 0.0 {
            // As many equal points as are asked for: the rest of them say nothing more.
            search.equal = Some(some);
            return;
        }
        let mut open = vec![0];
        while let Some(at) = open.pop() {
            let other = &self.nodes[at];
            if gap(&node.bounds, &other.bounds) > furthest {
                continue;
            }
            match other.children {
                0 => search.leaves.push(at),
                first => open.extend([first + 1, first]),
            }
        }
    }

    /// The nearest of the point at a place of the order.
    fn nearest<'a>(&self, at: usize, search: &'a mut Search) -> &'a [(f64, u32)] {
        let (p, reach) = (self.place[at], search.reach[at - search.first]);
        let found = &mut search.found;
        found.clear();
        let mut take = |span: Range<usize>| {
            for (q, &i) in self.place[span.clone()].iter().zip(&self.order[span]) {
                let squared = (q - p).norm_squared();
                if squared <= reach {
                    found.push((squared, i));
                }
            }
        };
        if let Some(span) = &search.equal {
            take(span.clone());
        } else {
            // What the leaf's farthest point needs, this one may not.
            let own = Aabb { min: p, max: p };
            let near = search.leaves.iter().map(|&n| &self.nodes[n]).filter(|n| gap(&own, &n.bounds) <= reach);
            near.for_each(|n| take(n.points.clone()));
        }
        if found.len() > self.count {
            found.select_nth_unstable_by(self.count - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        }
        &found[..found.len().min(self.count)]
    }
}

fn bounds(points: &[Point], some: &[u32]) -> Aabb {
    let first = points[some[0] as usize];
    some.iter().fold(Aabb { min: first, max: first }, |b, &i| {
        let p = &points[i as usize];
        Aabb { min: b.min.inf(p), max: b.max.sup(p) }
    })
}

/// Squared distance between two boxes.
fn gap(a: &Aabb, b: &Aabb) -> f64 {
    (b.min - a.max).sup(&(a.min - b.max)).sup(&Vector::zeros()).norm_squared()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn the_nearest_are_those_of_a_scan_whatever_the_spread_and_with_ties() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let mut uniform = || rng.random_range(-1.0..1.0_f64);
        let scattered: Vec<Point> =
            (0..500).map(|_| Point::new(uniform(), uniform().powi(5), 0.01 * uniform())).collect();
        let lattice: Vec<Point> =
            (0..343).map(|i| Point::new(f64::from(i % 7), f64::from(i / 7 % 7), f64::from(i / 49))).collect();
        let same = vec![Point::new(1.0, 2.0, 3.0); 100];
        for points in [scattered, lattice, same, vec![Point::origin()]] {
            for count in [1, 8, 31, 600] {
                let found = map_nearest(&points, count, |_, near| {
                    let mut near = near.to_vec();
                    near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                    near
                });
                let heap = points.len() == 100;
                for (p, found) in points.iter().zip(found) {
                    if heap {
                        assert!(found.len() == count.min(100) && found.iter().all(|f| f.0 == 0.0));
                        continue;
                    }
                    let mut all: Vec<(f64, u32)> =
                        points.iter().enumerate().map(|(i, q)| ((q - p).norm_squared(), i as u32)).collect();
                    all.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                    all.truncate(count);
                    assert_eq!(found, all);
                }
            }
        }
        assert!(map_nearest(&[], 3, |_, _| 0).is_empty());
    }

    #[test]
    fn a_heap_of_equal_points_and_a_point_that_is_none_are_survived() {
        let mut points = vec![Point::origin(); 300_000];
        points[7] = Point::new(1.0, 0.0, 0.0);
        let far = map_nearest(&points, 3, |_, near| near.iter().map(|n| n.0).sum::<f64>());
        assert_eq!(far.iter().filter(|&&d| d > 0.0).count(), 1);
        let odd = [Point::new(f64::NAN, 0.0, 0.0), Point::origin(), Point::new(f64::INFINITY, 0.0, 0.0)];
        assert_eq!(map_nearest(&odd, 2, |_, near| near.len()).len(), 3);
    }
}
