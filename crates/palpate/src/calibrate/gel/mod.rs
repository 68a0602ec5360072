//! A gel from presses of a ball: the map from colours to slopes, and how true it is.
//!
//! Slopes have no scale. Twice the ball at twice the pitch gives the same slopes everywhere, so no press of balls, whatever
//! their sizes, tells the size of a pixel: with pixels taken as `s` times their size, each ball reads as if it were known `s` times as
//! well, and the map absorbs it (a test shows it). The pitch comes from the user, from a ruler's marks, or from two presses a known
//! distance apart; all that are given must agree.

mod calibration;
mod decoder;
mod error;
mod network;
mod outline;
mod press;
mod quality;
mod scale;

pub use calibration::{GelCalibration, GelParams, calibrate_gel};
pub use decoder::{GelDecoder, GelMap, MapKind};
pub use error::{GelError, PressFault};
pub use network::SlopeNetwork;
pub use outline::outline;
pub use press::{GelPress, find_press, locate_ball};
pub use quality::{PressQuality, Quality};
pub use scale::{PitchSource, agree, presses_apart, ruler_period};
