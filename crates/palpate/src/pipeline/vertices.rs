//! Which vertices of a mesh are those of an earlier one, and far from what is new.

use crate::geometry::{Aabb, Point, TriangleMesh};
use std::collections::HashMap;

/// Edge of the cells in which new places are noted, metres.
const CELL: f64 = 8e-3;

/// Places, known to about a cell.
pub(super) struct Places {
    origin: Point,
    dims: [usize; 3],
    marked: Vec<bool>,
}

impl Places {
    /// The cells that hold a point or are next to one that does.
    ///
    /// * `bounds` – points outside are left out
    pub(super) fn near<'a>(points: impl Iterator<Item = &'a Point>, bounds: &Aabb) -> Self {
        let dims = [0, 1, 2].map(|a| (bounds.size()[a] / CELL) as usize + 1);
        let mut places = Self { origin: bounds.min, dims, marked: vec![false; dims[0] * dims[1] * dims[2]] };
        for p in points {
            let Some(at) = places.cell(p) else { continue };
            let range = |a: usize| at[a].saturating_sub(1)..(at[a] + 2).min(dims[a]);
            for (k, j) in range(2).flat_map(|k| range(1).map(move |j| (k, j))) {
                let row = (k * dims[1] + j) * dims[0];
                places.marked[row + range(0).start..row + range(0).end].fill(true);
            }
        }
        places
    }

    pub(super) fn holds(&self, p: &Point) -> bool {
        self.cell(p).is_some_and(|[i, j, k]| self.marked[(k * self.dims[1] + j) * self.dims[0] + i])
    }

    fn cell(&self, p: &Point) -> Option<[usize; 3]> {
        let c = (p - self.origin) / CELL;
        let at = [0, 1, 2].map(|a| c[a].max(0.0) as usize);
        (0..3).all(|a| c[a] >= 0.0 && at[a] < self.dims[a]).then_some(at)
    }
}

/// For each vertex of `mesh` the vertex of `earlier` in exactly the same place.
pub(super) fn same_vertices(mesh: &TriangleMesh, earlier: &TriangleMesh) -> Vec<Option<usize>> {
    let key = |p: &Point| [p.x.to_bits(), p.y.to_bits(), p.z.to_bits()];
    let known: HashMap<[u64; 3], usize> = earlier.vertices.iter().enumerate().map(|(i, p)| (key(p), i)).collect();
    mesh.vertices.iter().map(|p| known.get(&key(p)).copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_near_to_about_a_cell() {
        let bounds = Aabb { min: Point::origin(), max: Point::new(0.1, 0.1, 0.1) };
        let places = Places::near([Point::new(0.05, 0.05, 0.05), Point::new(0.5, 0.0, 0.0)].iter(), &bounds);
        let at = |x: f64| places.holds(&Point::new(x, 0.05, 0.05));
        assert!(at(0.05) && at(0.042) && at(0.058) && !at(0.03) && !at(0.07) && !at(0.5));
    }

    #[test]
    fn vertices_are_known_by_their_place() {
        let mesh = |xs: &[f64]| TriangleMesh {
            vertices: xs.iter().map(|&x| Point::new(x, 0.0, 0.0)).collect(),
            faces: Vec::new(),
            colors: None,
        };
        assert_eq!(same_vertices(&mesh(&[0.3, 0.5, 0.1]), &mesh(&[0.1, 0.2, 0.3])), vec![Some(2), None, Some(0)]);
    }
}
