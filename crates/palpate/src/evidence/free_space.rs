use super::EvidenceParams;
use super::grid::CarvedGrid;
use super::pad::PadClearance;
use super::rays::{Rays, UNKNOWN};
use super::samples::Sample;
use crate::camera::{Frame, Visible};
use crate::geometry::{Aabb, Plane, Point, VoxelGrid};
use crate::tactile::Patch;
use nalgebra::Matrix6;

/// The space that is proven free of the object, at two resolutions.
///
/// [`Self::clearance`] asks the depth image itself: exact to a pixel, made for thin parts. [`Self::signed_distance`] reads a carved grid:
/// a distance that is smooth and knows the nearest unknown space in every direction, but not finer than its cells.
pub struct FreeSpace {
    rays: Rays,
    pad: PadClearance,
    support: Option<Plane>,
    grid: CarvedGrid,
}

impl FreeSpace {
    /// Builds both evaluators. `samples` are the measured ones; the cells they lie in are never free. `covariances` are those of the touch
    /// poses: an uncertain pad proves less.
    pub fn new(
        frame: &Frame,
        visible: &Visible,
        patches: &[Patch],
        covariances: &[Matrix6<f64>],
        samples: &[Sample],
        params: &EvidenceParams,
    ) -> Self {
        let rays = Rays::new(frame, visible, params);
        let pad = PadClearance::new(patches, covariances, params.pad_thickness);
        let support = visible.support;
        let proven = |p: &Point| rays.clearance(p).max(below(support.as_ref(), p));
        let grid = CarvedGrid::new(samples, params, proven, |p| pad.clearance(p), !pad.is_empty());
        Self { rays, pad, support, grid }
    }

    /// Lower bound of the object's distance from `p` (world), metres, by the depth image and the support plane; ≤ 0 where nothing is
    /// proven (the negative value has no meaning). Pads are not asked: see [`Self::pad_clearance`].
    ///
    /// The largest of: distance beside the silhouette; depth in front of the seen surface, along its normal, less
    /// [`EvidenceParams::depth_margin`]; depth below the support plane.
    #[inline]
    pub fn clearance(&self, p: &Point) -> f64 {
        self.rays.clearance(p).max(below(self.support.as_ref(), p))
    }

    /// [`Self::clearance`] of many points at once, which is faster.
    pub(crate) fn clearances<const N: usize>(&self, points: &[Point; N]) -> [f64; N] {
        let mut clearances = self.rays.clearances(points);
        for (clearance, p) in clearances.iter_mut().zip(points) {
            *clearance = clearance.max(below(self.support.as_ref(), p));
        }
        clearances
    }

    /// How deep `p` lies in the layer behind untouched gel, metres; ≤ 0 outside all layers.
    #[inline]
    pub fn pad_clearance(&self, p: &Point) -> f64 {
        self.pad.clearance(p)
    }

    /// [`Self::pad_clearance`] of many points at once, which is faster.
    pub(crate) fn pad_clearances<const N: usize>(&self, points: &[Point; N]) -> [f64; N] {
        self.pad.clearances(points)
    }

    /// Adds the pad of one more touch. The carved grid of [`Self::signed_distance`] stays as it is.
    pub(super) fn add_pad(&mut self, patch: &Patch, covariance: &Matrix6<f64>) {
        self.pad.add(patch, covariance);
    }

    /// The larger of [`Self::clearance`] and [`Self::pad_clearance`].
    #[inline]
    pub fn clearance_with_pads(&self, p: &Point) -> f64 {
        self.clearance(p).max(self.pad_clearance(p))
    }

    /// Signed distance to the boundary of the carved hull (camera, support plane, pads), metres, > 0 in free space: a lower bound of the
    /// object's distance, to about half a cell. Trilinear.
    #[inline]
    pub fn signed_distance(&self, p: &Point) -> f64 {
        self.grid.signed_distance(p)
    }

    /// The carved grid behind [`Self::signed_distance`], metres.
    pub fn grid(&self) -> &VoxelGrid<f32> {
        self.grid.values()
    }

    /// The box of the space that is not proven free, joined with the samples' box.
    pub fn hull_bounds(&self) -> Aabb {
        self.grid.hull_bounds()
    }
}

#[inline]
fn below(support: Option<&Plane>, p: &Point) -> f64 {
    support.map_or(UNKNOWN, |s| -s.signed_distance(p))
}
