use super::{Aabb, Point, Vector};

/// A dense regular grid of values at nodes `origin + spacing · (i, j, k)`, `i` fastest in memory.
#[derive(Debug, Clone, PartialEq)]
pub struct VoxelGrid<T> {
    origin: Point,
    spacing: f64,
    dims: [usize; 3],
    data: Vec<T>,
}

impl<T: Clone> VoxelGrid<T> {
    /// A grid with the same value at every node. `spacing` in metres.
    pub fn filled(origin: Point, spacing: f64, dims: [usize; 3], value: T) -> Self {
        Self { origin, spacing, dims, data: vec![value; dims[0] * dims[1] * dims[2]] }
    }

    /// The smallest grid of the given spacing whose nodes cover `bounds`.
    pub fn covering(bounds: &Aabb, spacing: f64, value: T) -> Self {
        let size = bounds.max - bounds.min;
        let nodes = |length: f64| (length / spacing).ceil().max(0.0) as usize + 1;
        Self::filled(bounds.min, spacing, [nodes(size.x), nodes(size.y), nodes(size.z)], value)
    }
}

impl<T> VoxelGrid<T> {
    /// Position of node (0, 0, 0).
    pub fn origin(&self) -> Point {
        self.origin
    }

    /// Distance of neighbouring nodes, metres.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    /// Nodes along x, y, z.
    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// All values, x fastest.
    pub fn as_slice(&self) -> &[T] {
        &self.data
    }

    /// All values, x fastest.
    pub fn as_mut_slice(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// Index into [`Self::as_slice`] of node (i, j, k).
    #[inline]
    pub fn index(&self, i: usize, j: usize, k: usize) -> usize {
        debug_assert!(i < self.dims[0] && j < self.dims[1] && k < self.dims[2]);
        (k * self.dims[1] + j) * self.dims[0] + i
    }

    /// Position of node (i, j, k).
    #[inline]
    pub fn position(&self, i: usize, j: usize, k: usize) -> Point {
        self.origin + Vector::new(i as f64, j as f64, k as f64) * self.spacing
    }

    /// Continuous grid coordinates of a point, in cells from node (0, 0, 0).
    #[inline]
    pub fn coordinates(&self, p: &Point) -> Vector {
        (p - self.origin) / self.spacing
    }

    /// The node nearest to a point, or `None` if the point is more than half a cell outside.
    #[inline]
    pub fn nearest(&self, p: &Point) -> Option<usize> {
        let c = self.coordinates(p);
        let node = |x: f64, n: usize| (x > -0.5 && x < n as f64 - 0.5).then_some((x + 0.5) as usize);
        Some(self.index(node(c.x, self.dims[0])?, node(c.y, self.dims[1])?, node(c.z, self.dims[2])?))
    }
}
