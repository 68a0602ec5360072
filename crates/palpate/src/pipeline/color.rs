use super::uncertainty::{Guesses, VertexKnowledge, VertexProvenance};
use crate::camera::{Frame, Visible};
use crate::geometry::{KdTree, Point, TriangleMesh, Vector};
use crate::render::palette;
use serde::{Deserialize, Serialize};

/// What the vertices of the result are coloured by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ColorBy {
    /// No colours.
    #[default]
    None,
    /// σ: blue 0.2 mm and less, through green and yellow, to red 10 mm and more; logarithmic.
    Sigma,
    /// The colours of every picture ([`palette`]): seen blue grey, felt green, guessed orange, extrapolated grey.
    Provenance,
    /// The frame's image where it shows the surface, moved with the evidence where that was copied, else the nearest coloured vertex.
    Image,
}

/// Ends of the scale of σ, metres.
const SIGMA_RANGE: [f64; 2] = [2e-4, 10e-3];
/// Anchors of the scale of σ, evenly spaced: blue, cyan, green, yellow, red.
const RAMP: [[f64; 3]; 5] =
    [[49.0, 54.0, 149.0], [69.0, 160.0, 198.0], [120.0, 190.0, 90.0], [250.0, 205.0, 70.0], [190.0, 20.0, 40.0]];
/// A vertex this far behind the visible surface is not what its pixel shows, metres.
const SHOWN: f64 = 4e-3;

/// Colours for the vertices; `None` where none are asked for or what they need is missing.
pub(super) fn paint(
    mesh: &TriangleMesh,
    by: ColorBy,
    knowledge: Option<&VertexKnowledge>,
    frame: &Frame,
    visible: &Visible,
    guesses: &Guesses,
) -> Option<Vec<[u8; 3]>> {
    match by {
        ColorBy::None => None,
        ColorBy::Sigma => Some(knowledge?.sigma.iter().map(|s| sigma_color(*s)).collect()),
        ColorBy::Provenance => Some(knowledge?.provenance.iter().map(|p| provenance_color(*p)).collect()),
        ColorBy::Image => image_colors(mesh, frame, visible, guesses),
    }
}

/// What was missing for the colours asked for, if a mesh did not get them.
pub(super) fn missing(by: ColorBy, mesh: &TriangleMesh, frame: &Frame) -> Option<&'static str> {
    match by {
        _ if mesh.colors.is_some() => None,
        ColorBy::None => None,
        ColorBy::Sigma | ColorBy::Provenance => Some("the parameter 'uncertainty' is off"),
        ColorBy::Image if frame.color.is_none() => Some("the scene has no colour image"),
        ColorBy::Image => Some("the colour image shows no vertex"),
    }
}

/// Colour of a σ, metres; the same in every picture: blue 0.2 mm and less, red 10 mm and more.
pub fn sigma_color(sigma: f64) -> [u8; 3] {
    let [low, high] = SIGMA_RANGE;
    let at = ((sigma / low).ln() / (high / low).ln()).clamp(0.0, 1.0) * (RAMP.len() - 1) as f64;
    let below = (at.floor() as usize).min(RAMP.len() - 2);
    let t = at - below as f64;
    std::array::from_fn(|c| (RAMP[below][c] * (1.0 - t) + RAMP[below + 1][c] * t).round() as u8)
}

/// Colour of what a vertex rests on, the same in every picture.
pub fn provenance_color(provenance: VertexProvenance) -> [u8; 3] {
    match provenance {
        VertexProvenance::Seen => palette::SEEN,
        VertexProvenance::Felt => palette::FELT,
        VertexProvenance::Guessed => palette::GUESSED,
        VertexProvenance::Extrapolated => palette::EXTRAPOLATED,
    }
}

/// The image's colours; `None` if the frame has no image or shows no vertex.
fn image_colors(mesh: &TriangleMesh, frame: &Frame, visible: &Visible, guesses: &Guesses) -> Option<Vec<[u8; 3]>> {
    let image = frame.color.as_ref()?;
    let camera_from_world = frame.world_from_camera.inverse();
    let shown = |p: &Point| {
        let p = camera_from_world * p;
        let (u, v) = frame.camera.project(&p)?;
        if !(u > -0.5 && v > -0.5) {
            return None;
        }
        let (row, col) = ((v + 0.5) as usize, (u + 0.5) as usize);
        let z = f64::from(*visible.depth.get(row, col)?);
        ((p.z - z).abs() < SHOWN).then(|| image[(row, col)])
    };
    let eye = frame.world_from_camera * Point::origin();
    let normals = mesh.vertex_normals();
    let direct = |(p, n): (&Point, &Vector)| {
        let facing = n.dot(&(eye - p)) > 0.0;
        let own = if facing { shown(p) } else { None };
        own.or_else(|| shown(&guesses.source(p, n)?.0))
    };
    let known: Vec<Option<[u8; 3]>> = mesh.vertices.iter().zip(&normals).map(direct).collect();
    let (points, colors): (Vec<Point>, Vec<[u8; 3]>) =
        mesh.vertices.iter().zip(&known).filter_map(|(p, c)| Some((*p, (*c)?))).unzip();
    let tree = KdTree::new(&points);
    let nearest = |p: &Point| tree.nearest(p).map(|(i, _)| colors[i]);
    mesh.vertices.iter().zip(&known).map(|(p, c)| c.or_else(|| nearest(p))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn provenance_has_the_colours_of_every_picture() {
        let kinds = [0, 1, 2, 3].map(|n| VertexProvenance::from_number(n).expect("four kinds"));
        assert_eq!(
            kinds.map(provenance_color),
            [palette::SEEN, palette::FELT, palette::GUESSED, palette::EXTRAPOLATED]
        );
        assert_eq!(VertexProvenance::from_number(4), None);
    }

    #[test]
    fn the_scale_runs_from_blue_to_red_and_stays_there() {
        assert_eq!(sigma_color(0.0), sigma_color(2e-4));
        assert_eq!(sigma_color(1.0), [190, 20, 40]);
        assert_eq!(sigma_color(f64::INFINITY), [190, 20, 40]);
        let middle = (2e-4f64 * 10e-3).sqrt();
        assert_eq!(sigma_color(middle), [120, 190, 90]);
    }
}
