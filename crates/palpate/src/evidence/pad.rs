use super::rays::UNKNOWN;
use crate::geometry::{Aabb, KdTree, Point, Vector};
use crate::tactile::Patch;

/// The free space that untouched gel proves: a layer on the sensor's side of the gel surface.
pub(super) struct PadClearance {
    pads: Vec<Pad>,
    thickness: f64,
}

struct Pad {
    tree: KdTree,
    points: Vec<Point>,
    press: Vector,
    /// Half the distance of neighbouring points: beside a point farther than that lies no gel.
    reach: f64,
    bounds: Aabb,
}

/// Gel points are thinned to this spacing, metres: the layer is millimetres thick.
const SPACING: f64 = 0.0008;
/// The gel surface itself is uncertain by its own noise, metres.
const MARGIN: f64 = 0.0003;

impl PadClearance {
    pub(super) fn new(patches: &[Patch], thickness: f64) -> Self {
        let pads = patches
            .iter()
            .filter_map(|patch| {
                let points = thinned(&patch.clearance);
                let bounds = Aabb::of(&points)?.inflated(thickness + 2.0 * SPACING);
                Some(Pad { tree: KdTree::new(&points), points, press: patch.press_direction(), reach: SPACING, bounds })
            })
            .collect();
        Self { pads, thickness }
    }

    /// How far behind the gel surface `p` lies, metres, at most the layer's thickness; ≤ 0 outside every layer.
    pub(super) fn clearance(&self, p: &Point) -> f64 {
        self.pads.iter().map(|pad| pad.clearance(p, self.thickness)).fold(UNKNOWN, f64::max)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.pads.is_empty()
    }
}

impl Pad {
    fn clearance(&self, p: &Point, thickness: f64) -> f64 {
        if !self.bounds.contains(p) {
            return UNKNOWN;
        }
        // Go back along the press to the gel: the nearest gel point of a point behind a slope is not the one it lies behind.
        let mut foot = *p;
        for _ in 0..2 {
            let Some((i, _)) = self.tree.nearest(&foot) else { return UNKNOWN };
            foot += self.press * (self.points[i] - foot).dot(&self.press);
        }
        let behind = (foot - p).dot(&self.press);
        let beside = self.tree.nearest(&foot).map_or(f64::INFINITY, |(_, d)| d);
        if beside > self.reach || behind > thickness { UNKNOWN } else { (behind - MARGIN).max(UNKNOWN) }
    }
}

/// One point per cell of [`SPACING`], the first in order.
fn thinned(points: &[Point]) -> Vec<Point> {
    let mut keyed: Vec<([i64; 3], usize)> = points
        .iter()
        .enumerate()
        .filter(|(_, p)| p.iter().all(|c| c.is_finite()))
        .map(|(i, p)| ([0, 1, 2].map(|a| (p[a] / SPACING).floor() as i64), i))
        .collect();
    keyed.sort_unstable();
    keyed.dedup_by_key(|k| k.0);
    keyed.into_iter().map(|(_, i)| points[i]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Isometry;

    /// A 10 × 10 mm pad that presses along +z at z = 0 and touches nothing.
    fn pad() -> PadClearance {
        let clearance = (0..441).map(|i| Point::new(f64::from(i % 21) * 5e-4, f64::from(i / 21) * 5e-4, 0.0)).collect();
        let patch = Patch { points: vec![], normals: vec![], clearance, world_from_sensor: Isometry::identity() };
        PadClearance::new(&[patch], 0.003)
    }

    #[test]
    fn the_sensor_side_is_free_and_the_object_side_is_not() {
        let pad = pad();
        let at = |x: f64, z: f64| pad.clearance(&Point::new(x, 0.005, z));
        assert!((at(0.005, -0.002) - 0.0017).abs() < 1e-9, "2 mm behind the gel less the margin");
        assert!(at(0.005, 0.001) <= 0.0, "in front of the gel nothing is known");
        assert!(at(0.005, -0.004) <= 0.0, "beyond the layer nothing is claimed");
        assert!(at(0.013, -0.002) <= 0.0, "beside the pad nothing is known");
    }
}
