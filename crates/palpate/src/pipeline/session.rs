//! An object that is touched while it is being reconstructed: each touch changes the mesh where it tells something new.

use super::fused::{self, Kept};
use super::reconstruct::{SettledTouch, Stages, Warning, felt_cloud, mesh_warnings};
use super::trust::{covariance, is_uncertain, stated_sigma, width};
use super::uncertainty::{VertexKnowledge, knowledge_where};
use super::vertices::{Places, same_vertices};
use super::{Method, ReconstructError, ReconstructParams, Reconstruction, Surface, color, stages as step};
use crate::completion::{objections, refine_touch};
use crate::geometry::{Aabb, Point, Vector};
use crate::scene::Scene;
use crate::surface::WeightedSample;
use crate::symmetry::{EvidenceSearch, Hypothesis, Rejection, contradicted};
use crate::tactile::{LiftError, Patch, Touch, lift};
use nalgebra::Matrix6;

/// How far round a place that a touch or a guess changes the surface may follow, metres; as much more as it is off there, up to this.
const RADII: [f64; 2] = [14e-3, 8e-3];
const FARTHEST: f64 = 8e-3;
/// A measured sample whose distance from the surface is less than this tells nothing new, metres; and a guess.
const AGREES: [f64; 2] = [0.1e-3, 0.3e-3];
/// Nor does a normal within this cosine of the surface's.
const ALIKE: f64 = 0.97;
/// The grid must reach this far beyond a new sample, metres.
const ROOM: f64 = 4e-3;
/// Depths behind untouched gel at which the surface is asked for, metres.
const BEHIND: [f64; 2] = [1e-3, 2.5e-3];

/// A reconstruction that goes on while touches come in.
///
/// [`Self::add_touch`] keeps the accepted symmetries and the solution, and solves again only where the touch, its free space or its copies
/// disagree with the surface. [`Self::settle`] starts again with all touches and gives the very same result as [`super::reconstruct`].
///
/// Departs from a reconstruction from the start, until it is settled: symmetries are not sought again nor refined; the carved grid does not
/// learn of the pads of new touches; earlier touches are not judged again.
pub struct Session<'a> {
    scene: Scene,
    params: ReconstructParams,
    stages: Stages<'a>,
    kept: Kept,
    result: Reconstruction,
    settled: bool,
    /// What is kept holds a part of a touch that could not be taken in.
    torn: bool,
}

/// What a touch did.
#[derive(Debug, Clone)]
pub struct Update {
    /// Index of the touch in the order taken.
    pub touch: usize,
    /// How it was taken in.
    pub followed: Followed,
    /// Boxes in which the surface may have changed, world frame, metres; all of the mesh's where it was started again.
    pub changed: Vec<Aabb>,
}

/// How a touch was taken in.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Followed {
    /// The surface was solved again where the touch disagrees with it.
    Locally,
    /// The touch was left out: nothing was felt, or it cannot be where it says.
    LeftOut {
        /// Why.
        reason: String,
    },
    /// It contradicts an accepted symmetry: started again.
    Contradicted {
        /// The symmetry as it was accepted.
        hypothesis: Box<Hypothesis>,
        /// Why it is not accepted any more.
        rejection: Rejection,
    },
    /// With it an earlier touch is not believed any more: started again.
    AgainstTouch {
        /// That touch.
        touch: usize,
    },
    /// The object is so much larger than was thought that the grid must be coarser: started again.
    Outgrown,
}

/// Why to start again, or what is new.
enum Taken {
    Again(Followed),
    LeftOut(String),
    /// The first new sample of the averaged ones and of all measured ones.
    New([usize; 2]),
}

impl<'a> Session<'a> {
    /// Reconstructs the object with the touches it has.
    ///
    /// * `stages` – a decoder if touches come as images
    ///
    /// # Errors
    /// As [`super::reconstruct`]; [`ReconstructError::NotIncremental`] for another method or surface than `fused` and `implicit`.
    pub fn start(scene: Scene, params: &ReconstructParams, stages: Stages<'a>) -> Result<Self, ReconstructError> {
        if params.method != Method::Fused || params.surface() != Surface::Implicit {
            return Err(ReconstructError::NotIncremental);
        }
        let params = params.seeded()?;
        let (result, kept) = anew(&scene, &params, &stages)?;
        Ok(Self { scene, params, stages, kept, result, settled: true, torn: false })
    }

    /// The mesh as it is now, and what it was made from.
    pub fn reconstruction(&self) -> &Reconstruction {
        &self.result
    }

    /// Whether the result is that of a reconstruction from the start.
    pub fn is_settled(&self) -> bool {
        self.settled
    }

    /// Starts again with all touches.
    ///
    /// # Errors
    /// As [`super::reconstruct`]; the session is as it was.
    pub fn settle(&mut self) -> Result<(), ReconstructError> {
        (self.result, self.kept) = anew(&self.scene, &self.params, &self.stages)?;
        (self.settled, self.torn) = (true, false);
        Ok(())
    }

    /// Takes in one more touch.
    ///
    /// O(changed surface), and O(samples + vertices) look-ups of small cost; O(whole reconstruction) where it starts again.
    ///
    /// # Errors
    /// As [`super::reconstruct`]; the touch is not added.
    pub fn add_touch(&mut self, touch: Touch) -> Result<Update, ReconstructError> {
        let number = self.scene.touches.len();
        self.scene.touches.push(touch);
        let update = self.take_in(number);
        if update.is_err() {
            self.scene.touches.pop();
            if self.torn {
                self.settle()?;
            }
        }
        update
    }

    fn take_in(&mut self, number: usize) -> Result<Update, ReconstructError> {
        // Feel, and doubt: as from the start, but only the new touch.
        self.stages.begin("feel");
        let patch = match self.feel(number)? {
            Ok(patch) => patch,
            Err(reason) => return Ok(self.left_out(number, reason)),
        };
        let (patch, covariance) = self.refined(patch);
        self.stages.begin("judge");
        if let Some(reason) = self.cannot_be(&patch) {
            return Ok(self.left_out(number, reason));
        }
        match self.know(number, patch, &covariance) {
            Taken::LeftOut(reason) => Ok(self.left_out(number, reason)),
            Taken::Again(followed) => {
                self.torn = true;
                self.settle()?;
                let changed = self.result.mesh.bounds().into_iter().collect();
                Ok(Update { touch: number, followed, changed })
            }
            Taken::New(from) => {
                let changed = self.fuse(from);
                self.settled = false;
                Ok(Update { touch: number, followed: Followed::Locally, changed })
            }
        }
    }

    /// The touch as a patch, or why there is none.
    fn feel(&self, number: usize) -> Result<Result<Patch, String>, ReconstructError> {
        let sensor = self.scene.sensor.as_ref().ok_or(ReconstructError::NoSensor { touches: number + 1 })?;
        let touch = &self.scene.touches[number];
        let contact = step::contact_of(touch, self.stages.decoder, sensor)
            .map_err(|source| ReconstructError::Decode { touch: number, source })?;
        match lift(&contact, sensor, &touch.world_from_sensor, &self.params.lift) {
            Ok(patch) => Ok(Ok(patch)),
            Err(nothing @ LiftError::NoSurface { .. }) => Ok(Err(nothing.to_string())),
            Err(source) => Err(ReconstructError::Lift { touch: number, source }),
        }
    }

    /// The patch in its refined pose, where poses are uncertain, and the covariance of that.
    fn refined(&self, patch: Patch) -> (Patch, Matrix6<f64>) {
        let stated = stated_sigma(&self.scene, &self.params);
        if !(self.params.touches.refine && is_uncertain(&stated)) {
            return (patch, covariance(&stated));
        }
        let known: Vec<Matrix6<f64>> = self.result.touches.iter().map(|t| t.covariance).collect();
        let copies = (&self.kept.moved.copyings[..], self.kept.guesses.sigma());
        let pose = &self.params.touches.pose;
        let fit = refine_touch(&self.kept.evidence, (&self.kept.patches, &known), &patch, copies, &stated, pose);
        (fit.patch, fit.covariance)
    }

    /// Why a touch cannot be of this object or where it says.
    fn cannot_be(&self, patch: &Patch) -> Option<String> {
        let touches = &self.params.touches;
        let bounds = self.result.visible.bounds();
        let far = bounds.and_then(|b| step::too_far(patch, &b, touches.max_diagonals * b.diagonal()));
        far.or_else(|| step::in_the_open(patch, &self.kept.evidence, touches.max_in_free_space))
    }

    /// Adds the touch to the evidence and its copies to the guesses, unless that calls for a new start.
    fn know(&mut self, number: usize, patch: Patch, covariance: &Matrix6<f64>) -> Taken {
        let Kept { evidence, patches, moved, guesses, field, .. } = &mut self.kept;
        patches.push(patch);
        let touch = SettledTouch {
            touch: number,
            world_from_sensor: patches[patches.len() - 1].world_from_sensor,
            covariance: *covariance,
        };
        self.result.touches.push(touch);
        if self.params.touches.judge {
            let widths: Vec<_> = self.result.touches.iter().map(|t| width(&t.covariance)).collect();
            let copies = (&moved.copyings[..], guesses.sigma());
            let found = objections(evidence, patches, copies, &widths, &self.params.touches.check);
            if let Some(Some(objection)) = found.last() {
                patches.pop();
                self.result.touches.pop();
                return Taken::LeftOut(objection.to_string());
            }
            if let Some(against) = found.iter().position(Option::is_some) {
                return Taken::Again(Followed::AgainstTouch { touch: self.result.touches[against].touch });
            }
        }
        self.stages.begin("evidence");
        let last = patches.len() - 1;
        let from = evidence.add_touch(&patches[last], last as u32, covariance, &self.params.evidence);
        let new = evidence.samples[from[0]..].iter().map(|s| &s.position);
        if !field.as_mut().is_some_and(|f| f.reach(new, ROOM, &self.params.implicit)) {
            return Taken::Again(Followed::Outgrown);
        }
        self.stages.begin("symmetry");
        if let Some((i, rejection)) = contradicted(evidence, &self.result.symmetry, &self.params.symmetry) {
            let hypothesis = Box::new(self.result.symmetry.accepted[i].clone());
            return Taken::Again(Followed::Contradicted { hypothesis, rejection });
        }
        Taken::New(from)
    }

    /// Moves the new samples, solves where they or the pad disagree with the surface, and brings the result up to date.
    fn fuse(&mut self, from: [usize; 2]) -> Vec<Aabb> {
        self.stages.begin("move");
        let params = &self.params;
        let Kept { evidence, moved, guesses, measured, .. } = &mut self.kept;
        let change = moved.follow(evidence, from[0], &params.orbit);
        guesses.extend(&moved.kept[change.added..]);
        measured.extend(evidence.measured[from[1]..].iter().map(|s| fused::weighted(s, &params.weight)));
        let guessed = fused::guessed_samples(moved, params.orbit.orientation);

        self.stages.begin("fuse");
        let disagreeing = self.disagreeing(from[0], change.added);
        let Kept { evidence, measured, moved, field, .. } = &mut self.kept;
        let changed = field.as_mut().map_or_else(Vec::new, |field| {
            fused::with_problem(evidence, measured, &guessed, |problem| {
                field.update(problem, &disagreeing, &params.implicit)
            })
        });
        self.stages.begin("extract");
        let new = evidence.samples[from[0]..].iter().chain(&moved.kept[change.added..]).map(|s| s.position).collect();
        self.renew(&guessed, new, &changed);
        changed
    }

    /// Where the new samples or the untouched gel of the last touch disagree with the surface, and how far round that it may follow.
    fn disagreeing(&self, measured_from: usize, guessed_from: usize) -> Vec<(Point, f64)> {
        let Some(field) = &self.kept.field else { return Vec::new() };
        let h = 0.5 * field.spacing();
        let off = |p: &Point, n: &Vector, allowed: f64| {
            let slope = (field.signed_distance(&(p + n * h)) - field.signed_distance(&(p - n * h))) / (2.0 * h);
            field.signed_distance(p).abs() > allowed || slope < ALIKE
        };
        let measured = self.kept.evidence.samples[measured_from..].iter();
        let guessed = self.kept.moved.kept[guessed_from..].iter();
        let place = |p: Point, radius: f64| (p, radius + field.signed_distance(&p).abs().min(FARTHEST));
        let mut places: Vec<(Point, f64)> =
            measured.filter(|s| off(&s.position, &s.normal, AGREES[0])).map(|s| place(s.position, RADII[0])).collect();
        let guessed = guessed.filter(|s| field.signed_distance(&s.position).abs() > AGREES[1]);
        places.extend(guessed.map(|s| place(s.position, RADII[1])));
        if let Some(patch) = self.kept.patches.last() {
            let press = patch.world_from_sensor * Vector::z();
            let free = &self.kept.evidence.free_space;
            let behind = patch.clearance.iter().flat_map(|p| BEHIND.map(|d| p - press * d));
            let inside = behind.filter(|p| field.signed_distance(p) < free.pad_clearance(p) - AGREES[0]);
            places.extend(inside.map(|p| place(p, RADII[0])));
        }
        places
    }

    /// Mesh, clouds and what is known of the vertices, after the field has changed.
    fn renew(&mut self, guessed: &[WeightedSample], new: Vec<Point>, changed: &[Aabb]) {
        let Kept { visible, evidence, patches, moved, guesses, measured, field } = &self.kept;
        let Some(mesh) = field.as_ref().map(crate::surface::ImplicitField::extract) else { return };
        self.stages.begin("doubt");
        let before = std::mem::replace(&mut self.result.mesh, mesh);
        let mesh = &mut self.result.mesh;
        if let Some(known) = &self.result.knowledge {
            let same = same_vertices(mesh, &before);
            let near = mesh.bounds().map(|b| Places::near(new.iter(), &b));
            let fresh =
                |p: &Point| near.as_ref().is_none_or(|near| near.holds(p)) || changed.iter().any(|b| b.contains(p));
            let take = |i: usize| if fresh(&mesh.vertices[i]) { None } else { same[i].map(|old| known.terms[old]) };
            self.result.knowledge = Some(knowledge_where(mesh, evidence, guesses, take));
        }
        let knowledge = self.result.knowledge.as_ref();
        mesh.colors = color::paint(mesh, self.params.color, knowledge, &self.scene.frame, visible, guesses);
        let of_the_mesh = |w: &Warning| {
            matches!(w, Warning::Extrapolated { .. } | Warning::Open | Warning::Large { .. } | Warning::Handles { .. })
        };
        self.result.warnings.retain(|w| !of_the_mesh(w));
        self.result.warnings.extend(mesh_warnings(mesh));
        self.result.warnings.extend(knowledge.and_then(VertexKnowledge::warning));
        self.result.felt = felt_cloud(patches);
        self.result.moved = fused::sample_cloud(&moved.kept);
        self.result.removed = fused::sample_cloud(&moved.contradicted);
        self.result.joined = fused::weighted_cloud(measured.iter().chain(guessed));
        self.result.touches_used = self.result.touches.len();
    }

    fn left_out(&mut self, touch: usize, reason: String) -> Update {
        self.result.warnings.push(Warning::TouchLeftOut { touch, reason: reason.clone() });
        Update { touch, followed: Followed::LeftOut { reason }, changed: Vec::new() }
    }
}

fn anew(
    scene: &Scene,
    params: &ReconstructParams,
    stages: &Stages,
) -> Result<(Reconstruction, Kept), ReconstructError> {
    let search = EvidenceSearch { params: params.symmetry };
    let symmetry = Some(stages.symmetry.unwrap_or(&search));
    fused::reconstruct(scene, params, &Stages { symmetry, ..*stages })
}
