use super::EvidenceParams;
use crate::camera::{Background, Frame, PinholeCamera, Visible};
use crate::geometry::{Point, Raster, Vector, distance_to_true};
use nalgebra::IsometryMatrix3;

/// What one camera ray proves. 20 bytes, so that a look-up costs one cache line.
#[derive(Debug, Clone, Copy)]
struct Ray {
    /// On the object: the seen surface's tangent plane `normal · x = offset`, camera frame, facing the camera.
    normal: [f32; 3],
    /// Off the object: depth up to which the ray is free, metres; 0 = nothing known, ∞ = the whole ray.
    offset: f32,
    /// Off the object: distance to the silhouette less the margin, pixels, ≥ 0. On the object: −1.
    beside: f32,
}

/// Free space proven by the depth image, pixel by pixel.
///
/// The object is connected, so its projection is too: a pixel where nothing is known can hide part of it only if a chain of such pixels
/// joins it to the mask. All others are free of the object, whatever they show.
#[derive(Debug, Clone)]
pub(super) struct Rays {
    rays: Raster<Ray>,
    camera: PinholeCamera,
    camera_from_world: IsometryMatrix3<f64>,
    focal: f64,
    depth_margin: f64,
}

/// Readings this close to the support plane belong to it, metres.
const SUPPORT_BAND: f64 = 0.005;

impl Rays {
    pub(super) fn new(frame: &Frame, visible: &Visible, params: &EvidenceParams) -> Self {
        let limits = background_limits(frame, visible);
        let hidden = possibly_object(&visible.mask, &limits, visible.border_share > 0.0);
        let distance = distance_to_true(&hidden);
        let pad = usize::from(visible.border_share > 0.0);
        let nearest = nearest_at_jumps(&visible.depth, params.depth_jump as f32);
        let (rows, cols) = visible.depth.shape();
        let rays = Raster::from_fn(rows, cols, |row, col| {
            let depth = nearest[(row, col)];
            if depth.is_finite() {
                if depth < visible.depth[(row, col)] {
                    // The depth is a neighbour's, this pixel's normal says nothing of it: assume an oblique surface.
                    return Ray { normal: [0.0, 0.0, -0.5], offset: -0.5 * depth, beside: -1.0 };
                }
                let n = visible.normals[(row, col)];
                let p = frame.camera.ray(col as f64, row as f64) * f64::from(depth);
                let offset = Vector::from(n.map(f64::from)).dot(&p);
                return Ray { normal: n, offset: offset as f32, beside: -1.0 };
            }
            if hidden[(row + pad, col + pad)] {
                return Ray { normal: [0.0; 3], offset: 0.0, beside: 0.0 };
            }
            let beside = f64::from(distance[(row + pad, col + pad)]) - params.silhouette_margin_px;
            // Off every chain of unknown pixels, even an unknown ray is free of the object.
            let limit = if limits[(row, col)] > 0.0 { limits[(row, col)] } else { f32::INFINITY };
            Ray { normal: [0.0; 3], offset: limit, beside: beside.max(0.0) as f32 }
        });
        Self {
            rays,
            camera: frame.camera,
            camera_from_world: nalgebra::convert(frame.world_from_camera.inverse()),
            focal: frame.camera.fx.max(frame.camera.fy),
            depth_margin: params.depth_margin,
        }
    }

    /// Lower bound of the object's distance from `p` (world), metres; ≤ 0 where no ray proves anything.
    #[inline]
    pub(super) fn clearance(&self, p: &Point) -> f64 {
        let (p, pixel) = self.pixel(p);
        self.clearance_at(&p, pixel)
    }

    /// [`Self::clearance`] of each of `points`. All pixels are found before the first is read, so that the processor fetches them together:
    /// each is far from the last in memory.
    pub(super) fn clearances<const N: usize>(&self, points: &[Point; N]) -> [f64; N] {
        let (mut seen, mut pixels, mut clearances) = ([Point::origin(); N], [0; N], [0.0; N]);
        for k in 0..N {
            (seen[k], pixels[k]) = self.pixel(&points[k]);
        }
        for k in 0..N {
            clearances[k] = self.clearance_at(&seen[k], pixels[k]);
        }
        clearances
    }

    /// `p` in the camera frame, and the number of its pixel; one past the last if there is none.
    #[inline]
    fn pixel(&self, p: &Point) -> (Point, usize) {
        let p = self.camera_from_world * p;
        let (rows, cols) = self.rays.shape();
        let none = (p, rows * cols);
        let Some((u, v)) = self.camera.project(&p) else { return none };
        // Negative values saturate to pixel 0, so the half-pixel border is tested first.
        if !(u > -0.5 && v > -0.5) {
            return none;
        }
        let (row, col) = ((v + 0.5) as usize, (u + 0.5) as usize);
        if row < rows && col < cols { (p, row * cols + col) } else { none }
    }

    #[inline]
    fn clearance_at(&self, p: &Point, pixel: usize) -> f64 {
        let Some(ray) = self.rays.as_slice().get(pixel) else { return UNKNOWN };
        if ray.beside < 0.0 {
            let [x, y, z] = ray.normal.map(f64::from);
            // The plane, not the pixel's depth: exact between pixels, and at a convex edge on the safe side.
            return (x * p.x + y * p.y + z * p.z - f64::from(ray.offset) - self.depth_margin).max(UNKNOWN);
        }
        // The distance from a point to a ray `beside` pixels away; off the optical axis pixels are seen foreshortened.
        let across = f64::from(ray.beside) * p.z * p.z / (self.focal * p.coords.norm());
        across.min(f64::from(ray.offset) - p.z).max(UNKNOWN)
    }
}

/// Says that nothing is proven: a point deep in the unknown.
pub(super) const UNKNOWN: f64 = -1.0;

/// Depth up to which each pixel off the object is free: 0 = unknown, ∞ = the whole ray.
fn background_limits(frame: &Frame, visible: &Visible) -> Raster<f32> {
    let nearest = visible.depth.as_slice().iter().copied().filter(|z| z.is_finite()).fold(f32::INFINITY, f32::min);
    Raster::from_fn(frame.depth.rows(), frame.depth.cols(), |row, col| {
        let z = frame.depth[(row, col)];
        if !z.is_finite() || z <= 0.0 {
            return if frame.background == Background::Absent { f32::INFINITY } else { 0.0 };
        }
        // Nearer than all of the object: something may stand in front of it.
        if z < nearest {
            return 0.0;
        }
        let Some(support) = &visible.support else { return z };
        let p = frame.world_from_camera * Point::from(frame.camera.ray(col as f64, row as f64) * f64::from(z));
        if support.signed_distance(&p) < SUPPORT_BAND { f32::INFINITY } else { z }
    })
}

/// The mask and the unknown pixels joined to it. If the object leaves the image, a ring one pixel wide round the image counts as unknown.
fn possibly_object(mask: &Raster<bool>, limits: &Raster<f32>, leaves_image: bool) -> Raster<bool> {
    let pad = usize::from(leaves_image);
    let (rows, cols) = (mask.rows() + 2 * pad, mask.cols() + 2 * pad);
    let unknown = |row: usize, col: usize| match (row.checked_sub(pad), col.checked_sub(pad)) {
        (Some(r), Some(c)) => limits.get(r, c).is_none_or(|&limit| limit == 0.0),
        _ => true,
    };
    let mut hidden = Raster::filled(rows, cols, false);
    let mut stack: Vec<(usize, usize)> = Vec::new();
    for (row, col, &m) in mask.pixels() {
        if m {
            hidden[(row + pad, col + pad)] = true;
            stack.push((row + pad, col + pad));
        }
    }
    while let Some((row, col)) = stack.pop() {
        for r in row.saturating_sub(1)..(row + 2).min(rows) {
            for c in col.saturating_sub(1)..(col + 2).min(cols) {
                if !hidden[(r, c)] && unknown(r, c) {
                    hidden[(r, c)] = true;
                    stack.push((r, c));
                }
            }
        }
    }
    hidden
}

/// The object's depth, replaced by the nearest of 3×3 where they differ by more than `jump`: between two surfaces a ray may graze either.
fn nearest_at_jumps(depth: &Raster<f32>, jump: f32) -> Raster<f32> {
    let (rows, cols) = depth.shape();
    Raster::from_fn(rows, cols, |row, col| {
        let z = depth[(row, col)];
        if !z.is_finite() {
            return z;
        }
        let mut nearest = z;
        for r in row.saturating_sub(1)..(row + 2).min(rows) {
            for c in col.saturating_sub(1)..(col + 2).min(cols) {
                nearest = nearest.min(depth[(r, c)]);
            }
        }
        if z - nearest > jump { nearest } else { z }
    })
}
