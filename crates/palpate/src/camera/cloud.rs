use super::fragments::{convex_hull, footprint, share_inside};
use super::support::{Support, Up, support_candidates};
use super::{SegmentError, SegmentParams};
use crate::geometry::{
    KdTree, Plane, PlaneRansac, Point, PointCloud, cluster_sizes, estimate_normals, euclidean_clusters,
    statistical_outliers,
};

/// Neighbours of a normal and of the outlier test.
const NEIGHBOURS: usize = 16;
/// A cluster stands on the plane if its lowest points come this near, metres.
const STANDING_GAP: f64 = 0.03;

/// An object cut out of a cloud.
#[derive(Debug, Clone)]
pub struct CleanCloud {
    /// The object's points; colours as they were. Normals face the viewpoint unless they were recorded.
    pub cloud: PointCloud,
    /// The plane it stands on, if one was found.
    pub support: Option<Plane>,
}

/// Cuts the object out of a cloud of a sensor: support plane, clusters, outliers, normals (recorded ones are kept).
///
/// Of the groups that stand on the plane the largest is kept; without a plane, the largest of all. Pixel quantities of `params`
/// count points here, and `pick` is not used. Points that are not finite are left out.
///
/// * `viewpoint` – of the sensor, in the cloud's frame
///
/// # Errors
/// [`SegmentError::NoObject`] if a plane is seen but nothing stands on it; [`SegmentError::TooFewPoints`].
pub fn clean_cloud(cloud: &PointCloud, viewpoint: &Point, params: &SegmentParams) -> Result<CleanCloud, SegmentError> {
    params.validate()?;
    let finite = cloud.filtered(|i| cloud.points[i].iter().all(|c| c.is_finite()));
    require(finite.len(), params.min_pixels, "leaving out points that are not finite")?;
    // Planes are oriented towards the origin: put the sensor there.
    let centred: Vec<Point> = finite.points.iter().map(|p| Point::from(p - viewpoint)).collect();
    let link = params.link_distance.max(3.0 * spacing(&centred));
    let (kept, support) = object_points(&centred, link, params)?;
    let object = finite.filtered(|i| kept[i]);
    let outliers = statistical_outliers(&object.points, NEIGHBOURS, params.outlier_sigmas);
    let mut object = object.filtered(|i| !outliers[i]);
    require(object.len(), params.min_pixels, "removing outliers")?;
    let recorded = object.normals.as_ref().is_some_and(|n| n.iter().all(|n| (n.norm() - 1.0).abs() < 0.01));
    if !recorded {
        object.normals = Some(estimate_normals(&object.points, NEIGHBOURS, viewpoint));
    }
    let support = support
        .map(|s| Plane { normal: s.plane.normal, offset: s.plane.offset + s.plane.normal.dot(&viewpoint.coords) });
    Ok(CleanCloud { cloud: object, support })
}

fn require(found: usize, needed: usize, stage: &'static str) -> Result<(), SegmentError> {
    if found < needed { Err(SegmentError::TooFewPoints { found, needed, stage }) } else { Ok(()) }
}

/// Median distance to the nearest neighbour, on a sample.
fn spacing(points: &[Point]) -> f64 {
    let tree = KdTree::new(points);
    let step = (points.len() / 1000).max(1);
    let mut gaps: Vec<f64> =
        points.iter().step_by(step).filter_map(|p| tree.nearest_n(p, 2).get(1).map(|found| found.1)).collect();
    let middle = gaps.len() / 2;
    if gaps.is_empty() { 0.0 } else { *gaps.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

fn object_points(
    points: &[Point],
    link: f64,
    params: &SegmentParams,
) -> Result<(Vec<bool>, Option<Support>), SegmentError> {
    // Every point weighs the same: a cloud has no image centre.
    let pixels = vec![(0.0, 0.0); points.len()];
    let mut largest_group: Option<(usize, f64)> = None;
    for support in support_candidates(points, &pixels, Up::Unknown, (0.0, 0.0), params) {
        match standing_group(points, &support, link, params) {
            Ok(kept) => return Ok((kept, Some(support))),
            Err(found) => {
                let known = largest_group.map_or(0, |group| group.0);
                largest_group = Some((found.max(known), support.margin));
            }
        }
    }
    // The faces of an object that was cut out before are planes as well, but not all of it lies on one of them.
    if let Some((found, margin)) = largest_group
        && on_one_plane(points, params)
    {
        let min_height = params.min_height.max(2.0 * margin);
        return Err(SegmentError::NoObject { found, needed: params.min_pixels, min_height });
    }
    let labels = euclidean_clusters(points, link);
    let sizes = cluster_sizes(&labels);
    let (label, size) = sizes.iter().enumerate().fold((0, 0), |best, (l, &s)| if s > best.1 { (l, s) } else { best });
    require(size, params.min_pixels, "clustering")?;
    Ok((labels.iter().map(|&l| l as usize == label).collect(), None))
}

/// Whether over nine tenths of the points lie on a single plane.
fn on_one_plane(points: &[Point], params: &SegmentParams) -> bool {
    let ransac = PlaneRansac { tolerance: params.plane_tolerance, seed: params.seed, ..PlaneRansac::default() };
    ransac.fit(points, |_| true).is_some_and(|fit| fit.inliers * 10 > 9 * points.len())
}

/// The largest cluster that stands on the plane: high enough, touching down, over the plane's footprint. Else the size of the
/// largest that was looked at.
fn standing_group(points: &[Point], support: &Support, link: f64, params: &SegmentParams) -> Result<Vec<bool>, usize> {
    let heights: Vec<f64> = points.iter().map(|p| support.plane.signed_distance(p)).collect();
    let above: Vec<usize> = (0..points.len()).filter(|&i| heights[i] > support.margin).collect();
    let above_points: Vec<Point> = above.iter().map(|&i| points[i]).collect();
    let labels = euclidean_clusters(&above_points, link);
    let sizes = cluster_sizes(&labels);
    let on_plane: Vec<Point> =
        points.iter().zip(&heights).filter(|(_, h)| h.abs() <= support.margin).map(|(p, _)| *p).collect();
    let table = convex_hull(footprint(&on_plane, support));
    let high_from = params.min_height.max(2.0 * support.margin);
    let mut order: Vec<usize> = (0..sizes.len()).filter(|&l| sizes[l] >= params.min_pixels).collect();
    order.sort_by_key(|&label| std::cmp::Reverse(sizes[label]));
    let standing = order.into_iter().find(|&label| {
        let members: Vec<usize> = (0..above.len()).filter(|&k| labels[k] as usize == label).collect();
        let lowest = members.iter().map(|&k| heights[above[k]]).fold(f64::INFINITY, f64::min);
        let high = members.iter().filter(|&&k| heights[above[k]] > high_from).count();
        let member_points: Vec<Point> = members.iter().map(|&k| above_points[k]).collect();
        lowest < STANDING_GAP
            && high * 10 >= members.len()
            && share_inside(&footprint(&member_points, support), &table) > 0.5
    });
    let label = standing.ok_or_else(|| sizes.iter().copied().max().unwrap_or(0))?;
    let mut kept = vec![false; points.len()];
    for (k, &i) in above.iter().enumerate() {
        kept[i] = labels[k] as usize == label;
    }
    Ok(kept)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vector;

    /// A table at z = 0 seen from (0.3, 0, 0.6) and the upper half of a ball of 40 mm on it.
    fn table_with_ball(ball: bool) -> PointCloud {
        let mut points: Vec<Point> = (0..10_000)
            .map(|i| Point::new((i % 100) as f64 * 4e-3 - 0.2, (i / 100) as f64 * 4e-3 - 0.2, 0.0))
            .collect();
        if ball {
            points.retain(|p| p.coords.norm() > 0.04);
            let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
            points.extend((0..3000).map(|i| {
                let z = 1.0 - f64::from(i) / 3000.0;
                let (s, c) = (golden * f64::from(i)).sin_cos();
                Point::new(c * (1.0 - z * z).sqrt(), s * (1.0 - z * z).sqrt(), z) * 0.04
            }));
        }
        points.push(Point::new(f64::NAN, 0.0, 0.0));
        PointCloud { points, normals: None, colors: None }
    }

    #[test]
    fn the_ball_is_cut_from_its_table() {
        let eye = Point::new(0.3, 0.0, 0.6);
        let clean = clean_cloud(&table_with_ball(true), &eye, &SegmentParams::default()).expect("a ball");
        let support = clean.support.expect("a table");
        assert!((support.normal.into_inner() - Vector::z()).norm() < 1e-3 && support.offset.abs() < 1e-3);
        assert!(clean.cloud.points.iter().all(|p| (p.coords.norm() - 0.04).abs() < 1e-9));
        assert!(clean.cloud.len() > 2700, "{} of 3000 points", clean.cloud.len());
        let normals = clean.cloud.normals.expect("estimated");
        assert!(clean.cloud.points.iter().zip(&normals).all(|(p, n)| n.dot(&(eye - p)) >= 0.0));
    }

    #[test]
    fn clouds_without_an_object_are_errors() {
        let eye = Point::new(0.0, 0.0, 1.0);
        let params = SegmentParams::default();
        assert!(matches!(clean_cloud(&table_with_ball(false), &eye, &params), Err(SegmentError::NoObject { .. })));
        let one = PointCloud { points: vec![Point::origin()], normals: None, colors: None };
        assert!(matches!(
            clean_cloud(&one, &eye, &params),
            Err(SegmentError::TooFewPoints { found: 1, needed: 200, .. })
        ));
    }

    #[test]
    fn a_cut_out_box_keeps_all_its_faces() {
        let side: Vec<f64> = (0..30).map(|i| f64::from(i) * 2e-3).collect();
        let faces = side.iter().flat_map(|&a| {
            side.iter().flat_map(move |&b| [Point::new(a, b, 0.06), Point::new(a, 0.0, b), Point::new(0.0, a, b)])
        });
        let cloud = PointCloud { points: faces.collect(), normals: None, colors: None };
        let clean = clean_cloud(&cloud, &Point::new(-0.3, -0.3, 0.4), &SegmentParams::default()).expect("a box");
        assert!(clean.support.is_none() && clean.cloud.len() > 2600, "{} of 2700", clean.cloud.len());
    }
}
