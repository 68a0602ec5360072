use crate::geometry::{KdTree, Point, Vector};
use serde::{Deserialize, Serialize};

/// How wide the rays are that delete contradicted guesses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EliminationParams {
    /// Radius of a ray where it passes its tactile point, in units of the patch's sample spacing; larger removes more. Default 1.5:
    /// rays of neighbours overlap even where averaging has spaced the samples unevenly, and reach past the patch by 1.5 samples at most.
    pub ray_radius: f64,
}

impl Default for EliminationParams {
    fn default() -> Self {
        Self { ray_radius: 1.5 }
    }
}

/// Marks the guessed points that a touch contradicts: those on the ray from the object's centre through a felt point.
///
/// A point m is marked if the angle between m − c and t − c is at most atan(`ray_radius` · s / |t − c|) for a tactile point t of a
/// patch with sample spacing s. Same direction only: what lies behind the centre is another side of the object. The rule is Badosa's
/// (2024) with the tolerance tied to the sampling.
///
/// * `guessed` – mirrored points; never pass measured ones
/// * `patches` – felt points, one slice per touch
/// * `center` – the object's centre
///
/// O((n + m) log n); returns one flag per guessed point.
pub fn contradicted(guessed: &[Point], patches: &[&[Point]], center: &Point, params: &EliminationParams) -> Vec<bool> {
    let (indices, directions): (Vec<usize>, Vec<Point>) =
        guessed.iter().enumerate().filter_map(|(i, p)| Some((i, Point::from(direction(p, center)?)))).unzip();
    let tree = KdTree::new(&directions);
    let mut marked = vec![false; guessed.len()];
    for patch in patches {
        let radius = params.ray_radius * median_nearest(patch);
        for felt in *patch {
            let Some(ray) = direction(felt, center) else { continue };
            let angle = (radius / (felt - center).norm()).atan();
            // The chord of an angle on the unit sphere; the last bit is for a point exactly on the ray.
            let chord = 2.0 * (0.5 * angle).sin() + 1e-12;
            for (found, _) in tree.within(&Point::from(ray), chord) {
                marked[indices[found]] = true;
            }
        }
    }
    marked
}

fn direction(p: &Point, center: &Point) -> Option<Vector> {
    (p - center).try_normalize(1e-9)
}

/// Median distance of a point to its nearest other, metres; 0 for a single point.
fn median_nearest(points: &[Point]) -> f64 {
    let tree = KdTree::new(points);
    let mut nearest: Vec<f64> = points.iter().filter_map(|p| tree.nearest_n(p, 2).get(1).map(|n| n.1)).collect();
    nearest.sort_unstable_by(f64::total_cmp);
    nearest.get(nearest.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CENTER: Point = Point::new(0.1, -0.2, 0.05);

    /// A 5 × 5 patch of spacing 1 mm at 40 mm above the centre.
    fn patch() -> Vec<Point> {
        let at = |k: i32| f64::from(k % 5 - 2) * 1e-3;
        (0..25).map(|k| CENTER + Vector::new(at(k), at(k / 5), 0.04)).collect()
    }

    fn mark(guessed: &[Vector], ray_radius: f64) -> Vec<bool> {
        let points: Vec<Point> = guessed.iter().map(|v| CENTER + v).collect();
        contradicted(&points, &[&patch()], &CENTER, &EliminationParams { ray_radius })
    }

    #[test]
    fn the_whole_ray_goes_and_nothing_behind_the_centre() {
        let (near, far, behind) = (Vector::z() * 0.01, Vector::z() * 0.09, Vector::z() * -0.04);
        assert_eq!(mark(&[near, far, behind, Vector::x() * 0.04], 1.0), [true, true, false, false]);
    }

    #[test]
    fn the_tolerance_is_the_patch_spacing() {
        // At 80 mm the patch spans ±4 mm and a ray has a radius of 2 mm.
        let at = |x: f64| Vector::new(x, 0.0, 0.08);
        assert_eq!(mark(&[at(0.0), at(0.0039), at(0.0059), at(0.0062)], 1.0), [true, true, true, false]);
        assert_eq!(mark(&[at(0.004), at(0.0045)], 0.0), [true, false]);
    }

    #[test]
    fn no_touch_or_no_direction_removes_nothing() {
        assert_eq!(mark(&[Vector::zeros()], 1.0), [false]);
        let params = EliminationParams::default();
        assert_eq!(contradicted(&[CENTER], &[], &CENTER, &params), [false]);
        assert_eq!(contradicted(&[CENTER + Vector::x()], &[&[CENTER], &[]], &CENTER, &params), [false]);
    }
}
