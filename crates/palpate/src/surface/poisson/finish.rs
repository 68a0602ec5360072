//! What happens to the mesh once it is extracted: trimming and colours.

use super::density::Density;
use super::octree::Samples;
use crate::geometry::{KdTree, Point, PointCloud, TriangleMesh, in_largest_piece, without_unused_vertices};
use rayon::prelude::*;

/// Samples that a vertex takes its colour from.
const COLOR_NEIGHBORS: usize = 4;

/// Samples whose density is read for the median.
const MEDIAN_OF: usize = 20_000;

/// Median density at the samples (at every n-th of many), per unit area of the unit cube.
pub(super) fn median_density(density: &mut Density, samples: &Samples) -> f64 {
    let step = samples.len().div_ceil(MEDIAN_OF).max(1);
    let places: Vec<[f64; 3]> = samples.position.iter().copied().step_by(step).collect();
    let mut counts: Vec<f64> = density.at(&places).iter().map(|r| r.count).collect();
    let middle = counts.len() / 2;
    *counts.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Removes the faces with a corner of less than the density; returns how many. With `largest`, what is cut off goes as well.
pub(super) fn trim(mesh: &mut TriangleMesh, density: &mut Vec<f64>, least: f64, largest: bool) -> usize {
    let before = mesh.faces.len();
    mesh.faces.retain(|f| f.iter().all(|&v| density[v as usize] >= least));
    if mesh.faces.len() < before {
        if largest {
            let mut keep = in_largest_piece(mesh).into_iter();
            mesh.faces.retain(|_| keep.next().unwrap_or(false));
        }
        let kept;
        (*mesh, kept) = without_unused_vertices(mesh);
        *density = kept.iter().map(|&v| density[v as usize]).collect();
    }
    before - mesh.faces.len()
}

/// The mean colour of the samples nearest each vertex, weighted by their inverse squared distance.
pub(super) fn colors(cloud: &PointCloud, chosen: &[u32], vertices: &[Point]) -> Option<Vec<[u8; 3]>> {
    let colors = cloud.colors.as_ref()?;
    let points: Vec<Point> = chosen.iter().map(|&i| cloud.points[i as usize]).collect();
    let tree = KdTree::new(&points);
    let color = |v: &Point| {
        let near = tree.nearest_n(v, COLOR_NEIGHBORS);
        let floor = near.last().map_or(1.0, |n| 1e-3 * n.1).max(f64::MIN_POSITIVE.sqrt());
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for (i, distance) in near {
            let w = (distance + floor).powi(-2);
            total += w;
            let c = colors[chosen[i] as usize];
            sum = std::array::from_fn(|k| sum[k] + w * f64::from(c[k]));
        }
        sum.map(|s| (s / total).round() as u8)
    };
    Some(vertices.par_iter().map(color).collect())
}
