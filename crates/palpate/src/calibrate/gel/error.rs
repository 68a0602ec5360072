use crate::tactile::{DecodeError, LookupTableError, RegressorError, SensorError};

/// What is wrong with one press.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PressFault {
    /// The image does not belong to the background.
    #[error(transparent)]
    Image(#[from] DecodeError),
    /// Nothing is pressed.
    #[error("there is no contact: the image is the background")]
    NoContact,
    /// The change has no ball's profile.
    #[error(
        "no contact circle was found: the change of colour has no peak around its middle; is it a ball, and alone?"
    )]
    NoCircle,
    /// The contact or its skirt is cut.
    #[error(
        "the press is cut by the border: contact of {radius:.0} px at ({:.0}, {:.0}), {room:.0} px from the border; {needed:.0} are needed",
        center[0], center[1]
    )]
    Cut {
        /// Column and row of the centre.
        center: [f64; 2],
        /// Contact radius, pixels.
        radius: f64,
        /// Distance of the centre from the border, pixels.
        room: f64,
        /// Distance needed.
        needed: f64,
    },
    /// Colours hardly change.
    #[error(
        "the press is faint: {found:.0} grey levels of change on the contact circle, {needed:.0} are needed; press harder, or is it dark?"
    )]
    Faint {
        /// Change found, grey levels.
        found: f64,
        /// Change needed.
        needed: f64,
    },
    /// Colours are not opposite on opposite sides.
    #[error(
        "opposite sides do not have opposite colours ({found:.2}, at most {limit:.2}): is it a ball, is the light from several sides, is \
         the press over a shadow?"
    )]
    Asymmetric {
        /// 0 opposite, 1 unrelated.
        found: f64,
        /// Most allowed.
        limit: f64,
    },
    /// The press was given already.
    #[error(
        "the press repeats another: the same contact circle as in image {of} of those given (from 0), which proves nothing twice"
    )]
    Repeats {
        /// The one before, by its place in the list.
        of: usize,
    },
    /// A press to measure on was calibrated with.
    #[error("the press was calibrated with (image {of} of those given, from 0): nothing can be measured on it")]
    CalibratedWith {
        /// Which of the presses of the calibration, by its place in the list.
        of: usize,
    },
    /// What is decoded of a press to measure on has no curvature.
    #[error("no sphere could be fitted to what is decoded of it: nothing can be measured on it")]
    NoSphere,
    /// The contact is wider than the ball.
    #[error(
        "the contact circle has a radius of {found:.3} mm, the ball only {ball:.3} mm: the ball's radius (metres, not the diameter) or \
         the pixel pitch is wrong"
    )]
    WiderThanBall {
        /// Contact radius by the pitch, millimetres.
        found: f64,
        /// Ball radius, millimetres.
        ball: f64,
    },
    /// The contact is absurdly small for the ball.
    #[error(
        "the contact circle has a radius of {found:.3} mm, under a tenth of the ball's {ball:.3} mm: the ball's radius (metres) or the \
         pixel pitch is wrong, or the press too light"
    )]
    TooSmall {
        /// Contact radius by the pitch, millimetres.
        found: f64,
        /// Ball radius, millimetres.
        ball: f64,
    },
}

/// Why there is no calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GelError {
    /// Too few presses are left.
    #[error("{found} usable presses; at least {needed} are needed, five to ten spread over the pad are good")]
    TooFewPresses {
        /// Usable presses.
        found: usize,
        /// Presses needed.
        needed: usize,
        /// The others, by their place in the list, and why they cannot be used.
        left_out: Vec<(usize, PressFault)>,
    },
    /// No held-out press can be used.
    #[error("none of the {} held-out presses can be measured on", left_out.len())]
    NothingToMeasure {
        /// All of them, by their place in the list, and why.
        left_out: Vec<(usize, PressFault)>,
    },
    /// The ball's radius is no ball of a tactile calibration.
    #[error("the ball radius is {found} m; balls of 0.0002 to 0.05 m are pressed into gels (2 mm is 0.002)")]
    Ball {
        /// Radius found, metres.
        found: f64,
    },
    /// Nothing tells the size of a pixel.
    #[error(
        "the size of a pixel is not known: presses of balls cannot tell it, for slopes have no scale. Give the pitch, a press of a ruler, \
         or two presses a known distance apart"
    )]
    NoPitch,
    /// Two sources of the pitch disagree.
    #[error("the pixel pitch is {:.5} mm by {first}, but {:.5} mm by {second}: more than {:.0} % apart", 1e3 * found[0], 1e3 * found[1], 100.0 * limit)]
    PitchesDisagree {
        /// The one source.
        first: &'static str,
        /// The other.
        second: &'static str,
        /// Pitches, metres.
        found: [f64; 2],
        /// Share by which they may differ.
        limit: f64,
    },
    /// The ruler's press shows no marks.
    #[error(
        "the ruler's press shows no evenly spaced marks: the pattern repeats itself only to {found:.2} (1 wholly, {needed:.2} needed)"
    )]
    NoMarks {
        /// Correlation found.
        found: f64,
        /// Correlation needed.
        needed: f64,
    },
    /// Two presses that should be apart are not.
    #[error("the two presses are {found:.1} px apart; at least {needed:.0} px are needed to tell the pitch")]
    TooClose {
        /// Distance found, pixels.
        found: f64,
        /// Distance needed.
        needed: f64,
    },
    /// The sensor is impossible.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// An image does not fit.
    #[error(transparent)]
    Image(#[from] DecodeError),
    /// The polynomial cannot be fitted.
    #[error(transparent)]
    Regressor(#[from] RegressorError),
    /// The table cannot be filled.
    #[error(transparent)]
    Table(#[from] LookupTableError),
    /// The decoded presses are no spheres.
    #[error("none of the held-out presses decodes to a sphere: the colours do not tell slopes")]
    NoSphere,
}
