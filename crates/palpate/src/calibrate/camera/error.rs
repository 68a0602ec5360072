use crate::camera::CameraError;

/// Why an image shows no board that can be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BoardError {
    /// The board's description makes no sense.
    #[error("the board's {field} is {value}; it must be {rule}")]
    Description {
        /// `columns`, `rows` or `square`.
        field: &'static str,
        /// What was found.
        value: f64,
        /// What is needed.
        rule: &'static str,
    },
    /// The image is too small to show one.
    #[error("the image is {cols}×{rows} px (width × height); at least 32×32 are needed")]
    Size {
        /// Image width, pixels.
        cols: usize,
        /// Image height, pixels.
        rows: usize,
    },
    /// The image is of one grey.
    #[error("the image has no contrast: its darkest and brightest pixels differ by {range} grey levels")]
    NoContrast {
        /// Range of the grey values.
        range: f32,
    },
    /// Too few corners in a grid.
    #[error(
        "no board of {cols}×{rows} inner corners: {corners} corners were found, the largest regular grid among them has {}×{} \
         (inner corners are counted, where four squares meet; the whole board must be in view)",
        largest.0, largest.1
    )]
    NotFound {
        /// Corners wanted along the board.
        cols: usize,
        /// Corners wanted across it.
        rows: usize,
        /// Corners of squares found.
        corners: usize,
        /// Columns and rows of the largest grid that they form.
        largest: (usize, usize),
    },
    /// A line of the board's corners is its edge.
    #[error(
        "no board of {cols}×{rows} inner corners: with so many, an outer line of them is the board's edge, beyond which no squares follow (inner \
         corners are counted, where four squares meet)"
    )]
    Edge {
        /// Corners announced along the board.
        cols: usize,
        /// Corners announced across it.
        rows: usize,
    },
    /// The board has more corners than it should.
    #[error(
        "the board in the image has at least {}×{} inner corners, {cols}×{rows} were announced: count where four squares meet",
        found.0, found.1
    )]
    Larger {
        /// Corners announced along the board.
        cols: usize,
        /// Corners announced across it.
        rows: usize,
        /// Columns and rows found.
        found: (usize, usize),
    },
}

/// Why there is no calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// Too few boards.
    #[error(
        "{found} different views of the board ({repeated} repeat others); at least {needed} are needed, ten tilted ones are good"
    )]
    TooFewViews {
        /// Different views.
        found: usize,
        /// Views that repeat another.
        repeated: usize,
        /// Views needed.
        needed: usize,
    },
    /// A view has not a corner for each of the board's.
    #[error("view {view} has {found} corners; the board has {needed}")]
    Corners {
        /// Which view, from 0.
        view: usize,
        /// Corners found.
        found: usize,
        /// Corners needed.
        needed: usize,
    },
    /// The views do not tell the parameters apart.
    #[error(
        "the views are ill-conditioned: {what}; the boards' tilts differ by at most {tilts:.1}°. Take views tilted by 20° to 45° \
         to different sides"
    )]
    IllConditioned {
        /// Which parameter is how uncertain.
        what: String,
        /// Largest angle between two boards' normals, degrees.
        tilts: f64,
    },
    /// The refinement diverged.
    #[error(
        "the refinement did not converge: {rms:.2} px off after {steps} steps; is the board flat, and its size right?"
    )]
    NotConverged {
        /// Error left, pixels.
        rms: f64,
        /// Steps done.
        steps: usize,
    },
    /// The distortion found folds the image over itself.
    #[error(
        "the distortion found folds the image over itself at pixel ({u:.0}, {v:.0}): the boards do not tell the lens there. Cover the \
         image's border with boards, or keep more of the lens as it is: k3 and k2 (--fix k3,k2), or all of it (--fix distortion)"
    )]
    Folded {
        /// Column of the pixel.
        u: f64,
        /// Row of the pixel.
        v: f64,
    },
    /// The parameters found are no camera.
    #[error("the camera found cannot be used")]
    Camera(#[from] CameraError),
    /// The corners do not determine a pose.
    #[error("view {view}: the corners do not determine where the board is; are they on one line?")]
    NoPose {
        /// Which view, from 0.
        view: usize,
    },
    /// Two lists that belong together differ in length.
    #[error("{first} views of the one camera and {second} of the other; each needs its partner")]
    Unpaired {
        /// Views of the first.
        first: usize,
        /// Views of the second.
        second: usize,
    },
    /// No mounting fits the pairs.
    #[error(
        "the corners of {pairs} pairs fit one mounting to {rms:.1} px only, {limit:.0} px are needed: do the pairs belong together, and did the \
         board rest while both cameras saw it?{}",
        said(apart)
    )]
    PairsDisagree {
        /// How many there are.
        pairs: usize,
        /// Root mean square distance left, pixels.
        rms: f64,
        /// The most allowed.
        limit: f64,
        /// Pairs that contradict most others, from 0.
        apart: Vec<usize>,
    },
    /// The board looks the same from two sides.
    #[error(
        "a board of {cols}×{rows} inner corners looks the same turned by half: where it lies cannot be told. Use one with an even \
         and an odd number"
    )]
    Ambiguous {
        /// Corners along the board.
        cols: usize,
        /// Corners across it.
        rows: usize,
    },
}

/// Pairs that contradict the others, from 0.
fn said(apart: &[usize]) -> String {
    if apart.is_empty() {
        return String::new();
    }
    let pairs: Vec<String> = apart.iter().map(usize::to_string).collect();
    format!(" Against the others, counted from 0: {}", pairs.join(", "))
}
