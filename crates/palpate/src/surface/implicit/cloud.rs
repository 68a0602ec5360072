use super::{ImplicitParams, ImplicitProblem, WeightedSample, solve_implicit};
use crate::geometry::{PointCloud, TriangleMesh};
use crate::surface::SurfaceError;
use crate::surface::poisson::wanted_cell;

const LEAST_POINTS: usize = 10;

/// The implicit surface of an oriented cloud about which nothing else is known: no free space, no guesses.
///
/// * `cell` – edge of the finest cells, metres; larger is smoother and faster. `None`: from spacing and noise of the points, as in
///   [`crate::surface::screened_poisson`]. Either takes the place of `params.spacing`, so that any scale works
///
/// # Errors
/// [`SurfaceError`] for a cloud without normals, with too few points, with coordinates or normals that are not finite, or for a cell that is not positive.
pub fn implicit_surface(
    cloud: &PointCloud,
    cell: Option<f64>,
    params: &ImplicitParams,
) -> Result<TriangleMesh, SurfaceError> {
    params.validate()?;
    let normals = cloud.normals.as_ref().ok_or(SurfaceError::NoNormals)?;
    if cloud.len() < LEAST_POINTS {
        return Err(SurfaceError::TooFewPoints { found: cloud.len(), needed: LEAST_POINTS });
    }
    let (mut measured, mut unit) = (Vec::with_capacity(cloud.len()), Vec::with_capacity(cloud.len()));
    for (index, (p, n)) in cloud.points.iter().zip(normals).enumerate() {
        if !p.iter().chain(n.iter()).all(|c| c.is_finite()) {
            return Err(SurfaceError::NotFinite { index });
        }
        let Some(normal) = n.try_normalize(1e-300) else {
            return Err(SurfaceError::ZeroNormal { index, length: n.norm() });
        };
        unit.push(normal);
        measured.push(WeightedSample { position: *p, normal, weight: 1.0, orientation: 1.0 });
    }
    let bounds = cloud.bounds().ok_or(SurfaceError::TooFewPoints { found: 0, needed: LEAST_POINTS })?;
    if let Some(cell) = cell.filter(|c| !(c.is_finite() && *c > 0.0)) {
        let rule = "must be positive and finite, metres";
        return Err(SurfaceError::InvalidParameter { field: "cell", value: cell.to_string(), rule });
    }
    let spacing = cell.unwrap_or_else(|| wanted_cell(&cloud.points, &unit));
    if !(spacing > 0.0 && spacing.is_finite()) {
        return Err(SurfaceError::TooFewPoints { found: 1, needed: LEAST_POINTS });
    }
    let mut params = params.clone();
    params.prior.winding_sample_spacing = (0.02 * bounds.diagonal()).max(spacing);
    params.prior.hull_margin = 0.02 * bounds.diagonal();
    params.spacing = spacing;
    let unknown = |_: &_| f64::NEG_INFINITY;
    let problem = ImplicitProblem {
        measured: &measured,
        guessed: &[],
        bounds: bounds.inflated(0.1 * bounds.diagonal() + 4.0 * spacing),
        free: &unknown,
        free_fine: &unknown,
    };
    let mesh = solve_implicit(&problem, &params).extract();
    if mesh.is_empty() {
        let reason = "the implicit function is nowhere negative".into();
        return Err(SurfaceError::NoSurface { points: cloud.len(), reason });
    }
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Topology, Vector};
    use crate::surface::testing::directions;

    #[test]
    fn a_ball_of_any_size_is_closed_and_of_the_right_volume() {
        for radius in [3e-6, 0.05, 2e3] {
            let normals = directions(3000);
            let points = normals.iter().map(|n| Point::from(n * radius)).collect();
            let cloud = PointCloud::with_normals(points, normals).expect("as many normals as points");
            let mesh = implicit_surface(&cloud, None, &ImplicitParams::of_cloud()).expect("a ball has a surface");
            assert!(Topology::of(&mesh).is_watertight());
            let volume = 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3);
            assert!((mesh.volume() / volume - 1.0).abs() < 0.02, "{} of {volume}", mesh.volume());
        }
    }

    #[test]
    fn the_cell_can_be_stated_and_must_be_sound() {
        let normals = directions(2000);
        let points = normals.iter().map(|n| Point::from(n * 0.05)).collect();
        let cloud = PointCloud::with_normals(points, normals).expect("as many normals as points");
        let faces = |cell| implicit_surface(&cloud, Some(cell), &ImplicitParams::of_cloud()).map(|m| m.faces.len());
        let (coarse, fine) = (faces(8e-3).expect("a surface"), faces(4e-3).expect("a surface"));
        assert!((3.5..4.5).contains(&(fine as f64 / coarse as f64)), "{coarse} {fine}");
        for cell in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(faces(cell), Err(SurfaceError::InvalidParameter { field: "cell", .. })));
        }
    }

    #[test]
    fn a_cloud_of_one_place_is_an_error() {
        let cloud = PointCloud::with_normals(vec![Point::origin(); 20], vec![Vector::z(); 20]).expect("equal numbers");
        assert!(implicit_surface(&cloud, None, &ImplicitParams::of_cloud()).is_err());
    }
}
