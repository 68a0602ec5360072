use super::{Belief, Candidate, EvidenceDistance, ExploreError, ExploreParams, Planner, Policy, rank};
use crate::geometry::{Isometry, Point, Raster, Topology, TriangleMesh};
use crate::metrics::{Comparison, TruthReference};
use crate::pipeline::{ReconstructParams, Reconstruction, Stages, reconstruct};
use crate::scene::Scene;
use crate::simulate::{SimulateParams, TouchParams, simulate_scene};
use crate::tactile::{Contact, Touch};
use rayon::prelude::*;

/// The state after a number of touches.
#[derive(Debug, Clone)]
pub struct Step {
    /// Touches made, misses included.
    pub touches: usize,
    /// Those that touched nothing.
    pub misses: usize,
    /// Pose of the sensor at the last touch; none before the first.
    pub world_from_sensor: Option<Isometry>,
    /// The mesh against the truth.
    pub comparison: Comparison,
}

/// An object to be explored: its truth, and what the camera sees of it.
pub struct Trial<'a> {
    params: &'a ExploreParams,
    truth: TruthReference,
    scene: Scene,
    planner: Planner,
}

/// Where a policy stands.
struct State {
    scene: Scene,
    current: Reconstruction,
    /// Where touches were made, misses included.
    touched: Vec<Point>,
    /// Where nothing was touched.
    missed: Vec<Point>,
}

impl<'a> Trial<'a> {
    /// Simulates the view of a closed mesh by the benchmark's protocol.
    ///
    /// # Errors
    /// [`ExploreError::Open`] for an open mesh, others for a parameter out of range.
    pub fn new(object: &str, mesh: &TriangleMesh, params: &'a ExploreParams) -> Result<Self, ExploreError> {
        params.plan.validate()?;
        if params.touches == 0 {
            return Err(ExploreError::Params { field: "touches", found: 0.0, needed: "at least 1" });
        }
        let topology = Topology::of(mesh);
        if !topology.is_closed() && !mesh.is_empty() {
            return Err(ExploreError::Open { name: object.to_owned(), boundary_edges: topology.boundary_edges });
        }
        let simulate = SimulateParams {
            view: params.view,
            seed: params.seed,
            camera: params.camera.clone(),
            touch: TouchParams {
                count: 0,
                sensor: params.plan.sensor.clone(),
                map_width: params.map_width,
                press: params.plan.press.clone(),
                ..TouchParams::default()
            },
        };
        let sensor = simulate.touch.validate()?;
        let made = simulate_scene(object, mesh, &simulate)?;
        let scene = Scene { sensor: Some(sensor), ..made.scene };
        let planner = Planner::new(&scene, &params.plan)?;
        Ok(Self { params, truth: TruthReference::new(&made.truth, &params.compare)?, scene, planner })
    }

    /// Plays the loop; the first entry is the state before any touch. Ends early if nothing more can be reached.
    ///
    /// At each step every policy chooses among candidates that are drawn alike on its own current mesh; a touch that misses counts.
    ///
    /// * `on_step` – called after each step
    ///
    /// # Errors
    /// If the object cannot be reconstructed or judged, or nothing can be reached from the first.
    pub fn run(&self, policy: Policy, on_step: &(dyn Fn() + Sync)) -> Result<Vec<Step>, ExploreError> {
        let current = reconstruct(&self.scene, self.reconstruct_params(), &Stages::default())?;
        let mut state = State { scene: self.scene.clone(), current, touched: Vec::new(), missed: Vec::new() };
        let mut steps = vec![self.judge(&state, None)?];
        on_step();
        for step in 1..=self.params.touches {
            let seed = self.params.seed.wrapping_mul(0x2545_f491_4f6c_dd1d).wrapping_add(step as u64);
            let plan = &self.params.plan;
            let pool = self.planner.candidates(&state.current.mesh, plan.candidates, seed, &state.missed);
            let candidates = match pool {
                Ok(candidates) => candidates,
                Err(ExploreError::NothingReachable { .. }) if step > 1 => break,
                Err(error) => return Err(error),
            };
            let pose = self.touch(&mut state, candidates, policy)?;
            steps.push(self.judge(&state, Some(pose))?);
            on_step();
        }
        Ok(steps)
    }

    fn reconstruct_params(&self) -> &ReconstructParams {
        &self.params.plan.reconstruct
    }

    fn judge(&self, state: &State, world_from_sensor: Option<Isometry>) -> Result<Step, ExploreError> {
        Ok(Step {
            touches: state.touched.len(),
            misses: state.missed.len(),
            world_from_sensor,
            comparison: self.truth.compare(&state.current.mesh)?,
        })
    }

    /// Chooses, presses, reconstructs. Returns where the sensor was.
    fn touch(&self, state: &mut State, candidates: Vec<Candidate>, policy: Policy) -> Result<Isometry, ExploreError> {
        let chosen = match policy {
            Policy::Random => 0,
            Policy::Even => farthest(&candidates, &state.touched),
            Policy::NextBest => self.next_best(state, &candidates)?,
            Policy::Oracle => self.oracle(state, &candidates)?,
        };
        let (touch, hit) = self.press(&candidates[chosen]);
        let pose = touch.world_from_sensor;
        state.touched.push(candidates[chosen].point);
        if hit {
            state.scene.touches.push(touch);
            state.current = reconstruct(&state.scene, self.reconstruct_params(), &Stages::default())?;
        } else {
            state.missed.push(candidates[chosen].point);
        }
        Ok(pose)
    }

    fn next_best(&self, state: &State, candidates: &[Candidate]) -> Result<usize, ExploreError> {
        let belief_params = &self.params.plan.belief;
        let uncertainty = EvidenceDistance::new(&state.current, belief_params);
        let belief = Belief::new(&state.scene, &state.current, self.reconstruct_params(), belief_params, &uncertainty)?;
        let best = rank(belief, candidates.to_vec(), 1, &[]);
        let at = best.first().map(|b| b.candidate.point);
        Ok(candidates.iter().position(|c| Some(c.point) == at).unwrap_or(0))
    }

    /// The candidate after whose true press the mesh is closest to the truth; the first of equals.
    fn oracle(&self, state: &State, candidates: &[Candidate]) -> Result<usize, ExploreError> {
        let error = |candidate: &Candidate| -> Result<f64, ExploreError> {
            let (touch, hit) = self.press(candidate);
            if !hit {
                return Ok(self.truth.compare(&state.current.mesh)?.distances.chamfer_mean_mm);
            }
            let mut scene = state.scene.clone();
            scene.touches.push(touch);
            let mesh = reconstruct(&scene, self.reconstruct_params(), &Stages::default())?.mesh;
            Ok(self.truth.compare(&mesh)?.distances.chamfer_mean_mm)
        };
        let errors: Vec<f64> = candidates.par_iter().map(error).collect::<Result<_, _>>()?;
        Ok((0..errors.len()).min_by(|&a, &b| errors[a].total_cmp(&errors[b])).unwrap_or(0))
    }

    /// The touch that a guarded move along a candidate's approach makes, and whether it touches anything.
    fn press(&self, candidate: &Candidate) -> (Touch, bool) {
        let cols = self.params.map_width;
        if let Ok(pressed) = self.planner.guarded_press(self.truth.mesh(), candidate, cols) {
            let (contact, world_from_sensor) = (Some(pressed.contact), pressed.world_from_sensor);
            return (Touch { contact, image: None, world_from_sensor }, true);
        }
        let sensor = self.planner.sensor();
        let rows = sensor.map_rows(cols);
        let mask = Raster::filled(rows, cols, false);
        let contact = Some(Contact { height_map: sensor.relaxed(rows, cols), mask });
        (Touch { contact, image: None, world_from_sensor: candidate.world_from_aim }, false)
    }
}

/// The candidate farthest from all touches; the first if there are none.
fn farthest(candidates: &[Candidate], touched: &[Point]) -> usize {
    let away = |c: &Candidate| touched.iter().map(|t| (t - c.point).norm_squared()).fold(f64::INFINITY, f64::min);
    (0..candidates.len())
        .max_by(|&a, &b| away(&candidates[a]).total_cmp(&away(&candidates[b])).then(b.cmp(&a)))
        .unwrap_or(0)
}

/// Simulates an object's view and plays the loop with one policy.
///
/// # Errors
/// As [`Trial::new`] and [`Trial::run`].
pub fn explore(
    object: &str,
    mesh: &TriangleMesh,
    policy: Policy,
    params: &ExploreParams,
) -> Result<Vec<Step>, ExploreError> {
    Trial::new(object, mesh, params)?.run(policy, &|| ())
}
