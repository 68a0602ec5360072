/// Why the pose of a sensor cannot be found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SensorPoseError {
    /// Too few records.
    #[error("{found} records; at least {needed} are needed, {good} are good")]
    TooFew {
        /// Records found.
        found: usize,
        /// Records needed.
        needed: usize,
        /// Records that make a good calibration.
        good: usize,
    },
    /// A number is not finite.
    #[error("record {record} holds a number that is not finite")]
    NotFinite {
        /// Which record, from 0.
        record: usize,
    },
    /// The motions do not determine the pose.
    #[error(
        "the motions do not determine the sensor's pose: {what}. Turn the hand about at least two axes that are not parallel, by 20° and more"
    )]
    Degenerate {
        /// What is missing.
        what: String,
    },
    /// The records contradict each other.
    #[error(
        "the records contradict each other: {rms:.2} {unit} are left on average, {worst:.2} at record {record}; does the robot's pose belong to \
         the same moment, are lengths in metres, did the target stay in place?"
    )]
    Inconsistent {
        /// Error left, in `unit`.
        rms: f64,
        /// Its unit.
        unit: &'static str,
        /// Largest error.
        worst: f64,
        /// Where, from 0.
        record: usize,
    },
}
