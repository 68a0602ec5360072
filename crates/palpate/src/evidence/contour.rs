use crate::camera::{Background, Frame, Visible};
use crate::geometry::{Point, Raster, Vector};

/// A reading is looked for this far around a pixel of the outline that has none, and neighbours decide on the direction this far, pixels.
const REACH: isize = 2;

/// A point of the occluding contour: where the surface turns away from the camera, **world** frame.
///
/// The ray through it touches the surface, so the normal is perpendicular to the ray and, in the image, to the outline: Koenderink, *What
/// does the occluding contour tell us about solid shape?*, Perception 13, 1984.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContourPoint {
    /// Position, metres: the outline's ray at the depth read beside it.
    pub position: Point,
    /// Outward unit normal.
    pub normal: Vector,
}

/// Pixels of the object beside which the ray goes on, past the object or to a part of it that lies more than `jump` metres deeper.
///
/// Where something nearer hides the object, or nothing is known of the ray beside, the object may go on: no contour.
pub(super) fn occluding_contour(frame: &Frame, visible: &Visible, jump: f64) -> Vec<ContourPoint> {
    let depth = &visible.depth;
    let passes = |row: isize, col: isize, z: f32| {
        let (Some(&on), Some(&read)) = (visible.mask.at(row, col), frame.depth.at(row, col)) else { return false };
        if on {
            return depth.at(row, col).is_some_and(|d| *d > z + jump as f32);
        }
        let known = read.is_finite() && read > 0.0;
        if known { read > z + jump as f32 } else { frame.background == Background::Absent }
    };
    let mut contour = Vec::new();
    for (row, col, _) in visible.mask.pixels().filter(|p| *p.2) {
        let Some(z) = nearest_reading(depth, row, col) else { continue };
        let (r, c) = (row as isize, col as isize);
        if ![(-1, 0), (1, 0), (0, -1), (0, 1)].iter().any(|(i, j)| passes(r + i, c + j, z)) {
            continue;
        }
        let window = (-REACH..=REACH).flat_map(|i| (-REACH..=REACH).map(move |j| (i, j)));
        let beside = window.filter(|&(i, j)| (i, j) != (0, 0) && passes(r + i, c + j, z));
        let across: Vector = beside.map(|(i, j)| Vector::new(j as f64, i as f64, 0.0).normalize()).sum();
        let Some(across) = across.try_normalize(1e-3) else { continue };
        let (u, v) = (col as f64 + 0.5 * across.x, row as f64 + 0.5 * across.y);
        let (ray, (du, dv)) = (frame.camera.ray(u, v), frame.camera.ray_derivatives(u, v));
        // Rays along the outline lie in the tangent plane, as this one does.
        let Some(normal) = (dv * across.x - du * across.y).cross(&ray).try_normalize(1e-12) else { continue };
        contour.push(ContourPoint {
            position: frame.world_from_camera * Point::from(ray * f64::from(z)),
            normal: frame.world_from_camera * normal,
        });
    }
    contour
}

/// The pixel's depth, else the nearest of those around it.
fn nearest_reading(depth: &Raster<f32>, row: usize, col: usize) -> Option<f32> {
    let own = depth[(row, col)];
    if own.is_finite() {
        return Some(own);
    }
    let window = (-REACH..=REACH).flat_map(|i| (-REACH..=REACH).map(move |j| (i, j)));
    let at = |(i, j): (isize, isize)| {
        let z = *depth.at(row as isize + i, col as isize + j)?;
        z.is_finite().then_some((i * i + j * j, z))
    };
    window.filter_map(at).min_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))).map(|(_, z)| z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::testing::{Solid, view};

    #[test]
    fn the_contour_of_a_sphere_is_where_rays_touch_it() {
        check_sphere(Point::new(0.0, 0.0, 0.05), 0.05);
        // Near the border of the image outlines are seen askew.
        check_sphere(Point::new(-0.09, 0.1, 0.03), 0.03);
    }

    fn check_sphere(center: Point, radius: f64) {
        let (frame, visible) = view(&[Solid::Sphere(center, radius)], 0.0);
        let eye = frame.world_from_camera * Point::origin();
        let contour = occluding_contour(&frame, &visible, 0.008);
        assert!(contour.len() as f64 > 3600.0 * radius, "{} points", contour.len());
        let mut mean = 0.0;
        for c in &contour {
            let off = (center - c.position).normalize();
            let askew = off.cross(&c.normal).dot(&(c.position - eye).normalize()).abs();
            mean += askew / contour.len() as f64;
            // Steps of the outline's pixels turn the normal; readings that stop where the surface grazes tip it towards the camera.
            assert!(askew < 0.25 && off.dot(&c.normal) < -0.9, "{c:?}: {askew}, {}", off.dot(&c.normal));
            assert!(c.normal.dot(&(c.position - eye)).abs() < 1e-6, "{c:?}: not perpendicular to the ray");
            // A pixel is 1.2 mm; readings stop where the surface grazes.
            assert!(((c.position - center).norm() - radius).abs() < 0.004, "{c:?}");
        }
        assert!(mean < 0.08, "normals are askew by {mean}");
    }

    #[test]
    fn an_object_that_may_go_on_has_no_contour_there() {
        let (mut frame, visible) = view(&[Solid::Sphere(Point::new(0.0, 0.0, 0.05), 0.05)], 0.0);
        frame.background = Background::Unknown;
        assert!(occluding_contour(&frame, &visible, 0.008).is_empty(), "nothing is known of the rays beside");
        frame.depth = frame.depth.map(|z| if z.is_finite() { *z } else { 0.3 });
        assert!(occluding_contour(&frame, &visible, 0.008).is_empty(), "something nearer hides what is behind");
    }

    #[test]
    fn a_near_part_has_a_contour_before_a_far_one() {
        let solids = [
            Solid::Box(Point::new(0.0, 0.0, 0.01), Vector::new(0.08, 0.08, 0.01), 0.0),
            Solid::Box(Point::new(0.0, 0.0, 0.08), Vector::new(0.02, 0.02, 0.005), 0.0),
        ];
        let (frame, visible) = view(&solids, 0.0);
        let contour = occluding_contour(&frame, &visible, 0.008);
        let of_near = contour.iter().filter(|c| c.position.z > 0.07).count();
        assert!(of_near > 80, "{of_near} points on the upper board's outline, which lies before the lower one");
    }
}
