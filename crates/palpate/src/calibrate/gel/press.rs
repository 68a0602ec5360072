use super::{PressFault, outline};
use crate::geometry::Raster;
use crate::tactile::{BallPress, NoContact, SlopeRegressor, fill_markers, markers, refine_ball};

/// Change of colour on the contact circle that is needed, grey levels.
const LEAST_CONTRAST: f64 = 30.0;
/// Asymmetry that is allowed.
const MOST_ASYMMETRY: f64 = 0.3;
/// Distance of centres, and difference of radii, under which two contacts are one, pixels: a copy of an image, or the next frame of a
/// press at rest.
const REPEATED_PX: f64 = 0.2;

/// A press of a ball, found in its image.
#[derive(Debug, Clone)]
pub struct GelPress {
    /// The image, markers filled in.
    pub image: Raster<[u8; 3]>,
    /// Difference to the background.
    pub difference: Raster<[f32; 3]>,
    /// The same relative to the light: see [`SlopeRegressor::relative_difference`].
    pub relative: Raster<[f32; 3]>,
    /// Pixels of markers, in the press or the background: their colours are guessed and prove nothing.
    pub masked: Raster<bool>,
    /// The contact.
    pub ball: BallPress,
    /// Radius of the ball, metres.
    pub ball_radius: f64,
}

/// A press before the size of a pixel is known.
struct Located {
    image: Raster<[u8; 3]>,
    difference: Raster<[f32; 3]>,
    masked: Raster<bool>,
    ball: BallPress,
}

fn locate(
    image: &Raster<[u8; 3]>,
    no_contact: &NoContact,
    background_markers: Option<&Raster<bool>>,
) -> Result<Located, PressFault> {
    let (rows, cols) = no_contact.shape();
    // Checks size, colours, light and channel order before anything else is believed.
    let _ = no_contact.difference(image)?;
    let image = super::decoder::at_size(image, rows, cols);
    let (image, masked) = match background_markers {
        Some(background) => {
            let found = markers(&image);
            let filled = fill_markers(&image, &found);
            let either = Raster::from_fn(rows, cols, |r, c| found[(r, c)] || background[(r, c)]);
            (filled, either)
        }
        None => (image, Raster::filled(rows, cols, false)),
    };
    let difference = no_contact.difference(&image)?;
    if NoContact::is_untouched(&difference) {
        return Err(PressFault::NoContact);
    }
    let (center, radius) = outline(&difference).ok_or(PressFault::NoContact)?;
    let ball = refine_ball(&difference, center, radius).ok_or(PressFault::NoCircle)?;
    check(&ball, rows, cols)?;
    Ok(Located { image, difference, masked, ball })
}

/// The contact circle of a ball's press, pixels: needs no pitch.
///
/// # Errors
/// [`PressFault`].
pub fn locate_ball(
    image: &Raster<[u8; 3]>,
    no_contact: &NoContact,
    background_markers: Option<&Raster<bool>>,
) -> Result<BallPress, PressFault> {
    locate(image, no_contact, background_markers).map(|l| l.ball)
}

/// Finds the contact circle of a ball's press and checks that it can calibrate.
///
/// * `no_contact` – the background; markers filled in, if the gel has some
/// * `background_markers` – markers of the background, if the gel has some
/// * `pitch` – metres per pixel of `no_contact`
///
/// # Errors
/// [`PressFault`].
pub fn find_press(
    image: &Raster<[u8; 3]>,
    no_contact: &NoContact,
    background_markers: Option<&Raster<bool>>,
    ball_radius: f64,
    pitch: f64,
) -> Result<GelPress, PressFault> {
    let Located { image, difference, masked, ball } = locate(image, no_contact, background_markers)?;
    let (found, wide) = (ball.contact_radius * pitch, 0.98 * ball_radius);
    if found > wide {
        return Err(PressFault::WiderThanBall { found: 1e3 * found, ball: 1e3 * ball_radius });
    }
    if found < 0.1 * ball_radius {
        return Err(PressFault::TooSmall { found: 1e3 * found, ball: 1e3 * ball_radius });
    }
    let relative = SlopeRegressor::relative_difference(no_contact, &difference);
    Ok(GelPress { image, difference, relative, masked, ball, ball_radius })
}

fn check(ball: &BallPress, rows: usize, cols: usize) -> Result<(), PressFault> {
    let [x, y] = ball.center;
    let room = x.min(y).min(cols as f64 - 1.0 - x).min(rows as f64 - 1.0 - y);
    // The skirt reaches half as far again as the contact; its colours are needed whole.
    let needed = 2.0 * ball.contact_radius;
    if room < needed {
        return Err(PressFault::Cut { center: ball.center, radius: ball.contact_radius, room, needed });
    }
    // Written so that NaN fails too.
    if !(ball.contrast >= LEAST_CONTRAST) {
        return Err(PressFault::Faint { found: ball.contrast, needed: LEAST_CONTRAST });
    }
    if !(ball.asymmetry <= MOST_ASYMMETRY) {
        return Err(PressFault::Asymmetric { found: ball.asymmetry, limit: MOST_ASYMMETRY });
    }
    Ok(())
}

impl GelPress {
    /// Whether it is the same contact as another.
    pub(super) fn repeats(&self, other: &Self) -> bool {
        let (a, b) = (&self.ball, &other.ball);
        let apart = (a.center[0] - b.center[0]).hypot(a.center[1] - b.center[1]);
        apart < REPEATED_PX && (a.contact_radius - b.contact_radius).abs() < REPEATED_PX
    }

    /// How deep the ball is in the contact circle, metres.
    ///
    /// * `pitch` – metres per pixel
    pub fn cap(&self, pitch: f64) -> f64 {
        let edge = (pitch * self.ball.contact_radius).min(self.ball_radius);
        self.ball_radius - (self.ball_radius * self.ball_radius - edge * edge).sqrt()
    }

    /// Pixels of known slope: `(row, col, slope)`, markers left out.
    ///
    /// * `pitch` – metres per pixel
    pub(super) fn labels(&self, pitch: f64) -> Vec<(usize, usize, [f32; 2])> {
        let (rows, cols) = self.relative.shape();
        let mut labels = self.ball.labels(rows, cols, self.ball_radius / pitch);
        labels.retain(|&(row, col, _)| !self.masked[(row, col)]);
        labels
    }
}
