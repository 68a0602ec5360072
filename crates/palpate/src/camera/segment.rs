use super::fragments::{MIN_FRAGMENT, with_fragments};
use super::fringe::fringe;
use super::raster_filter::{NO_CLUSTER, border_share, flying_pixels, raster_clusters, raster_outliers};
use super::support::{Support, Up, readings, support_candidates};
use super::{Background, Frame, SegmentError, SegmentParams, Visible, smooth_depth};
use crate::geometry::{Point, Raster, Vector};

/// From a frame to the object's visible side.
///
/// 1. drop "flying" pixels that mix two surfaces at a depth edge;
/// 2. support plane: the frame's, or the likeliest one of RANSAC's that has an object above it; remove it and what is below;
/// 3. clusters on the raster; keep the picked one, else the one nearest the image centre (with a mask: all sizeable ones);
/// 4. drop statistical outliers; denoise depth and take normals ([`smooth_depth`]).
///
/// A frame without a visible plane is taken to hold nothing but the object, and the support stays unknown.
///
/// # Errors
/// [`SegmentError`] says what was found and what is needed.
pub fn segment_object(frame: &Frame, params: &SegmentParams) -> Result<Visible, SegmentError> {
    params.validate()?;
    frame.validate()?;
    check_pick(frame, params)?;
    let noise = frame.noise.or_typical();
    let points = frame.unproject();
    let flying = flying_pixels(&frame.depth, &frame.camera, |z| noise.sigma_at(z), params.max_slope);
    let usable = points.pixels().map(|(r, c, p)| p.z.is_finite() && !flying[(r, c)]);
    let usable = like(&points, usable.collect());
    let (mut kept, support) = match &frame.mask {
        Some(mask) => masked_object(frame, &points, &usable, mask, params)?,
        None => unmasked_object(frame, &points, &usable, params)?,
    };
    let outliers = raster_outliers(&points, &kept, &frame.camera, params.outlier_sigmas);
    let object = zip(&kept, &outliers, |k, o| *k && !o);
    require(&object, params.min_pixels, "removing outliers")?;
    let (mut depth, mut normals) = smooth_depth(&frame.depth, &object, &frame.camera, noise, &params.smooth);
    if let Some(support) = &support {
        let table = seen_table(&points, &usable, &kept, support, params);
        let pitch = params.max_slope / frame.camera.fx.min(frame.camera.fy);
        let step = |z: f64| pitch * z + 4.0 * noise.sigma_at(z);
        let dropped = fringe(&points, &normals, &table, support, step);
        for (i, _) in dropped.as_slice().iter().enumerate().filter(|d| *d.1) {
            kept.as_mut_slice()[i] = false;
            depth.as_mut_slice()[i] = f32::NAN;
            normals.as_mut_slice()[i] = [0.0; 3];
        }
    }
    require(&depth.map(|z| !z.is_nan()), params.min_pixels, "denoising")?;
    let mask = match &frame.mask {
        Some(mask) => mask.clone(),
        None => with_dropped_edge(&kept, &flying),
    };
    let border_share = border_share(&mask);
    let support = frame.support.or(support.map(|s| s.plane.transformed(&frame.world_from_camera)));
    Ok(Visible { mask, depth, normals, support, border_share })
}

/// The largest connected part of the plane's readings; a bowl's thin floor is another part.
fn seen_table(
    points: &Raster<Point>,
    usable: &Raster<bool>,
    object: &Raster<bool>,
    support: &Support,
    params: &SegmentParams,
) -> Raster<bool> {
    let on_plane = zip(usable, points, |u, p| *u && support.plane.signed_distance(p).abs() <= support.margin);
    let on_plane = zip(&on_plane, object, |t, o| *t && !o);
    let (labels, count) = raster_clusters(points, &on_plane, 1, |_| params.link_distance);
    let sizes = cluster_sizes(&labels, count);
    let largest = (0..count).max_by_key(|&label| sizes[label]).map_or(NO_CLUSTER, |label| label as u32);
    labels.map(|&l| l != NO_CLUSTER && l == largest)
}

fn check_pick(frame: &Frame, params: &SegmentParams) -> Result<(), SegmentError> {
    match params.pick {
        Some((u, v)) if !frame.camera.contains(u, v) => {
            Err(SegmentError::PickOutside { u, v, width: frame.camera.width, height: frame.camera.height })
        }
        _ => Ok(()),
    }
}

fn require(object: &Raster<bool>, needed: usize, stage: &'static str) -> Result<(), SegmentError> {
    let found = count(object);
    if found < needed { Err(SegmentError::TooFewPoints { found, needed, stage }) } else { Ok(()) }
}

fn count(mask: &Raster<bool>) -> usize {
    mask.as_slice().iter().filter(|m| **m).count()
}

fn like<T, U>(shape: &Raster<T>, data: Vec<U>) -> Raster<U> {
    Raster::from_vec(shape.rows(), shape.cols(), data).expect("one value per pixel of a raster of this shape")
}

fn zip<A, B, U>(a: &Raster<A>, b: &Raster<B>, value: impl Fn(&A, &B) -> U) -> Raster<U> {
    like(a, a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| value(a, b)).collect())
}

/// World up in the camera frame; unknown where the world is the camera frame itself.
fn up(frame: &Frame) -> Up {
    if frame.world_from_camera.rotation.angle() > 1e-9 {
        Up::Known(frame.world_from_camera.inverse() * Vector::z())
    } else {
        Up::Image
    }
}

fn focus(frame: &Frame, params: &SegmentParams) -> (f64, f64) {
    params.pick.unwrap_or(((frame.camera.width - 1) as f64 / 2.0, (frame.camera.height - 1) as f64 / 2.0))
}

fn supports(
    frame: &Frame,
    points: &Raster<Point>,
    usable: &Raster<bool>,
    params: &SegmentParams,
    focus: (f64, f64),
) -> Vec<Support> {
    let (readings, pixels) = readings(points, usable);
    match frame.support {
        Some(plane) => {
            let plane = plane.transformed(&frame.world_from_camera.inverse());
            vec![Support::known(plane, &readings, params)]
        }
        None => support_candidates(&readings, &pixels, up(frame), focus, params),
    }
}

/// The object's readings where the mask is given, and the support if there is one.
fn masked_object(
    frame: &Frame,
    points: &Raster<Point>,
    usable: &Raster<bool>,
    mask: &Raster<bool>,
    params: &SegmentParams,
) -> Result<(Raster<bool>, Option<Support>), SegmentError> {
    let outside = zip(usable, mask, |u, m| *u && !m);
    let inside = zip(usable, mask, |u, m| *u && *m);
    require(&inside, params.min_pixels, "keeping readings under the mask")?;
    let (u, v, n) = inside
        .pixels()
        .filter(|p| *p.2)
        .fold((0.0, 0.0, 0.0), |(u, v, n), (row, col, _)| (u + col as f64, v + row as f64, n + 1.0));
    // A plane through the object's own readings would be one of its faces.
    let support = supports(frame, points, &outside, params, (u / n, v / n))
        .into_iter()
        .find(|s| frame.support.is_some() || stands_on(s, points, &inside));
    // What bleeds over the mask's edge lies on or below the table; on it there may be the object's foot.
    let kept = zip(&inside, points, |i, p| *i && support.is_none_or(|s| s.plane.signed_distance(p) > -s.margin));
    let (labels, clusters) = link(points, &kept, params);
    let sizes = cluster_sizes(&labels, clusters);
    // Occluders may split the object; crumbs of a few pixels are noise.
    let least = (count(&kept) / 50).max(10);
    Ok((labels.map(|&l| l != NO_CLUSTER && sizes[l as usize] >= least), support))
}

/// Whether most of the object is above the plane.
fn stands_on(support: &Support, points: &Raster<Point>, object: &Raster<bool>) -> bool {
    let above =
        points.pixels().filter(|(r, c, p)| object[(*r, *c)] && support.plane.signed_distance(p) > support.margin);
    above.count() * 2 > count(object)
}

/// The object's readings where nothing but the depth says where it is.
fn unmasked_object(
    frame: &Frame,
    points: &Raster<Point>,
    usable: &Raster<bool>,
    params: &SegmentParams,
) -> Result<(Raster<bool>, Option<Support>), SegmentError> {
    // What floats in nothing, away from the image border, is an object without its table; its flat faces are not tables.
    let floats = frame.background == Background::Absent && frame.support.is_none() && !touches_border(usable);
    let candidates = if floats { Vec::new() } else { supports(frame, points, usable, params, focus(frame, params)) };
    let mut failure = None;
    for support in candidates {
        let height = |p: &Point| support.plane.signed_distance(p);
        // A rendered object comes without its table; then its foot must not be taken for one.
        let on_plane = points.pixels().filter(|(r, c, p)| usable[(*r, *c)] && height(p).abs() < support.margin).count();
        let table_seen = frame.background == Background::Unknown || on_plane * 5 > count(usable);
        let lowest = if table_seen { support.margin } else { -support.margin };
        let above = zip(usable, points, |u, p| *u && height(p) > lowest);
        match choose_cluster(frame, points, &above, Some(&support), params) {
            Ok(kept) => return Ok((kept, Some(support))),
            Err(error) => failure = failure.or(Some(error)),
        }
    }
    match failure {
        Some(error) => Err(error),
        None => Ok((choose_cluster(frame, points, usable, None, params)?, None)),
    }
}

/// Whether readings fill a noticeable part of the image border.
fn touches_border(usable: &Raster<bool>) -> bool {
    let (rows, cols) = usable.shape();
    let on_border = usable.pixels().filter(|(r, c, u)| **u && (*r == 0 || *c == 0 || r + 1 == rows || c + 1 == cols));
    on_border.count() * 50 > 2 * (rows + cols)
}

fn link(points: &Raster<Point>, chosen: &Raster<bool>, params: &SegmentParams) -> (Raster<u32>, usize) {
    raster_clusters(points, chosen, params.link_pixels, |_| params.link_distance)
}

fn cluster_sizes(labels: &Raster<u32>, clusters: usize) -> Vec<usize> {
    let mut sizes = vec![0; clusters];
    for &label in labels.as_slice().iter().filter(|l| **l != NO_CLUSTER) {
        sizes[label as usize] += 1;
    }
    sizes
}

fn choose_cluster(
    frame: &Frame,
    points: &Raster<Point>,
    chosen: &Raster<bool>,
    support: Option<&Support>,
    params: &SegmentParams,
) -> Result<Raster<bool>, SegmentError> {
    let (labels, clusters) = link(points, chosen, params);
    let label = match params.pick {
        Some(pick) => picked_cluster(&labels, &cluster_sizes(&labels, clusters), pick, params)?,
        None => central_cluster(frame, points, &labels, clusters, support, params)?,
    };
    let kept = match support {
        Some(support) => with_fragments(points, &labels, clusters, label, support, params.fragment_gap),
        None => labels.map(|&l| l == label),
    };
    require(&kept, params.min_pixels, "clustering")?;
    Ok(kept)
}

/// The cluster at the picked pixel, or the nearest one within the pick radius; specks of noise are passed over.
fn picked_cluster(
    labels: &Raster<u32>,
    sizes: &[usize],
    (u, v): (f64, f64),
    params: &SegmentParams,
) -> Result<u32, SegmentError> {
    let distance = |row: usize, col: usize| (col as f64 - u).hypot(row as f64 - v);
    labels
        .pixels()
        .filter(|(_, _, label)| **label != NO_CLUSTER && sizes[**label as usize] >= MIN_FRAGMENT)
        .filter(|(row, col, _)| distance(*row, *col) <= params.pick_radius.max(0.71))
        .min_by(|a, b| distance(a.0, a.1).total_cmp(&distance(b.0, b.1)))
        .map(|(_, _, label)| *label)
        .ok_or(SegmentError::PickMissed { u, v, radius: params.pick_radius })
}

#[derive(Debug, Clone, Copy, Default)]
struct ClusterStats {
    pixels: usize,
    sum_u: f64,
    sum_v: f64,
    /// Pixels that rise over the smallest height of an object.
    high: usize,
    on_border: usize,
}

/// The cluster whose centroid is nearest the image centre, among those large enough and high enough.
fn central_cluster(
    frame: &Frame,
    points: &Raster<Point>,
    labels: &Raster<u32>,
    clusters: usize,
    support: Option<&Support>,
    params: &SegmentParams,
) -> Result<u32, SegmentError> {
    let mut stats = vec![ClusterStats::default(); clusters];
    let (rows, cols) = labels.shape();
    let high_from = support.map_or(0.0, |s| params.min_height.max(2.0 * s.margin));
    for (row, col, &label) in labels.pixels().filter(|l| *l.2 != NO_CLUSTER) {
        let s = &mut stats[label as usize];
        s.pixels += 1;
        s.sum_u += col as f64;
        s.sum_v += row as f64;
        s.high += usize::from(support.is_none_or(|s| s.plane.signed_distance(&points[(row, col)]) > high_from));
        s.on_border += usize::from(row == 0 || col == 0 || row + 1 == rows || col + 1 == cols);
    }
    // Robot arms and walls reach into the image from its border and say nothing about the size of an object.
    let largest_inside = stats.iter().filter(|s| s.on_border == 0).map(|s| s.pixels).max().unwrap_or(0);
    let least = params.min_pixels.max(largest_inside / 20);
    let (u, v) = focus(frame, params);
    let distance = |s: &ClusterStats| (s.sum_u / s.pixels as f64 - u).hypot(s.sum_v / s.pixels as f64 - v);
    stats
        .iter()
        .enumerate()
        .filter(|(_, s)| s.pixels >= least && s.high * 10 >= s.pixels)
        .min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)))
        .map(|(label, _)| label as u32)
        .ok_or_else(|| match support {
            Some(_) => SegmentError::NoObject {
                found: stats.iter().map(|s| s.pixels).max().unwrap_or(0),
                needed: least,
                min_height: high_from,
            },
            None => SegmentError::TooFewPoints {
                found: stats.iter().map(|s| s.pixels).max().unwrap_or(0),
                needed: least,
                stage: "clustering",
            },
        })
}

/// The silhouette: the cluster and the flying pixels of its own edge, which see the object in part.
fn with_dropped_edge(kept: &Raster<bool>, flying: &Raster<bool>) -> Raster<bool> {
    Raster::from_fn(kept.rows(), kept.cols(), |row, col| {
        kept[(row, col)]
            || flying[(row, col)] && {
                let near = (-1..=1).flat_map(|dr| (-1..=1).map(move |dc| (dr, dc)));
                near.filter(|(dr, dc)| kept.at(row as isize + dr, col as isize + dc) == Some(&true)).count() >= 3
            }
    })
}
