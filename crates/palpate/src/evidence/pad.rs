use super::pose::pose_sigma_at;
use super::rays::UNKNOWN;
use crate::geometry::{Aabb, Point, Raster, Vector, VoxelGrid};
use crate::tactile::Patch;
use nalgebra::{IsometryMatrix3, Matrix6};

/// The free space that untouched gel proves: a layer on the sensor's side of the gel surface.
pub(super) struct PadClearance {
    pads: Vec<Pad>,
    near: Option<PadIndex>,
    thickness: f64,
}

/// The pads whose layers reach into each cell of a grid round all of them.
struct PadIndex {
    /// Range of [`Self::pads`] of each cell.
    cells: VoxelGrid<[u32; 2]>,
    pads: Vec<u32>,
}

/// One touch's untouched gel as a height map in the sensor frame, NaN where the gel touches or there is no gel.
struct Pad {
    sensor_from_world: IsometryMatrix3<f64>,
    corner: [f64; 2],
    gel: Raster<f32>,
    /// What holds the layer, in the sensor frame.
    layer: Aabb,
    /// A cube round the ball round it, in the world.
    bounds: Aabb,
    /// How far behind the gel nothing is claimed, metres.
    margin: f64,
}

/// Cell of the height map, metres: coarser than the spacing of lifted clearance points, so that it has no holes.
const CELL: f64 = 0.002;
/// The gel surface itself is uncertain by its own noise, metres.
const MARGIN: f64 = 0.0003;
/// Cell of the index of pads, metres; larger where the pads lie farther apart than this many cells.
const INDEX_CELL: f64 = 0.003;
const INDEX_CELLS: f64 = 96.0;
/// No pad is wider than this, metres; a patch that claims so holds a stray point.
const WIDEST: f64 = 0.1;

impl PadClearance {
    pub(super) fn new(patches: &[Patch], covariances: &[Matrix6<f64>], thickness: f64) -> Self {
        let pads: Vec<Pad> = patches.iter().zip(covariances).filter_map(|(p, c)| Pad::new(p, c, thickness)).collect();
        let near = PadIndex::new(&pads);
        Self { pads, near, thickness }
    }

    /// Adds one more; the index of all is made anew.
    pub(super) fn add(&mut self, patch: &Patch, covariance: &Matrix6<f64>) {
        let Some(pad) = Pad::new(patch, covariance, self.thickness) else { return };
        self.pads.push(pad);
        self.near = PadIndex::new(&self.pads);
    }

    /// How far behind the gel surface `p` lies, metres, at most the layer's thickness; ≤ 0 outside every layer.
    #[inline]
    pub(super) fn clearance(&self, p: &Point) -> f64 {
        self.near.as_ref().map_or(UNKNOWN, |near| self.deepest(p, near.at(near.cells.nearest(p))))
    }

    /// [`Self::clearance`] of each of `points`. All cells are found before the first is read, so that the processor fetches them together.
    pub(super) fn clearances<const N: usize>(&self, points: &[Point; N]) -> [f64; N] {
        let mut clearances = [UNKNOWN; N];
        let Some(near) = &self.near else { return clearances };
        let (mut cells, mut pads) = ([None; N], [&[][..]; N]);
        for k in 0..N {
            cells[k] = near.cells.nearest(&points[k]);
        }
        for k in 0..N {
            pads[k] = near.at(cells[k]);
        }
        for k in 0..N {
            clearances[k] = self.deepest(&points[k], pads[k]);
        }
        clearances
    }

    #[inline]
    fn deepest(&self, p: &Point, pads: &[u32]) -> f64 {
        pads.iter().map(|&i| self.pads[i as usize].clearance(p, self.thickness)).fold(UNKNOWN, f64::max)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.pads.is_empty()
    }
}

impl PadIndex {
    /// O(pads · cells of a pad); `None` without pads.
    fn new(pads: &[Pad]) -> Option<Self> {
        let bounds = pads.iter().map(|pad| pad.bounds).reduce(|a, b| a.union(&b))?;
        let spacing = INDEX_CELL.max(bounds.size().max() / INDEX_CELLS);
        let mut cells = VoxelGrid::covering(&bounds, spacing, [0; 2]);
        let mut reached: Vec<(usize, u32)> =
            pads.iter().zip(0..).flat_map(|(pad, i)| pad.cells(&cells).into_iter().map(move |c| (c, i))).collect();
        reached.sort_unstable();
        for (k, &(cell, _)) in reached.iter().enumerate() {
            let range = &mut cells.as_mut_slice()[cell];
            *range = [if range[1] == 0 { k as u32 } else { range[0] }, k as u32 + 1];
        }
        Some(Self { cells, pads: reached.into_iter().map(|r| r.1).collect() })
    }

    #[inline]
    fn at(&self, cell: Option<usize>) -> &[u32] {
        let [from, to] = cell.map_or([0; 2], |cell| self.cells.as_slice()[cell]);
        &self.pads[from as usize..to as usize]
    }
}

impl Pad {
    fn new(patch: &Patch, covariance: &Matrix6<f64>, thickness: f64) -> Option<Self> {
        let sensor_from_world: IsometryMatrix3<f64> = nalgebra::convert(patch.world_from_sensor.inverse());
        let finite = patch.clearance.iter().filter(|p| p.iter().all(|c| c.is_finite()));
        let local: Vec<Point> = finite.map(|p| sensor_from_world * p).collect();
        let bounds = Aabb::of(&local).filter(|b| b.size().max() < WIDEST)?;
        let cells = |length: f64| (length / CELL).floor() as usize + 1;
        let mut gel = Raster::filled(cells(bounds.size().y), cells(bounds.size().x), f32::NAN);
        for p in &local {
            let (row, col) = (((p.y - bounds.min.y) / CELL) as usize, ((p.x - bounds.min.x) / CELL) as usize);
            // The farthest point of a cell from the object: what is behind it is behind all of the cell's gel.
            gel[(row, col)] = gel[(row, col)].min(p.z as f32);
        }
        // Where the object dents the gel of a cell, nothing is claimed for the whole cell.
        for p in &patch.points {
            let p = sensor_from_world * p;
            let (x, y) = ((p.x - bounds.min.x) / CELL, (p.y - bounds.min.y) / CELL);
            if x >= 0.0 && y >= 0.0 && gel.get(y as usize, x as usize).is_some() {
                gel[(y as usize, x as usize)] = f32::NAN;
            }
        }
        // The gel is where its pose says only to within the pose's σ, most at the rim.
        let press = patch.world_from_sensor * Vector::z();
        let rim = [bounds.min, bounds.max].map(|p| patch.world_from_sensor * p);
        let sigma = rim.iter().map(|p| pose_sigma_at(&patch.world_from_sensor, covariance, p, &press));
        let margin = MARGIN + 2.0 * sigma.fold(0.0, f64::max);
        let cell = Vector::new(CELL, CELL, 0.0);
        let layer = Aabb { min: bounds.min - Vector::z() * thickness, max: bounds.max + cell };
        let center = patch.world_from_sensor * layer.center();
        Some(Self {
            margin,
            sensor_from_world,
            corner: [bounds.min.x, bounds.min.y],
            gel,
            layer,
            bounds: Aabb { min: center, max: center }.inflated(0.5 * layer.diagonal()),
        })
    }

    /// The nodes of a grid that stand for points of the layer, and some beside it.
    fn cells<T>(&self, grid: &VoxelGrid<T>) -> Vec<usize> {
        // A node stands for the points nearest to it, half a cell's diagonal away at most.
        let half_diagonal = 0.5 * 3.0_f64.sqrt() * grid.spacing();
        let (dims, layer) = (grid.dims(), self.layer.inflated(half_diagonal));
        let (low, high) = (grid.coordinates(&self.bounds.min), grid.coordinates(&self.bounds.max));
        let range =
            |a: usize| (low[a] - 0.5).ceil().max(0.0) as usize..((high[a] + 0.5).floor() as usize + 1).min(dims[a]);
        let nodes = range(2).flat_map(|k| range(1).flat_map(move |j| range(0).map(move |i| (i, j, k))));
        let reached = nodes.filter(|&(i, j, k)| layer.contains(&(self.sensor_from_world * grid.position(i, j, k))));
        reached.map(|(i, j, k)| grid.index(i, j, k)).collect()
    }

    fn clearance(&self, p: &Point, thickness: f64) -> f64 {
        let p = self.sensor_from_world * p;
        let (x, y) = ((p.x - self.corner[0]) / CELL, (p.y - self.corner[1]) / CELL);
        if x < 0.0 || y < 0.0 {
            return UNKNOWN;
        }
        let Some(gel) = self.gel.get(y as usize, x as usize).filter(|g| g.is_finite()) else { return UNKNOWN };
        let behind = f64::from(*gel) - p.z;
        if behind > thickness { UNKNOWN } else { (behind - self.margin).max(UNKNOWN) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Isometry;

    /// A 10 × 10 mm pad that presses along +z at z = 0 and touches nothing.
    fn pad(points: Vec<Point>) -> PadClearance {
        let clearance = (0..441).map(|i| Point::new(f64::from(i % 21) * 5e-4, f64::from(i / 21) * 5e-4, 0.0)).collect();
        let patch = Patch { points, normals: vec![], clearance, world_from_sensor: Isometry::identity() };
        PadClearance::new(&[patch], &[Matrix6::zeros()], 0.003)
    }

    #[test]
    fn the_sensor_side_is_free_and_the_object_side_is_not() {
        let pad = pad(vec![]);
        let at = |x: f64, z: f64| pad.clearance(&Point::new(x, 0.005, z));
        assert!((at(0.005, -0.002) - 0.0017).abs() < 1e-9, "2 mm behind the gel less the margin");
        assert!(at(0.005, 0.001) <= 0.0, "in front of the gel nothing is known");
        assert!(at(0.005, -0.004) <= 0.0, "beyond the layer nothing is claimed");
        assert!(at(0.013, -0.002) <= 0.0, "beside the pad nothing is known");
    }

    #[test]
    fn of_many_pads_those_near_are_asked() {
        let gel: Vec<Point> =
            (0..441).map(|i| Point::new(f64::from(i % 21) * 5e-4, f64::from(i / 21) * 5e-4, 0.0)).collect();
        // Side by side, and so far apart that the cells of the index grow.
        for apart in [1.0, 12.0] {
            let at = |i: i32| {
                let place = Vector::new(f64::from(i % 4) * 0.013, f64::from(i / 4) * 0.017, f64::from(i % 3) * 0.004);
                Isometry::new(place * apart, Vector::new(0.3, 0.2, 0.1) * f64::from(i))
            };
            let patch = |i: i32| Patch {
                points: vec![],
                normals: vec![],
                clearance: gel.iter().map(|p| at(i) * p).collect(),
                world_from_sensor: at(i),
            };
            let patches: Vec<Patch> = (0..16).map(patch).collect();
            let one = |p: &Patch| PadClearance::new(std::slice::from_ref(p), &[Matrix6::zeros()], 0.003);
            let alone: Vec<PadClearance> = patches.iter().map(one).collect();
            let all = PadClearance::new(&patches, &[Matrix6::zeros(); 16], 0.003);
            let mut grown = PadClearance::new(&patches[..9], &[Matrix6::zeros(); 9], 0.003);
            patches[9..].iter().for_each(|p| grown.add(p, &Matrix6::zeros()));
            let mut claims = 0;
            for i in 0..20_000_i32 {
                let part = |n: i32| f64::from((i.wrapping_mul(n) >> 3).rem_euclid(997)) / 997.0;
                let beside = |n: i32| part(n) * 0.016 - 0.003;
                let p = at(i % 16) * Point::new(beside(7919), beside(104_729), part(1_299_709) * 0.008 - 0.006);
                let expected = alone.iter().map(|pad| pad.clearance(&p)).fold(0.0, f64::max);
                assert_eq!((all.clearance(&p).max(0.0), grown.clearance(&p).max(0.0)), (expected, expected), "at {p}");
                claims += usize::from(expected > 0.0);
            }
            assert!((1000..15_000).contains(&claims), "{claims} places are free");
        }
    }

    #[test]
    fn nothing_is_claimed_where_the_object_dents_the_gel() {
        let pad = pad(vec![Point::new(0.005, 0.005, -0.001)]);
        assert!(pad.clearance(&Point::new(0.0055, 0.0055, -0.002)) <= 0.0);
        assert!(pad.clearance(&Point::new(0.001, 0.001, -0.002)) > 0.0);
    }
}
