use super::pose::pose_sigma_at;
use super::rays::UNKNOWN;
use crate::geometry::{Aabb, Isometry, Point, Raster, Vector};
use crate::tactile::Patch;
use nalgebra::Matrix6;

/// The free space that untouched gel proves: a layer on the sensor's side of the gel surface.
pub(super) struct PadClearance {
    pads: Vec<Pad>,
    bounds: Option<Aabb>,
    thickness: f64,
}

/// One touch's untouched gel as a height map in the sensor frame, NaN where the gel touches or there is no gel.
struct Pad {
    sensor_from_world: Isometry,
    corner: [f64; 2],
    gel: Raster<f32>,
    center: Point,
    squared_radius: f64,
    /// How far behind the gel nothing is claimed, metres.
    margin: f64,
}

/// Cell of the height map, metres: coarser than the spacing of lifted clearance points, so that it has no holes.
const CELL: f64 = 0.002;
/// The gel surface itself is uncertain by its own noise, metres.
const MARGIN: f64 = 0.0003;
/// No pad is wider than this, metres; a patch that claims so holds a stray point.
const WIDEST: f64 = 0.1;

impl PadClearance {
    pub(super) fn new(patches: &[Patch], covariances: &[Matrix6<f64>], thickness: f64) -> Self {
        let mut all = Self { pads: Vec::new(), bounds: None, thickness };
        for (patch, covariance) in patches.iter().zip(covariances) {
            all.add(patch, covariance);
        }
        all
    }

    pub(super) fn add(&mut self, patch: &Patch, covariance: &Matrix6<f64>) {
        let Some(pad) = Pad::new(patch, covariance, self.thickness) else { return };
        let bounds = Aabb { min: pad.center, max: pad.center }.inflated(pad.squared_radius.sqrt());
        self.bounds = Some(self.bounds.map_or(bounds, |b| b.union(&bounds)));
        self.pads.push(pad);
    }

    /// How far behind the gel surface `p` lies, metres, at most the layer's thickness; ≤ 0 outside every layer.
    #[inline]
    pub(super) fn clearance(&self, p: &Point) -> f64 {
        if !self.bounds.is_some_and(|b| b.contains(p)) {
            return UNKNOWN;
        }
        let near = self.pads.iter().filter(|pad| (p - pad.center).norm_squared() < pad.squared_radius);
        near.map(|pad| pad.clearance(p, self.thickness)).fold(UNKNOWN, f64::max)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.pads.is_empty()
    }
}

impl Pad {
    fn new(patch: &Patch, covariance: &Matrix6<f64>, thickness: f64) -> Option<Self> {
        let sensor_from_world = patch.world_from_sensor.inverse();
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
        Some(Self {
            margin,
            sensor_from_world,
            corner: [bounds.min.x, bounds.min.y],
            gel,
            center: patch.world_from_sensor * bounds.center(),
            squared_radius: (0.5 * bounds.diagonal() + thickness).powi(2),
        })
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
    fn nothing_is_claimed_where_the_object_dents_the_gel() {
        let pad = pad(vec![Point::new(0.005, 0.005, -0.001)]);
        assert!(pad.clearance(&Point::new(0.0055, 0.0055, -0.002)) <= 0.0);
        assert!(pad.clearance(&Point::new(0.001, 0.001, -0.002)) > 0.0);
    }
}
