//! What a run did, as JSON and as one line.

use crate::progress::Timings;
use crate::say::count;
use palpate::geometry::{Topology, TriangleMesh};
use palpate::io::{self, SceneFile};
use palpate::pipeline::{ReconstructParams, Reconstruction, SettledTouch, VertexKnowledge, VertexProvenance};
use palpate::symmetry::{Hypothesis, SymmetryElement};
use serde_json::{Value, json};
use std::path::Path;

pub(crate) fn reconstruction(
    file: &SceneFile,
    result: &Reconstruction,
    params: &ReconstructParams,
    timings: &Timings,
) -> Value {
    let stages: Vec<Value> =
        timings.iter().map(|(name, seconds)| json!({ "stage": name, "seconds": seconds })).collect();
    let warnings: Vec<String> =
        file.warnings.iter().cloned().chain(result.warnings.iter().map(ToString::to_string)).collect();
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "scene": file.scene.name,
        "seed": params.seed,
        "timings": stages,
        "seconds": timings.iter().map(|t| t.1).sum::<f64>(),
        "counts": {
            "visible_points": result.visible.len(),
            "touches_in_scene": file.scene.touches.len(),
            "touches_used": result.touches_used,
            "felt_points": result.felt.len(),
            "guessed_points_kept": result.moved.len(),
            "guessed_points_removed": result.removed.len(),
            "vertices": result.mesh.vertices.len(),
            "faces": result.mesh.faces.len(),
        },
        "mesh": mesh(&result.mesh),
        "touches": result.touches.iter().map(touch).collect::<Vec<_>>(),
        "vertices": result.knowledge.as_ref().map(knowledge),
        "symmetry": {
            "accepted": result.symmetry.accepted.iter().map(hypothesis).collect::<Vec<_>>(),
            "rejected": result.symmetry.rejected.len(),
        },
        "warnings": warnings,
        "parameters": params,
    })
}

fn mesh(mesh: &TriangleMesh) -> Value {
    let topology = Topology::of(mesh);
    json!({
        "closed": topology.is_closed(),
        "genus": topology.genus(),
        "volume_cm3": mesh.volume() * 1e6,
        "area_cm2": mesh.area() * 1e4,
    })
}

/// A touch as it was used: its pose, refined where the scene states a σ, and the σ that remain.
fn touch(touch: &SettledTouch) -> Value {
    let pose = &touch.world_from_sensor;
    let sigma = |i: usize| touch.covariance[(i, i)].max(0.0).sqrt();
    json!({
        "touch": touch.touch,
        "world_from_sensor": {
            "translation": pose.translation.vector.as_slice(),
            "quaternion_xyzw": pose.rotation.coords.as_slice(),
        },
        "sigma_rotation": [sigma(0), sigma(1), sigma(2)],
        "sigma_translation": [sigma(3), sigma(4), sigma(5)],
    })
}

/// Shares of the vertices by what they rest on, and quantiles of σ in millimetres.
fn knowledge(k: &VertexKnowledge) -> Value {
    let count = k.provenance.len().max(1) as f64;
    let share = |p: VertexProvenance| k.provenance.iter().filter(|q| **q == p).count() as f64 / count;
    let quantile = |q: f64| palpate::metrics::quantile(&k.sigma, q).map(|s| 1e3 * s);
    json!({
        "seen": share(VertexProvenance::Seen),
        "felt": share(VertexProvenance::Felt),
        "guessed": share(VertexProvenance::Guessed),
        "extrapolated": share(VertexProvenance::Extrapolated),
        "sigma_mm": { "median": quantile(0.5), "q90": quantile(0.9), "max": quantile(1.0) },
    })
}

pub(crate) fn hypothesis(h: &Hypothesis) -> Value {
    let element = match &h.element {
        SymmetryElement::Reflection(plane) => {
            json!({ "kind": "reflection", "normal": plane.normal.as_slice(), "offset": plane.offset })
        }
        SymmetryElement::Axis { point, direction, order } => {
            json!({ "kind": "axis", "point": point.coords.as_slice(), "direction": direction.as_slice(), "order": order })
        }
        SymmetryElement::Sphere { center } => json!({ "kind": "sphere", "center": center.coords.as_slice() }),
    };
    json!({
        "element": element,
        "confidence": h.confidence,
        "score": h.score.value(),
        "support": h.score.support,
        "informative_support": h.score.informative,
        "violation": h.score.violation,
        "contradiction": h.score.contradiction,
        "neutral": h.score.neutral,
    })
}

pub(crate) fn write_json(path: &Path, value: &Value) -> anyhow::Result<()> {
    let mut text = serde_json::to_string_pretty(value)?;
    text.push('\n');
    io::write_text(path, &text)?;
    Ok(())
}

pub(crate) fn one_line(output: &Path, result: &Reconstruction, timings: &Timings) -> String {
    let genus = Topology::of(&result.mesh).genus().map_or_else(String::new, |genus| format!(", genus {genus}"));
    format!(
        "{}: {}, {:.1} cm³{genus}, {}, {}, {:.2} s",
        output.display(),
        count(result.mesh.faces.len(), "face", "faces"),
        result.mesh.volume() * 1e6,
        count(result.touches_used, "touch", "touches"),
        count(result.symmetry.accepted.len(), "symmetry", "symmetries"),
        timings.iter().map(|t| t.1).sum::<f64>()
    )
}
