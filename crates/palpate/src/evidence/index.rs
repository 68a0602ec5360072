use super::Sample;
use crate::geometry::{Aabb, Point, Vector, VoxelGrid};
use rayon::prelude::*;

/// No sample is near.
const NONE: u32 = u32::MAX;
/// A second sample is kept where its normal differs from the first's by more than this cosine.
const OTHER_SIDE: f64 = 0.35;

/// Nearest measured sample with an agreeing normal, by one look-up.
///
/// A grid holds, per node, the sample nearest to the node and the nearest one that faces another way: on both sides of a thin wall and along
/// an edge the right surface is found. Exact to the grid's spacing, so compare along the found sample's normal, not by raw distance.
#[derive(Debug, Clone)]
pub struct SampleIndex {
    nodes: VoxelGrid<[u32; 2]>,
}

/// A sample found near a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// Index of the sample.
    pub sample: usize,
    /// Distance of the query from the sample's tangent plane, metres, ≥ 0.
    pub plane_offset: f64,
    /// Distance along the tangent plane, metres.
    pub tangential: f64,
    /// Cosine between the two normals.
    pub agreement: f64,
}

impl SampleIndex {
    /// Indexes the samples for queries up to `reach` metres from them.
    ///
    /// * `spacing` – of the grid, metres; enlarged where the grid would exceed 160 nodes along a side.
    pub fn new(samples: &[Sample], spacing: f64, reach: f64) -> Self {
        let Some(bounds) = Aabb::of(samples.iter().map(|s| &s.position)) else {
            return Self { nodes: VoxelGrid::filled(Point::origin(), spacing, [1; 3], [NONE; 2]) };
        };
        let bounds = bounds.inflated(reach);
        let spacing = spacing.max(bounds.size().max() / 160.0);
        let mut nodes = VoxelGrid::covering(&bounds, spacing, [NONE; 2]);
        let ([nx, ny, _], origin) = (nodes.dims(), nodes.origin());
        let normals: Vec<Vector> = samples.iter().map(|s| s.normal).collect();
        let stack = Stack::new(samples.iter().map(|s| (s.position - origin) / spacing));
        let radius = (reach / spacing) as f32;
        nodes.as_mut_slice().par_chunks_mut(nx * ny).enumerate().for_each(|(k, slab)| {
            let mut best = vec![radius * radius; slab.len()];
            stack.splat(k, [nx, ny], radius, &mut best, |node, i| {
                slab[node][0] = i;
                true
            });
            best.fill(radius * radius);
            stack.splat(k, [nx, ny], radius, &mut best, |node, i| {
                let first = slab[node][0];
                let other = first != NONE && normals[i as usize].dot(&normals[first as usize]) < OTHER_SIDE;
                if other {
                    slab[node][1] = i;
                }
                other
            });
        });
        Self { nodes }
    }

    /// Adds `samples[from..]` to an index of `samples[..from]`, for queries up to `reach` metres from them.
    ///
    /// The second sample of a node is the nearest known one that faces another way than the first: where a new sample displaces the first, one
    /// that the node did not hold is not found again. O(new samples · reach³ / spacing³); samples beyond the grid cost a new index.
    pub fn insert(&mut self, samples: &[Sample], from: usize, spacing: f64, reach: f64) {
        if samples[from..].iter().any(|s| self.nodes.nearest(&s.position).is_none()) {
            *self = Self::new(samples, spacing, reach);
            return;
        }
        let (dims, h) = (self.nodes.dims(), self.nodes.spacing());
        for i in from..samples.len() {
            let c = (samples[i].position - self.nodes.origin()) / h;
            let range = |a: usize| {
                let (low, high) = ((c[a] - reach / h).ceil().max(0.0), (c[a] + reach / h).floor().max(-1.0) + 1.0);
                low as usize..(high as usize).min(dims[a])
            };
            for k in range(2) {
                for j in range(1) {
                    for x in range(0) {
                        let (node, at) = (self.nodes.index(x, j, k), self.nodes.position(x, j, k));
                        if (samples[i].position - at).norm_squared() < reach * reach {
                            let slot = &mut self.nodes.as_mut_slice()[node];
                            *slot = with_sample(*slot, i, samples, &at);
                        }
                    }
                }
            }
        }
    }

    /// The sample nearest to `p` among those whose normal has a cosine above `agreement` with `normal`, as far as the grid knows.
    ///
    /// `samples` must be the ones the index was built from.
    #[inline]
    pub fn nearest_agreeing(&self, samples: &[Sample], p: &Point, normal: &Vector, agreement: f64) -> Option<Match> {
        agreeing(samples, self.nodes.as_slice()[self.nodes.nearest(p)?], p, normal, agreement)
    }

    /// [`Self::nearest_agreeing`] of each of `points`. All nodes are found before the first is read, so that the processor fetches them
    /// together: each is far from the last in memory.
    pub(crate) fn all_nearest_agreeing<const N: usize>(
        &self,
        samples: &[Sample],
        points: &[Point; N],
        normals: &[Vector; N],
        agreement: f64,
    ) -> [Option<Match>; N] {
        let (mut nodes, mut near, mut found) = ([0; N], [[NONE; 2]; N], [None; N]);
        for k in 0..N {
            nodes[k] = self.nodes.nearest(&points[k]).unwrap_or(usize::MAX);
        }
        for k in 0..N {
            near[k] = self.nodes.as_slice().get(nodes[k]).copied().unwrap_or([NONE; 2]);
        }
        for k in 0..N {
            found[k] = agreeing(samples, near[k], &points[k], &normals[k], agreement);
        }
        found
    }

    /// Whether any sample is near `p`, whatever its normal: its index.
    #[inline]
    pub fn nearest(&self, p: &Point) -> Option<usize> {
        let first = self.nodes.as_slice()[self.nodes.nearest(p)?][0];
        (first != NONE).then_some(first as usize)
    }
}

/// The first of the samples `near` whose normal agrees.
#[inline]
fn agreeing(samples: &[Sample], near: [u32; 2], p: &Point, normal: &Vector, agreement: f64) -> Option<Match> {
    near.into_iter().take_while(|&i| i != NONE).find_map(|i| {
        let s = &samples[i as usize];
        let cosine = normal.dot(&s.normal);
        if cosine <= agreement {
            return None;
        }
        let d = p - s.position;
        let along = d.dot(&s.normal);
        let tangential = (d.norm_squared() - along * along).max(0.0).sqrt();
        Some(Match { sample: i as usize, plane_offset: along.abs(), tangential, agreement: cosine })
    })
}

/// What a node at `at` holds once sample `i` is known.
fn with_sample([first, second]: [u32; 2], i: usize, samples: &[Sample], at: &Point) -> [u32; 2] {
    let distance = |s: u32| if s == NONE { f64::INFINITY } else { (samples[s as usize].position - at).norm_squared() };
    let faces_away = |a: u32, b: u32| {
        a != NONE && b != NONE && samples[a as usize].normal.dot(&samples[b as usize].normal) < OTHER_SIDE
    };
    let new = i as u32;
    if distance(new) < distance(first) {
        [new, [first, second].into_iter().find(|&s| faces_away(s, new)).unwrap_or(NONE)]
    } else if faces_away(new, first) && distance(new) < distance(second) {
        [first, new]
    } else {
        [first, second]
    }
}

/// Positions in cells, from the lowest slab to the highest.
struct Stack {
    /// Position and number of the sample.
    rising: Vec<([f32; 3], u32)>,
}

impl Stack {
    fn new(positions: impl Iterator<Item = Vector>) -> Self {
        let mut rising: Vec<([f32; 3], u32)> =
            positions.enumerate().map(|(i, c)| ([c.x as f32, c.y as f32, c.z as f32], i as u32)).collect();
        rising.sort_unstable_by(|a, b| a.0[2].total_cmp(&b.0[2]).then(a.1.cmp(&b.1)));
        Self { rising }
    }

    /// Offers every sample to the nodes of slab `k` within `radius` cells; `take` says whether it is accepted where it is the nearest so far.
    /// Ties go to the lower one, then to the smaller number.
    fn splat(
        &self,
        k: usize,
        [nx, ny]: [usize; 2],
        radius: f32,
        best: &mut [f32],
        mut take: impl FnMut(usize, u32) -> bool,
    ) {
        let level = k as f32;
        let from = self.rising.partition_point(|s| s.0[2] <= level - radius);
        let to = self.rising.partition_point(|s| s.0[2] < level + radius);
        for &([cx, cy, cz], i) in &self.rising[from..to] {
            let dz2 = (level - cz) * (level - cz);
            let flat = (radius * radius - dz2).max(0.0).sqrt();
            for j in within(cy, flat, ny) {
                let dy = j as f32 - cy;
                let beside = dy * dy + dz2;
                let half = (radius * radius - beside).max(0.0).sqrt();
                for x in within(cx, half, nx) {
                    let dx = x as f32 - cx;
                    let (squared, node) = (dx * dx + beside, j * nx + x);
                    if squared < best[node] && take(node, i) {
                        best[node] = squared;
                    }
                }
            }
        }
    }
}

/// The whole numbers below `count` within `half` of `center`. Conversions round towards zero and saturate: no call of `floor`.
fn within(center: f32, half: f32, count: usize) -> std::ops::Range<usize> {
    let (low, high) = (center - half, center + half);
    let first = low as usize + usize::from(low > (low as usize) as f32);
    let past = if high < 0.0 { 0 } else { high as usize + 1 };
    first..past.min(count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Provenance;

    fn sample(x: f64, z: f64, normal: Vector) -> Sample {
        Sample { position: Point::new(x, 0.0, z), normal, sigma: 1e-4, provenance: Provenance::Seen }
    }

    #[test]
    fn both_sides_of_a_thin_wall_are_found() {
        let samples: Vec<Sample> = (0..10)
            .flat_map(|i| {
                let x = f64::from(i) * 0.002;
                [sample(x, 0.0, -Vector::z()), sample(x, 0.001, Vector::z())]
            })
            .collect();
        let index = SampleIndex::new(&samples, 0.002, 0.012);
        let query = Point::new(0.0081, 0.0003, 0.0012);
        let up = index.nearest_agreeing(&samples, &query, &Vector::z(), 0.5).expect("the upper side is near");
        assert_eq!(up.sample, 9);
        assert!((up.plane_offset - 0.0002).abs() < 1e-12 && up.agreement == 1.0);
        let down = index.nearest_agreeing(&samples, &query, &-Vector::z(), 0.5).expect("the lower side is near");
        assert_eq!(down.sample, 8);
        assert!((down.plane_offset - 0.0012).abs() < 1e-12);
        assert!(index.nearest_agreeing(&samples, &query, &Vector::x(), 0.5).is_none());
        assert!(index.nearest(&Point::new(0.0, 0.0, 0.05)).is_none(), "out of reach");
    }

    #[test]
    fn samples_added_later_are_found_as_if_they_had_been_there() {
        let wall = |i: i32, up: f64| sample(f64::from(i) * 0.003, 0.0005 * up, Vector::z() * up);
        let samples: Vec<Sample> = (0..20).map(|i| wall(i, 1.0)).chain((5..15).map(|i| wall(i, -1.0))).collect();
        let (whole, mut grown) =
            (SampleIndex::new(&samples, 0.002, 0.012), SampleIndex::new(&samples[..20], 0.002, 0.012));
        grown.insert(&samples, 20, 0.002, 0.012);
        for i in 0..60 {
            let p = Point::new(f64::from(i) * 0.001, 0.001, 0.002);
            for up in [1.0, -1.0] {
                let found = |index: &SampleIndex| index.nearest_agreeing(&samples, &p, &(Vector::z() * up), 0.5);
                assert_eq!(found(&grown), found(&whole), "at {p}, facing {up}");
            }
        }
        let far = [samples, vec![sample(0.3, 0.0, Vector::z())]].concat();
        grown.insert(&far, 30, 0.002, 0.012);
        assert_eq!(grown.nearest(&Point::new(0.3, 0.0, 0.0)), Some(30), "beyond the old grid");
    }

    #[test]
    fn nodes_hold_the_nearest_sample_and_the_nearest_other_side() {
        // An L of two thin walls, seen from all sides, and a ball beside it.
        let wall = |i: i32, j: i32, side: f64| {
            let (u, v) = (f64::from(i) * 2.3e-3, f64::from(j) * 2.1e-3);
            [(Point::new(u, v, side * 7e-4), Vector::z() * side), (Point::new(side * 7e-4, v, u), Vector::x() * side)]
        };
        let walls = (0..18).flat_map(|i| (0..9).flat_map(move |j| [wall(i, j, 1.0), wall(i, j, -1.0)].concat()));
        let ball = (0..200).map(|i| {
            let (z, a) = (1.0 - (2 * i + 1) as f64 / 200.0, f64::from(i) * 2.4);
            let n = Vector::new((1.0 - z * z).sqrt() * a.cos(), (1.0 - z * z).sqrt() * a.sin(), z);
            (Point::new(0.03, 0.01, 0.03) + n * 0.009, n)
        });
        let sample = |(position, normal)| Sample { position, normal, sigma: 1e-4, provenance: Provenance::Seen };
        let samples: Vec<Sample> = walls.chain(ball).map(sample).collect();
        let (spacing, reach) = (2e-3, 9e-3);
        let index = SampleIndex::new(&samples, spacing, reach);
        let [nx, ny, nz] = index.nodes.dims();
        let mut seconds = 0;
        for (x, y, z) in (0..nx).flat_map(|x| (0..ny).flat_map(move |y| (0..nz).map(move |z| (x, y, z)))) {
            let (node, at) = (index.nodes.index(x, y, z), index.nodes.position(x, y, z));
            let distance = |i: u32| (samples[i as usize].position - at).norm();
            let nearest = |wanted: &dyn Fn(&Sample) -> bool| {
                let some = samples.iter().filter(|s| wanted(s)).map(|s| (s.position - at).norm());
                some.min_by(f64::total_cmp).filter(|d| *d < reach)
            };
            let [first, second] = index.nodes.as_slice()[node];
            let near = |found: u32, expected: Option<f64>| match expected {
                // On the rim rounding decides.
                None => found == NONE || distance(found) > reach - 1e-6,
                Some(d) => (found == NONE && d > reach - 1e-6) || (found != NONE && distance(found) < d + 1e-6),
            };
            assert!(near(first, nearest(&|_| true)), "node {at}");
            if first == NONE {
                continue;
            }
            let normal = samples[first as usize].normal;
            let other = nearest(&|s| s.normal.dot(&normal) < OTHER_SIDE);
            assert!(near(second, other), "the other side at {at}: {other:?}");
            seconds += usize::from(second != NONE);
        }
        assert!(seconds > 500, "{seconds} nodes know another side");
    }

    #[test]
    fn no_samples_find_nothing() {
        assert!(SampleIndex::new(&[], 0.002, 0.012).nearest(&Point::origin()).is_none());
    }
}
