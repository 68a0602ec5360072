//! The steps that both methods share.

use super::reconstruct::{Stages, Warning};
use super::{ReconstructError, ReconstructParams};
use crate::camera::Visible;
use crate::evidence::Evidence;
use crate::geometry::{Aabb, Point, Vector};
use crate::scene::Scene;
use crate::tactile::{Contact, DecodeError, LiftError, Patch, TactileDecoder, TactileSensor, Touch, lift};
use rayon::prelude::*;
use std::borrow::Cow;

/// Decodes and lifts the touches in use; contacts with nothing in them are left out.
pub(super) fn feel(
    scene: &Scene,
    params: &ReconstructParams,
    stages: &Stages,
    warnings: &mut Vec<Warning>,
) -> Result<Vec<(usize, Patch)>, ReconstructError> {
    let count = params.max_touches.unwrap_or(usize::MAX).min(scene.touches.len());
    if count == 0 {
        return Ok(Vec::new());
    }
    let sensor = scene.sensor.as_ref().ok_or(ReconstructError::NoSensor { touches: count })?;
    let decoder = stages.decoder;
    let touches = &scene.touches[..count];
    let contacts: Vec<_> = touches.par_iter().map(|touch| contact_of(touch, decoder, sensor)).collect();
    let mut patches = Vec::with_capacity(count);
    for (i, (touch, contact)) in touches.iter().zip(contacts).enumerate() {
        let contact = contact.map_err(|source| ReconstructError::Decode { touch: i, source })?;
        match lift(&contact, sensor, &touch.world_from_sensor, &params.lift) {
            Ok(patch) => patches.push((i, patch)),
            Err(nothing @ LiftError::NoSurface { .. }) => {
                warnings.push(Warning::TouchLeftOut { touch: i, reason: nothing.to_string() });
            }
            Err(source) => return Err(ReconstructError::Lift { touch: i, source }),
        }
    }
    Ok(patches)
}

/// What a touch recorded, or what its image shows.
pub(super) fn contact_of<'a>(
    touch: &'a Touch,
    decoder: Option<&dyn TactileDecoder>,
    sensor: &TactileSensor,
) -> Result<Cow<'a, Contact>, DecodeError> {
    match (&touch.contact, &touch.image, decoder) {
        (Some(contact), _, _) => Ok(Cow::Borrowed(contact)),
        (None, Some(image), Some(decoder)) => decoder.decode(image, sensor).map(Cow::Owned),
        _ => Err(DecodeError::NothingRecorded { decoder: "recorded" }),
    }
}

/// The scene with only its first `count` touches, each with the contact that it recorded or that its image shows.
///
/// For work that reads a scene's touches more than once, or without the pipeline.
///
/// # Errors
/// [`ReconstructError::NoSensor`], or [`ReconstructError::Decode`] with the touch.
pub fn with_contacts(
    scene: &Scene,
    count: usize,
    decoder: Option<&dyn TactileDecoder>,
) -> Result<Scene, ReconstructError> {
    let mut scene = scene.clone();
    scene.touches.truncate(count);
    if scene.touches.is_empty() {
        return Ok(scene);
    }
    let sensor = scene.sensor.as_ref().ok_or(ReconstructError::NoSensor { touches: scene.touches.len() })?;
    let contacts: Vec<_> =
        scene.touches.par_iter().map(|t| contact_of(t, decoder, sensor).map(Cow::into_owned)).collect();
    for (i, contact) in contacts.into_iter().enumerate() {
        scene.touches[i].contact = Some(contact.map_err(|source| ReconstructError::Decode { touch: i, source })?);
    }
    Ok(scene)
}

/// Gathers the evidence, leaving out touches that cannot be of this object: further off than its size, or in space that the
/// camera proves free. Patches come with the touch's number in the order taken.
pub(super) fn gather(
    scene: &Scene,
    visible: &Visible,
    mut patches: Vec<(usize, Patch)>,
    params: &ReconstructParams,
    warnings: &mut Vec<Warning>,
) -> Result<(Evidence, Vec<(usize, Patch)>), ReconstructError> {
    let seen = visible.cloud(&scene.frame);
    if let Some(bounds) = seen.bounds() {
        let reach = params.touches.max_diagonals * bounds.diagonal();
        patches.retain(|(touch, patch)| {
            let reason = too_far(patch, &bounds, reach);
            let kept = reason.is_none();
            warnings.extend(reason.map(|reason| Warning::TouchLeftOut { touch: *touch, reason }));
            kept
        });
    }
    let mut evidence_params = params.evidence;
    evidence_params.pose_sigma_translation = evidence_params.pose_sigma_translation.max(scene.pose_sigma.translation);
    evidence_params.pose_sigma_rotation = evidence_params.pose_sigma_rotation.max(scene.pose_sigma.rotation);
    let gather = |patches: &[(usize, Patch)]| {
        let patches: Vec<Patch> = patches.iter().map(|(_, p)| p.clone()).collect();
        Evidence::gather(&scene.frame, visible, &patches, &evidence_params)
    };
    let evidence = gather(&patches)?;
    let before = patches.len();
    patches.retain(|(touch, patch)| {
        let reason = in_the_open(patch, &evidence, params.touches.max_in_free_space);
        let kept = reason.is_none();
        warnings.extend(reason.map(|reason| Warning::TouchLeftOut { touch: *touch, reason }));
        kept
    });
    let evidence = if patches.len() == before { evidence } else { gather(&patches)? };
    Ok((evidence, patches))
}

/// Why a touch is too far from what is seen to be of this object, if it is.
///
/// * `reach` – allowed from the box of the visible side, metres
pub(super) fn too_far(patch: &Patch, visible: &Aabb, reach: f64) -> Option<String> {
    let middle = patch.points.iter().map(|p| p.coords).sum::<Vector>();
    let middle = Point::from(middle / patch.points.len() as f64);
    let off = (middle - middle.inf(&visible.max).sup(&visible.min)).norm();
    let reason = || format!("it is {:.0} mm from the visible side, {:.0} mm are allowed", 1e3 * off, 1e3 * reach);
    (off > reach).then(reason)
}

/// Why a touch cannot be where the camera looks through, if half of it lies deeper there than allowed (metres).
pub(super) fn in_the_open(patch: &Patch, evidence: &Evidence, allowed: f64) -> Option<String> {
    let mut depths: Vec<f64> = patch.points.iter().map(|p| evidence.free_space.clearance(p)).collect();
    let middle = depths.len() / 2;
    let depth = *depths.select_nth_unstable_by(middle, f64::total_cmp).1;
    (depth > allowed).then(|| format!("it lies {:.0} mm inside space that the camera proves free", 1e3 * depth))
}
