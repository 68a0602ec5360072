use super::distances::Distances;
use super::inside::InsideRule;
use super::truth::{CompareParams, Judged, TruthReference};
use super::volumetric_iou::{IouParams, iou_with_rules};
use crate::geometry::{Topology, TriangleMesh};
use serde::{Deserialize, Serialize};

/// Why two meshes could not be compared.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum MetricsError {
    /// Nothing to sample.
    #[error("the {what} mesh has no surface: {faces} faces, none with an area; at least 1 is needed")]
    NoSurface {
        /// Which mesh.
        what: &'static str,
        /// Its number of faces.
        faces: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex} of the {what} mesh is not finite")]
    NotFinite {
        /// Which mesh.
        what: &'static str,
        /// The first such vertex.
        vertex: usize,
    },
    /// A parameter is out of range.
    #[error("{field} is {value}, must be {rule}")]
    Parameter {
        /// The field.
        field: &'static str,
        /// Its value.
        value: usize,
        /// What it must be.
        rule: &'static str,
    },
}

/// A prediction judged against the truth. Serialises to the keys of `palpate compare --json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Distances over the whole surfaces.
    #[serde(flatten)]
    pub distances: Distances,
    /// Volume of the intersection over volume of the union; absent if a mesh is open.
    pub volumetric_iou: Option<f64>,
    /// What to know about the numbers, if anything.
    pub note: Option<String>,
    /// Every edge of the prediction has exactly two faces (corners joined by index or by position).
    pub watertight: bool,
    /// No edge of the prediction has three faces or more (corners joined by index).
    pub edge_manifold: bool,
    /// Parts of the prediction, joined by edges.
    pub components: usize,
    /// Triangles of the prediction.
    pub faces: usize,
    /// The side that the camera does not see, if a view was given.
    pub hidden: Option<HiddenSide>,
}

/// Distances on the truth's hidden side alone; a predicted sample belongs to it if its nearest truth point does.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HiddenSide {
    /// Share of the truth's area that the camera does not see.
    pub share: f64,
    /// Distances; absent if nothing is hidden or no predicted sample is nearest to the hidden side.
    #[serde(flatten)]
    pub distances: Option<Distances>,
}

/// Judges a predicted mesh against the truth, in the frame they come in.
///
/// Fast where many predictions have one truth: [`TruthReference::compare`].
///
/// # Errors
/// [`MetricsError`] if the parameters are out of range or a mesh has no area or a coordinate that is not finite.
pub fn compare(
    predicted: &TriangleMesh,
    truth: &TriangleMesh,
    params: &CompareParams,
) -> Result<Comparison, MetricsError> {
    TruthReference::new(truth, params)?.compare(predicted)
}

impl TruthReference {
    /// Judges a predicted mesh against this truth.
    ///
    /// # Errors
    /// [`MetricsError`] if the mesh has no area or a coordinate that is not finite.
    pub fn compare(&self, predicted: &TriangleMesh) -> Result<Comparison, MetricsError> {
        let judged = Judged::new(predicted, "predicted", &self.params)?;
        let (of_predicted, nearest) = self.surface.measure(&judged);
        let (of_truth, _) = judged.measure(&self.surface);
        let distances = Distances::new(&of_predicted, &of_truth).expect("both surfaces have samples");

        let hidden = self.params.viewpoint.as_ref().zip(self.hidden.as_ref()).map(|(view, truth_hidden)| {
            let predicted_hidden = self.surface.hidden_from(view, &nearest);
            let count = truth_hidden.iter().filter(|h| **h).count();
            HiddenSide {
                share: count as f64 / truth_hidden.len() as f64,
                distances: Distances::new(&of_predicted.filtered(&predicted_hidden), &of_truth.filtered(truth_hidden)),
            }
        });

        let rules = (judged.inside, self.surface.inside);
        let iou = IouParams { lines: self.params.iou_lines, seed: self.params.seed };
        let topology = Topology::of(predicted);
        Ok(Comparison {
            distances,
            volumetric_iou: iou_with_rules(predicted, rules.0, &self.surface.mesh, rules.1, &iou),
            note: note(rules.0, rules.1),
            watertight: judged.watertight,
            edge_manifold: topology.is_edge_manifold(),
            components: topology.components,
            faces: predicted.faces.len(),
            hidden,
        })
    }
}

fn note(predicted: InsideRule, truth: InsideRule) -> Option<String> {
    let open = match (predicted == InsideRule::Open, truth == InsideRule::Open) {
        (true, true) => "both meshes are",
        (true, false) => "the predicted mesh is",
        (false, true) => "the truth mesh is",
        (false, false) => {
            let mixed = predicted == InsideRule::Parity || truth == InsideRule::Parity;
            return mixed.then(|| {
                "faces are not consistently oriented: volumetric IoU by crossing parity, normal consistency unreliable"
                    .to_owned()
            });
        }
    };
    Some(format!("{open} open: no volumetric IoU"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::PinholeCamera;
    use crate::geometry::{Isometry, Point, Vector};
    use crate::metrics::Viewpoint;
    use crate::metrics::test_shapes::{cuboid, sphere_mesh};

    fn params() -> CompareParams {
        CompareParams { samples: 20_000, iou_lines: 4096, ..CompareParams::default() }
    }

    #[test]
    fn concentric_spheres_have_closed_form_distances() {
        // Radii 50 and 53 mm: every distance is 3 mm up to the facets' sagitta (below 0.02 mm at level 5).
        let c = compare(&sphere_mesh(0.053, 5), &sphere_mesh(0.05, 5), &params()).expect("both have area");
        for d in [c.distances.accuracy_mm, c.distances.completeness_mm, c.distances.hausdorff95_mm] {
            assert!((d - 3.0).abs() < 0.03, "{d}");
        }
        assert!((c.distances.chamfer_squared_mm2 - 18.0).abs() < 0.2);
        assert!((c.distances.chamfer_mean_mm - 3.0).abs() < 0.03);
        assert_eq!((c.distances.f_score_2mm, c.distances.f_score_5mm), (0.0, 1.0));
        assert!(c.distances.normal_consistency > 0.999);
        let iou = c.volumetric_iou.expect("both are closed");
        assert!((iou - (50.0f64 / 53.0).powi(3)).abs() < 2e-3, "{iou}");
        assert!(c.watertight && c.edge_manifold && c.components == 1 && c.note.is_none());
    }

    #[test]
    fn shifted_cube_distances_by_hand() {
        // Shift by d along x: the two faces across x are d away; on the four others only the strip that sticks out is off.
        let (side, d) = (0.1, 0.004);
        let cube = cuboid(Vector::repeat(side));
        let c = compare(&cube.transformed(&Isometry::translation(d, 0.0, 0.0)), &cube, &params()).expect("area");
        // Trailing face: inside by d (nearest point is the old face, d behind, but near the rim the side faces are nearer).
        let leading = d;
        let rim = |x: f64| x.min(d);
        let steps = 400;
        let trailing = (0..steps)
            .flat_map(|i| (0..steps).map(move |j| (i, j)))
            .map(|(i, j)| {
                let to_rim = |k: i32| {
                    let x = (f64::from(k) + 0.5) / f64::from(steps) * side;
                    x.min(side - x)
                };
                rim(to_rim(i).min(to_rim(j)))
            })
            .sum::<f64>()
            / f64::from(steps * steps);
        let strips = 4.0 * (d / side) * (d / 2.0);
        let expected = (leading + trailing + strips) / 6.0 * 1e3;
        assert!((c.distances.accuracy_mm / expected - 1.0).abs() < 0.01, "{} {expected}", c.distances.accuracy_mm);
    }

    #[test]
    fn open_mesh_gets_distances_and_a_note() {
        let cube = cuboid(Vector::repeat(0.1));
        let mut open = cube.clone();
        open.faces.truncate(10);
        let c = compare(&open, &cube, &params()).expect("both have area");
        assert_eq!(c.volumetric_iou, None);
        assert_eq!(c.note.as_deref(), Some("the predicted mesh is open: no volumetric IoU"));
        assert!(c.distances.accuracy_mm < 1e-9 && c.distances.completeness_mm > 1.0);
        assert!(!c.watertight && c.edge_manifold, "a hole has no edge of three faces");
    }

    #[test]
    fn hidden_side_of_a_box_seen_from_above() {
        // Camera 1 m above looking straight down at a cube: only the top face is seen. Rotation by π about x.
        let camera =
            PinholeCamera { width: 640, height: 480, fx: 500.0, fy: 500.0, cx: 319.5, cy: 239.5, distortion: [0.0; 5] };
        let down = Isometry::new(Vector::new(0.0, 0.0, 1.0), Vector::x() * std::f64::consts::PI);
        let viewpoint = Some(Viewpoint { camera, world_from_camera: down });
        let cube = cuboid(Vector::repeat(0.1));
        // Prediction: bottom 4 mm too low, the rest right.
        let mut low = cube.clone();
        for p in &mut low.vertices {
            *p = Point::new(p.x, p.y, if p.z < 0.0 { p.z - 0.004 } else { p.z });
        }
        let c = compare(&low, &cube, &CompareParams { viewpoint, ..params() }).expect("both have area");
        let hidden = c.hidden.expect("a view was given");
        assert!((hidden.share - 5.0 / 6.0).abs() < 1e-3, "{}", hidden.share);
        let distances = hidden.distances.expect("five faces are hidden");
        // The truth's top is exact: hidden completeness is the whole one's times 6/5.
        assert!((distances.completeness_mm / c.distances.completeness_mm - 1.2).abs() < 0.01);
        assert!(distances.accuracy_mm > c.distances.accuracy_mm * 1.15);
    }

    #[test]
    fn bad_input_is_named() {
        let cube = cuboid(Vector::repeat(0.1));
        let empty = TriangleMesh::default();
        let error = compare(&empty, &cube, &params()).expect_err("no face");
        assert_eq!(error, MetricsError::NoSurface { what: "predicted", faces: 0 });
        let mut nan = cube.clone();
        nan.vertices[3].y = f64::NAN;
        assert_eq!(compare(&cube, &nan, &params()), Err(MetricsError::NotFinite { what: "truth", vertex: 3 }));
        let none = CompareParams { samples: 0, ..params() };
        assert!(compare(&cube, &cube, &none).expect_err("0 samples").to_string().contains("samples is 0"));
    }
}
