use super::gather::{INDEX_REACH, INDEX_SPACING, felt_samples};
use super::{Evidence, EvidenceParams, average_in_voxels};
use crate::geometry::Aabb;
use crate::tactile::Patch;
use nalgebra::Matrix6;

impl Evidence {
    /// Adds one more touch to what is known, without gathering the rest again. Returns how many of `samples` and of `measured` there were
    /// before: what follows is new.
    ///
    /// The same samples, in the same order, as if the touch had been gathered last. [`super::FreeSpace::signed_distance`] does not learn of the pad; the
    /// other clearances do.
    ///
    /// * `touch` – its number: how many patches there were
    /// * `covariance` – of its pose in the sensor's frame: rotation (radians), then translation (metres)
    pub fn add_touch(
        &mut self,
        patch: &Patch,
        touch: u32,
        covariance: &Matrix6<f64>,
        params: &EvidenceParams,
    ) -> [usize; 2] {
        let before = [self.samples.len(), self.measured.len()];
        let felt = felt_samples(patch, touch, covariance, params);
        self.samples.extend(average_in_voxels(&felt, params.felt_voxel));
        self.measured.extend(felt);
        self.index.insert(&self.samples, before[0], INDEX_SPACING, INDEX_REACH);
        self.free_space.add_pad(patch, covariance);
        if let Some(new) = Aabb::of(self.samples[before[0]..].iter().map(|s| &s.position)) {
            self.bounds = self.bounds.union(&new);
        }
        before
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::testing::{Solid, touch, view};
    use crate::geometry::{Point, Vector};

    #[test]
    fn a_touch_added_later_is_known_as_if_it_had_been_gathered() {
        let solids = [Solid::Box(Point::new(0.0, 0.0, 0.03), Vector::new(0.04, 0.025, 0.03), 0.4)];
        let (frame, visible) = view(&solids, 0.0005);
        let press = |x: f64, y: f64| touch(&solids, Point::new(x, y, 0.03), Point::new(0.0, 0.0, 0.03));
        let patches = [press(-0.2, 0.0), press(0.0, 0.2)];
        let params = EvidenceParams::default();
        let whole = Evidence::gather(&frame, &visible, &patches, &params).expect("seen");
        let mut grown = Evidence::gather(&frame, &visible, &patches[..1], &params).expect("seen");
        let before = grown.add_touch(&patches[1], 1, &Matrix6::zeros(), &params);
        assert!(before[0] < grown.samples.len() && before[1] < grown.measured.len());
        assert_eq!((&grown.samples, &grown.measured), (&whole.samples, &whole.measured));
        let near = patches[1].points.iter().chain(&patches[1].clearance);
        let behind = |p: &Point| patches[1].world_from_sensor * Vector::z() * -1e-3 + p.coords;
        for p in near.map(|p| Point::from(behind(p))) {
            assert_eq!(grown.free_space.clearance_with_pads(&p), whole.free_space.clearance_with_pads(&p));
            assert_eq!(grown.index.nearest(&p).is_some(), whole.index.nearest(&p).is_some());
        }
    }
}
