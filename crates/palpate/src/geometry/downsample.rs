use super::{Point, PointCloud, Vector};

/// A cell whose mean normal is shorter than this holds surfaces that face different ways.
const AGREEING_NORMAL_LENGTH: f64 = 0.5;

/// Averages a cloud over cubic cells of side `cell`, metres; cells in lexicographic order.
///
/// Normals are averaged only where they agree (mean longer than 0.5). Elsewhere – the two faces of a thin wall in one
/// cell – one point is kept per octant of the normal, so that neither face disappears.
pub fn voxel_average(cloud: &PointCloud, cell: f64) -> PointCloud {
    let order = by_cell(&cloud.points, cell);
    let mut members: Vec<usize> = Vec::new();
    let mut out = PointCloud {
        points: Vec::new(),
        normals: cloud.normals.as_ref().map(|_| Vec::new()),
        colors: cloud.colors.as_ref().map(|_| Vec::new()),
    };
    for group in order.chunk_by(|a, b| a.0 == b.0) {
        members.clear();
        members.extend(group.iter().map(|(_, i)| *i as usize));
        match &cloud.normals {
            Some(normals) if mean_normal(normals, &members).norm() <= AGREEING_NORMAL_LENGTH => {
                for octant in 0..8 {
                    let same: Vec<usize> =
                        members.iter().copied().filter(|&i| octant_of(&normals[i]) == octant).collect();
                    push_average(&mut out, cloud, &same);
                }
            }
            _ => push_average(&mut out, cloud, &members),
        }
    }
    out
}

/// Number of each finite point's cell, in the lexicographic order of cells, and the point; sorted. O(n log n).
fn by_cell(points: &[Point], cell: f64) -> Vec<(u64, u32)> {
    /// Bits of a coordinate, three of which make a key.
    const BITS: u32 = 21;
    let finite = || (0_u32..).zip(points).filter(|(_, p)| p.iter().all(|c| c.is_finite()));
    let at = |p: &Point| [0, 1, 2].map(|axis| (p[axis] / cell).floor() as i64);
    let low = finite().fold([i64::MAX; 3], |low, (_, p)| {
        let at = at(p);
        [0, 1, 2].map(|k| low[k].min(at[k]))
    });
    let key = |p: &Point| {
        let at = at(p);
        let [x, y, z] = [0, 1, 2].map(|k| at[k].wrapping_sub(low[k]) as u64);
        ((x | y | z) >> BITS == 0).then_some(x << (2 * BITS) | y << BITS | z)
    };
    let keys: Option<Vec<(u64, u32)>> = finite().map(|(i, p)| Some((key(p)?, i))).collect();
    let Some(mut order) = keys else {
        // Too many cells for a key: number those that hold points.
        let mut cells: Vec<([i64; 3], u32)> = finite().map(|(i, p)| (at(p), i)).collect();
        cells.sort_unstable();
        let groups = cells.chunk_by(|a, b| a.0 == b.0);
        return groups.zip(0..).flat_map(|(group, number)| group.iter().map(move |c| (number, c.1))).collect();
    };
    order.sort_unstable();
    order
}

fn mean_normal(normals: &[Vector], members: &[usize]) -> Vector {
    members.iter().map(|&i| normals[i]).sum::<Vector>() / members.len() as f64
}

fn octant_of(n: &Vector) -> usize {
    usize::from(n.x < 0.0) | usize::from(n.y < 0.0) << 1 | usize::from(n.z < 0.0) << 2
}

fn push_average(out: &mut PointCloud, cloud: &PointCloud, members: &[usize]) {
    if members.is_empty() {
        return;
    }
    let count = members.len() as f64;
    out.points.push(Point::from(members.iter().map(|&i| cloud.points[i].coords).sum::<Vector>() / count));
    if let (Some(to), Some(from)) = (&mut out.normals, &cloud.normals) {
        to.push(mean_normal(from, members).try_normalize(1e-9).unwrap_or(from[members[0]]));
    }
    if let (Some(to), Some(from)) = (&mut out.colors, &cloud.colors) {
        to.push([0, 1, 2].map(|k| (members.iter().map(|&i| f64::from(from[i][k])).sum::<f64>() / count).round() as u8));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_becomes_its_mean() {
        let cloud = PointCloud {
            points: vec![Point::new(0.1, 0.1, 0.1), Point::new(0.3, 0.5, 0.1), Point::new(1.5, 0.1, 0.1)],
            normals: Some(vec![Vector::z(), Vector::x(), Vector::y()]),
            colors: Some(vec![[0, 10, 255], [100, 11, 255], [7, 7, 7]]),
        };
        let down = voxel_average(&cloud, 1.0);
        assert_eq!(down.len(), 2);
        assert!((down.points[0] - Point::new(0.2, 0.3, 0.1)).norm() < 1e-15);
        assert!((down.normals.expect("kept")[0] - Vector::new(1.0, 0.0, 1.0).normalize()).norm() < 1e-15);
        assert_eq!(down.colors.expect("kept"), [[50, 11, 255], [7, 7, 7]]);
    }

    #[test]
    fn both_faces_of_a_thin_wall_survive() {
        let points: Vec<Point> =
            (0..10).map(|i| Point::new(0.2 + 0.01 * f64::from(i), 0.5, if i % 2 == 0 { 0.4 } else { 0.6 })).collect();
        let normals = (0..10).map(|i| if i % 2 == 0 { -Vector::z() } else { Vector::z() }).collect();
        let down = voxel_average(&PointCloud::with_normals(points, normals).expect("same length"), 1.0);
        let mut heights: Vec<f64> = down.points.iter().map(|p| p.z).collect();
        heights.sort_by(f64::total_cmp);
        assert!((heights[0] - 0.4).abs() < 1e-12 && (heights[1] - 0.6).abs() < 1e-12 && heights.len() == 2);
    }

    #[test]
    fn cells_far_apart_come_in_order_too() {
        let points = vec![Point::new(1e9, 0.0, 0.0), Point::new(-1e9, 0.1, 0.0), Point::new(-1e9, 0.3, 0.0)];
        let cloud = PointCloud { points, normals: None, colors: None };
        let places: Vec<f64> = voxel_average(&cloud, 1e-3).points.iter().map(|p| p.x + p.y).collect();
        assert_eq!(places, [-1e9 + 0.1, -1e9 + 0.3, 1e9]);
        assert_eq!(voxel_average(&cloud, 1.0).len(), 2);
    }

    #[test]
    fn points_that_are_not_finite_are_left_out() {
        let cloud = PointCloud { points: vec![Point::new(f64::NAN, 0.0, 0.0)], normals: None, colors: None };
        assert!(voxel_average(&cloud, 0.1).is_empty());
    }
}
