use super::{ExploreError, Reach};
use crate::metrics::CompareParams;
use crate::pipeline::ReconstructParams;
use crate::simulate::CameraParams;
use crate::tactile::PressParams;
use serde::{Deserialize, Serialize};

/// How uncertain the surface is and how far a touch tells.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BeliefParams {
    /// Spacing of the points that carry the belief, metres. Smaller: finer, and time grows with its fourth power.
    pub spacing: f64,
    /// σ where the surface was measured, metres.
    pub measured_sigma: f64,
    /// Growth of σ per metre from the nearest measurement that faces alike, where nothing was guessed.
    pub growth: f64,
    /// σ is at most this, metres.
    pub largest_sigma: f64,
    /// Share of that σ that is left where a guessed sample lies.
    pub guessed_share: f64,
    /// Distance over which the surface's error is alike, metres. Larger: a touch tells more of its surroundings.
    pub correlation_length: f64,
    /// σ of what a touch tells about the surface under it, metres.
    pub touch_sigma: f64,
    /// How much the disagreement of hypotheses counts; 0 leaves it out.
    pub hypotheses: f64,
    /// Differences between two hypotheses' surfaces count up to this, metres.
    pub largest_difference: f64,
    /// Rejected planes to try as hypotheses.
    pub rejected: usize,
}

impl Default for BeliefParams {
    fn default() -> Self {
        Self {
            spacing: 8e-3,
            measured_sigma: 0.5e-3,
            growth: 0.15,
            largest_sigma: 15e-3,
            guessed_share: 0.4,
            correlation_length: 20e-3,
            touch_sigma: 0.5e-3,
            hypotheses: 1.0,
            largest_difference: 20e-3,
            rejected: 1,
        }
    }
}

/// Parameters of [`super::next_touches`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NextTouchParams {
    /// Touches to propose.
    pub count: usize,
    /// Reachable poses to choose from. More: better places, more time.
    pub candidates: usize,
    /// Seed of the candidates.
    pub seed: u64,
    /// Preset of the sensor where the scene has none.
    pub sensor: String,
    /// Free path in front of the surface that the fingertip comes along, metres; also how far it is pressed on past the expected
    /// surface before the touch counts as a miss, at most.
    pub approach: f64,
    /// A pose is not proposed where the expected surface lies further than this in space that the camera proves free, metres.
    pub free_tolerance: f64,
    /// The press.
    pub press: PressParams,
    /// What the arm can reach.
    pub reach: Reach,
    /// Uncertainty and what touches tell.
    pub belief: BeliefParams,
    /// The reconstruction that the plan is made on; coarse is enough, and fast.
    pub reconstruct: ReconstructParams,
}

impl Default for NextTouchParams {
    fn default() -> Self {
        let mut reconstruct = ReconstructParams::default();
        reconstruct.implicit.spacing = 3e-3;
        reconstruct.implicit.dense_cells = 40_000;
        Self {
            count: 1,
            candidates: 200,
            seed: 0,
            sensor: "ycb-sight".to_owned(),
            approach: 0.03,
            free_tolerance: 4e-3,
            press: PressParams::default(),
            reach: Reach::default(),
            belief: BeliefParams::default(),
            reconstruct,
        }
    }
}

impl NextTouchParams {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`ExploreError`] with field, value and rule.
    pub fn validate(&self) -> Result<(), ExploreError> {
        let check = |field, found: f64, ok: bool, needed| {
            if ok { Ok(()) } else { Err(ExploreError::Params { field, found, needed }) }
        };
        check("count", self.count as f64, self.count >= 1, "at least 1")?;
        check("candidates", self.candidates as f64, self.candidates >= 1, "at least 1")?;
        let positive = |x: f64| x > 0.0 && x.is_finite();
        let b = &self.belief;
        let lengths = [
            ("approach", self.approach),
            ("free_tolerance", self.free_tolerance),
            ("belief.spacing", b.spacing),
            ("belief.measured_sigma", b.measured_sigma),
            ("belief.growth", b.growth),
            ("belief.largest_sigma", b.largest_sigma),
            ("belief.correlation_length", b.correlation_length),
            ("belief.touch_sigma", b.touch_sigma),
            ("belief.largest_difference", b.largest_difference),
        ];
        for (field, found) in lengths {
            check(field, found, positive(found), "positive and finite")?;
        }
        check("belief.guessed_share", b.guessed_share, (0.0..=1.0).contains(&b.guessed_share), "in [0, 1]")?;
        check("belief.hypotheses", b.hypotheses, b.hypotheses >= 0.0 && b.hypotheses.is_finite(), "at least 0")?;
        self.press.validate()?;
        self.reach.validate()?;
        Ok(self.reconstruct.validate()?)
    }
}

/// Parameters of [`super::explore`].
#[derive(Debug, Clone, PartialEq)]
pub struct ExploreParams {
    /// Touches to make.
    pub touches: usize,
    /// Number of the view.
    pub view: usize,
    /// Seed of the scene and of the candidates.
    pub seed: u64,
    /// The depth camera.
    pub camera: CameraParams,
    /// Width of the height maps, pixels.
    pub map_width: usize,
    /// Planning and reconstruction; its `candidates` are the places offered at each step.
    pub plan: NextTouchParams,
    /// How the meshes are judged.
    pub compare: CompareParams,
}

impl Default for ExploreParams {
    fn default() -> Self {
        Self {
            touches: 5,
            view: 0,
            seed: 0,
            camera: CameraParams::default(),
            map_width: 160,
            plan: NextTouchParams { candidates: 20, ..NextTouchParams::default() },
            compare: CompareParams { samples: 8000, iou_lines: 8192, ..CompareParams::default() },
        }
    }
}
