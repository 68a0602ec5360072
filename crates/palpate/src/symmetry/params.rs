use serde::{Deserialize, Serialize};

/// Why no symmetry could be sought.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SymmetryError {
    /// A parameter is out of its range.
    #[error("symmetry parameter '{field}' is {value}; it must be {rule}")]
    Parameter {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        rule: &'static str,
    },
}

/// How the evidence is searched for symmetry, and what is accepted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SymmetryParams {
    /// Seed of the subsamples. The result hardly depends on it.
    pub seed: u64,
    /// Plane normals over the half-sphere. More: finer search at proportional cost; 200 are 10° apart.
    pub directions: usize,
    /// Further plane normals along the horizon: objects stand on their support, so most of their planes are vertical.
    pub horizontal_directions: usize,
    /// Plane offsets per direction over the evidence's extent. More: finer search at proportional cost.
    pub offsets: usize,
    /// Samples that score a hypothesis in the search. More: fewer wrong candidates at proportional cost.
    pub search_samples: usize,
    /// Samples that score a hypothesis in its refinement and acceptance. More: sharper optimum at proportional cost.
    pub refine_samples: usize,
    /// Candidate planes that are refined.
    pub plane_candidates: usize,
    /// Candidate axes that are refined.
    pub axis_candidates: usize,
    /// Violation starts this far inside free space, metres. Larger: noise and slight asymmetry are forgiven. About 2σ of the camera.
    pub violation_tolerance: f64,
    /// Past the tolerance, violation is complete after this, metres. Larger: deep violations count more against shallow ones.
    pub violation_range: f64,
    /// Distance from a measured surface up to which a moved sample supports, metres. Larger: slight asymmetry is forgiven.
    pub support_tolerance: f64,
    /// A sample that moves less than this proves nothing, metres: it maps onto its own neighbourhood.
    pub informative_distance: f64,
    /// Least informative support of a plane. It only excludes "nothing lands anywhere": right planes go down to 0.04.
    pub plane_support: f64,
    /// Least informative support of an axis or sphere; they make stronger claims.
    pub axis_support: f64,
    /// Violation and contradiction that a plane may have per informative support. Larger: approximate symmetry passes, wrong planes too.
    pub plane_ratio: f64,
    /// The same for axes and spheres. Larger than for planes, since handles and spouts are sorted out sample by sample later.
    pub axis_ratio: f64,
    /// Opposition allowed whatever the support.
    pub slack: f64,
    /// Opposition allowed of the felt samples alone, for planes. Larger: touches that contradict a plane are outvoted by what is seen. A right
    /// plane has a few hundredths, an approximate one a tenth.
    pub felt_opposition: f64,
    /// The same for axes, of those whose samples land beside the surface more than a little: a touched handle violates an axis that is right,
    /// but contradicts nothing. Larger: wrong axes outvote the touches.
    pub axis_felt_opposition: f64,
    /// Opposition allowed of a sphere. Larger: lemons pass as balls. Balls have at most 0.008.
    pub sphere_opposition: f64,
    /// Opposition allowed of the plane half way up, which needs no support; larger: objects that are not alike above and below pass.
    /// Right ones have at most 0.02, wrong ones with little support at least 0.05.
    pub resting_slack: f64,
    /// Further opposition allowed to it per informative support.
    pub resting_ratio: f64,
    /// Share of the samples that look at the object itself from which it is a vessel, which is not alike above and below. Larger: cups pass
    /// as tubes. Cups have 0.2 and more, tools with loops up to 0.1.
    pub hollowness: f64,
    /// Share of samples that may leave a body of revolution: handles and spouts. Larger: boxes with a square base pass as cylinders.
    pub misfits: f64,
    /// At most this many planes are accepted: composed, more add nothing.
    pub planes: usize,
}

impl Default for SymmetryParams {
    fn default() -> Self {
        Self {
            seed: 0,
            directions: 200,
            horizontal_directions: 60,
            offsets: 22,
            search_samples: 250,
            refine_samples: 800,
            plane_candidates: 14,
            axis_candidates: 4,
            violation_tolerance: 0.0015,
            violation_range: 0.008,
            support_tolerance: 0.002,
            informative_distance: 0.012,
            plane_support: 0.04,
            axis_support: 0.15,
            plane_ratio: 0.15,
            axis_ratio: 0.25,
            slack: 0.01,
            felt_opposition: 0.25,
            axis_felt_opposition: 0.1,
            sphere_opposition: 0.015,
            resting_slack: 0.02,
            resting_ratio: 0.06,
            hollowness: 0.15,
            misfits: 0.35,
            planes: 4,
        }
    }
}

impl SymmetryParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`SymmetryError::Parameter`] names the first field that is out of range.
    pub fn validate(&self) -> Result<(), SymmetryError> {
        let lengths = [
            ("violation_tolerance", self.violation_tolerance),
            ("violation_range", self.violation_range),
            ("support_tolerance", self.support_tolerance),
            ("informative_distance", self.informative_distance),
        ];
        for (field, value) in lengths {
            if !(value.is_finite() && value > 0.0) {
                return Err(SymmetryError::Parameter { field, value, rule: "finite and above 0" });
            }
        }
        let shares = [
            ("plane_support", self.plane_support),
            ("axis_support", self.axis_support),
            ("plane_ratio", self.plane_ratio),
            ("axis_ratio", self.axis_ratio),
            ("slack", self.slack),
            ("felt_opposition", self.felt_opposition),
            ("axis_felt_opposition", self.axis_felt_opposition),
            ("sphere_opposition", self.sphere_opposition),
            ("resting_slack", self.resting_slack),
            ("resting_ratio", self.resting_ratio),
            ("hollowness", self.hollowness),
            ("misfits", self.misfits),
        ];
        for (field, value) in shares {
            if !(0.0..=1.0).contains(&value) {
                return Err(SymmetryError::Parameter { field, value, rule: "from 0 to 1" });
            }
        }
        let counts = [
            ("directions", self.directions),
            ("offsets", self.offsets),
            ("search_samples", self.search_samples),
            ("refine_samples", self.refine_samples),
        ];
        for (field, count) in counts {
            if !(1..=100_000).contains(&count) {
                return Err(SymmetryError::Parameter { field, value: count as f64, rule: "from 1 to 100000" });
            }
        }
        Ok(())
    }
}
