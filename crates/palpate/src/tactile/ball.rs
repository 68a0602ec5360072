use crate::geometry::Raster;
use std::f64::consts::TAU;

/// The press of a ball, as its tactile image shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallPress {
    /// Where the ball's lowest point stands, `[column, row]`, pixels.
    pub center: [f64; 2],
    /// Radius of the circle in which the gel lies on the ball, pixels. Outside it the gel is a skirt of unknown slope.
    pub contact_radius: f64,
    /// Mean change of colour on that circle, grey levels.
    pub contrast: f64,
    /// How far the colours are from being opposite on opposite sides: 0 as they should be, 1 unrelated, 2 equal.
    pub asymmetry: f64,
}

/// Directions in which a profile is taken.
const DIRECTIONS: usize = 72;
/// Step of a profile, pixels.
const PROFILE_STEP: f64 = 0.5;

/// Finds centre and contact of a ball's press in the difference to the no-contact image.
///
/// The centre is where colours are most nearly opposite on opposite sides, for slopes are and colours follow them; the contact
/// ends where the mean change of colour on a circle peaks, for there the gel is steepest. The outline that the eye sees is
/// contact **and** skirt, half as wide again.
///
/// * `rough_center` – `[column, row]`; sought within a third of `rough_radius`
/// * `rough_radius` – of contact and skirt, pixels
///
/// Returns `None` if the change of colour has no peak within reach.
pub fn refine_ball(difference: &Raster<[f32; 3]>, rough_center: [f64; 2], rough_radius: f64) -> Option<BallPress> {
    let disc = disc(0.55 * rough_radius);
    let mut center = rough_center;
    let mut asymmetry = asymmetry_at(difference, center, &disc);
    let (mut step, mut reach) = (2.0, (0.3 * rough_radius / 2.0).ceil() as i32);
    while step > 0.2 {
        let middle = center;
        for (i, j) in (-reach..=reach).flat_map(|j| (-reach..=reach).map(move |i| (i, j))) {
            let place = [middle[0] + step * f64::from(i), middle[1] + step * f64::from(j)];
            let found = asymmetry_at(difference, place, &disc);
            if found < asymmetry {
                (center, asymmetry) = (place, found);
            }
        }
        (step, reach) = (0.5 * step, 2);
    }
    let (contact_radius, contrast) = peak(&profile(difference, center, 1.3 * rough_radius), 0.2 * rough_radius)?;
    Some(BallPress { center, contact_radius, contrast, asymmetry })
}

impl BallPress {
    /// Pixels left out at the edge of the contact, where a label would be wrong on one side.
    const MARGIN: f64 = 0.5;
    /// Contact radii from which the gel is taken as relaxed.
    const RELAXED: f64 = 2.6;
    /// One relaxed pixel of so many is a label: as many as the ball's, not a hundred times more.
    const RELAXED_STRIDE: usize = 113;

    /// Whether the press can be trusted for calibration: contact and skirt inside the image, colours that tell slopes.
    pub fn is_clear(&self, rows: usize, cols: usize) -> bool {
        let [x, y] = self.center;
        let room = x.min(y).min(cols as f64 - 1.0 - x).min(rows as f64 - 1.0 - y);
        2.0 * self.contact_radius <= room && self.contrast >= 30.0 && self.asymmetry <= 0.3
    }

    /// Whether a pixel lies on the ball.
    pub fn touches(&self, row: usize, col: usize) -> bool {
        self.distance(row, col) < self.contact_radius
    }

    /// The pixels whose slope the press proves: `(row, col, slope)`, the slope of the indentation along columns and rows.
    /// A ball's inside the contact, none far from it; the skirt proves nothing.
    ///
    /// * `ball_radius` – pixels
    pub fn labels(&self, rows: usize, cols: usize, ball_radius: f64) -> Vec<(usize, usize, [f32; 2])> {
        let [x, y] = self.center;
        let label = |i: usize| {
            let (row, col) = (i / cols, i % cols);
            let distance = self.distance(row, col);
            if distance < (self.contact_radius - Self::MARGIN).min(0.99 * ball_radius) {
                let drop = (ball_radius * ball_radius - distance * distance).sqrt();
                return Some((row, col, [((x - col as f64) / drop) as f32, ((y - row as f64) / drop) as f32]));
            }
            let relaxed = i.is_multiple_of(Self::RELAXED_STRIDE) && distance > Self::RELAXED * self.contact_radius;
            relaxed.then_some((row, col, [0.0; 2]))
        };
        (0..rows * cols).filter_map(label).collect()
    }

    fn distance(&self, row: usize, col: usize) -> f64 {
        (col as f64 - self.center[0]).hypot(row as f64 - self.center[1])
    }
}

/// Offsets within `radius` of which no two are opposite.
fn disc(radius: f64) -> Vec<[f64; 2]> {
    let r = radius.floor() as i32;
    let half = (-r..=r).flat_map(|y| (-r..=r).map(move |x| (x, y))).filter(|&(x, y)| y > 0 || (y == 0 && x > 0));
    half.map(|(x, y)| [f64::from(x), f64::from(y)]).filter(|[x, y]| x.hypot(*y) <= radius).collect()
}

/// Σ |d(c + o) + d(c − o)|² / Σ (|d(c + o)|² + |d(c − o)|²) over the offsets o.
fn asymmetry_at(difference: &Raster<[f32; 3]>, [x, y]: [f64; 2], offsets: &[[f64; 2]]) -> f64 {
    let (mut even, mut all) = (0.0, f64::MIN_POSITIVE);
    for [dx, dy] in offsets {
        let (a, b) = (sample(difference, x + dx, y + dy), sample(difference, x - dx, y - dy));
        for k in 0..3 {
            even += (a[k] + b[k]).powi(2);
            all += a[k].powi(2) + b[k].powi(2);
        }
    }
    even / all
}

/// Mean size of the change on circles round the centre.
fn profile(difference: &Raster<[f32; 3]>, [x, y]: [f64; 2], reach: f64) -> Vec<f64> {
    let ring = |i: usize| {
        let radius = PROFILE_STEP * i as f64;
        let size = |j: usize| {
            let (sin, cos) = (TAU * j as f64 / DIRECTIONS as f64).sin_cos();
            sample(difference, x + radius * cos, y + radius * sin).iter().map(|d| d * d).sum::<f64>().sqrt()
        };
        (0..DIRECTIONS).map(size).sum::<f64>() / DIRECTIONS as f64
    };
    let raw: Vec<f64> = (0..(reach / PROFILE_STEP) as usize).map(ring).collect();
    let smooth = |i: usize| {
        let near = &raw[i.saturating_sub(1)..(i + 2).min(raw.len())];
        near.iter().sum::<f64>() / near.len() as f64
    };
    (0..raw.len()).map(smooth).collect()
}

/// Radius and height of the profile's highest inner point beyond `least`, to a fraction of a step by a parabola.
fn peak(profile: &[f64], least: f64) -> Option<(f64, f64)> {
    let first = ((least / PROFILE_STEP) as usize).max(1);
    let at = (first..profile.len().checked_sub(1)?).max_by(|&a, &b| profile[a].total_cmp(&profile[b]))?;
    let (low, top, high) = (profile[at - 1], profile[at], profile[at + 1]);
    let bend = low - 2.0 * top + high;
    // Written so that NaN fails too.
    (bend < 0.0 && low <= top && high <= top).then(|| (PROFILE_STEP * (at as f64 + 0.5 * (low - high) / bend), top))
}

/// Bilinear value, clamped to the raster's edge.
fn sample(raster: &Raster<[f32; 3]>, x: f64, y: f64) -> [f64; 3] {
    let split = |x: f64, n: usize| {
        let x = x.clamp(0.0, n as f64 - 1.0);
        let low = x as usize;
        (low, (low + 1).min(n - 1), x - low as f64)
    };
    let ((c0, c1, fx), (r0, r1, fy)) = (split(x, raster.cols()), split(y, raster.rows()));
    let at = |r, c, k: usize| f64::from(raster[(r, c)][k]);
    std::array::from_fn(|k| {
        (at(r0, c0, k) * (1.0 - fx) + at(r0, c1, k) * fx) * (1.0 - fy)
            + (at(r1, c0, k) * (1.0 - fx) + at(r1, c1, k) * fx) * fy
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const BALL: f64 = 25.0;

    /// Colours that follow the slope of a ball in contact up to 17 px and of a skirt that ends at 28 px.
    fn picture([x, y]: [f64; 2]) -> Raster<[f32; 3]> {
        Raster::from_fn(120, 160, |row, col| {
            let (dx, dy) = (col as f64 - x, row as f64 - y);
            let r = dx.hypot(dy).max(1e-9);
            let slope = if r < 17.0 {
                r / (BALL * BALL - r * r).sqrt()
            } else {
                17.0 / (BALL * BALL - 17.0f64.powi(2)).sqrt() * ((28.0 - r) / 11.0).clamp(0.0, 1.0)
            };
            let (gx, gy) = (-slope * dx / r, -slope * dy / r);
            [90.0 * gx + 40.0 * gy, 80.0 * gy, 70.0 * gy - 60.0 * gx].map(|v| v as f32)
        })
    }

    #[test]
    fn centre_and_contact_are_found_from_a_rough_outline() {
        let press = refine_ball(&picture([71.3, 62.8]), [75.0, 60.0], 28.0).expect("a ball");
        assert!((press.center[0] - 71.3).abs() < 0.3 && (press.center[1] - 62.8).abs() < 0.3, "{press:?}");
        // Not the outline's 28.
        assert!((press.contact_radius - 17.0).abs() < 0.8, "{press:?}");
        assert!(press.asymmetry < 0.02 && press.is_clear(120, 160), "{press:?}");
        assert!(!press.is_clear(96, 160), "cut by the border");
    }

    #[test]
    fn nothing_has_no_ball() {
        assert_eq!(refine_ball(&Raster::filled(120, 160, [0.0; 3]), [75.0, 60.0], 28.0), None);
    }

    #[test]
    fn labels_are_the_slopes_of_the_ball_and_the_skirt_has_none() {
        let press = BallPress { center: [80.0, 60.0], contact_radius: 17.0, contrast: 60.0, asymmetry: 0.0 };
        let labels = press.labels(120, 160, BALL);
        let at = |row, col| labels.iter().find(|l| (l.0, l.1) == (row, col)).map(|l| l.2);
        // Pressed in more towards the centre: left of it the slope along columns is positive.
        assert_eq!(at(60, 65), Some([0.75, 0.0]));
        assert_eq!(at(75, 80), Some([0.0, -0.75]));
        assert_eq!(at(60, 100), None);
        assert!(labels.iter().filter(|l| l.2 == [0.0; 2]).count() > 100);
    }
}
