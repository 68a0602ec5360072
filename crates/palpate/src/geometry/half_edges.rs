/// One side of a face: an edge with the direction the face runs through it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct HalfEdge {
    pub(crate) low: u32,
    pub(crate) high: u32,
    /// Corner of the face (3 f + k) where the side starts.
    pub(crate) corner: u32,
    pub(crate) forward: bool,
}

impl HalfEdge {
    pub(crate) fn edge(&self) -> (u32, u32) {
        (self.low, self.high)
    }

    pub(crate) fn face(&self) -> u32 {
        self.corner / 3
    }

    /// The face's corner at one end of the edge.
    pub(crate) fn corner_at(&self, vertex: u32) -> u32 {
        if (vertex == self.low) == self.forward { self.corner } else { 3 * self.face() + (self.corner % 3 + 1) % 3 }
    }
}

/// Every side of every face, sorted by edge and then by corner.
pub(crate) fn sorted_half_edges(faces: &[[u32; 3]]) -> Vec<HalfEdge> {
    let mut half_edges: Vec<HalfEdge> = (0..3 * faces.len() as u32)
        .map(|corner| {
            let face = &faces[corner as usize / 3];
            let k = corner as usize % 3;
            let (a, b) = (face[k], face[(k + 1) % 3]);
            HalfEdge { low: a.min(b), high: a.max(b), corner, forward: a < b }
        })
        .collect();
    half_edges.sort_unstable();
    half_edges
}
