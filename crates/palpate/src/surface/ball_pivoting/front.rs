use crate::geometry::Point;

/// The mesh while it grows: every half-edge belongs to one face at most, so no edge ever has three faces and neighbours agree on
/// which side is out.
pub(super) struct Front {
    pub(super) faces: Vec<[u32; 3]>,
    /// Centre of the ball that made each face.
    pub(super) centers: Vec<Point>,
    /// Heads of the half-edges that leave each vertex.
    heads: Vec<Vec<u32>>,
    /// Number of open edges at each vertex.
    open: Vec<u32>,
}

impl Front {
    pub(super) fn new(vertices: usize) -> Self {
        Self { faces: Vec::new(), centers: Vec::new(), heads: vec![Vec::new(); vertices], open: vec![0; vertices] }
    }

    /// Whether a face runs from `a` to `b`.
    #[inline]
    pub(super) fn has(&self, a: u32, b: u32) -> bool {
        self.heads[a as usize].contains(&b)
    }

    /// Whether no face uses the vertex.
    pub(super) fn is_orphan(&self, v: u32) -> bool {
        self.heads[v as usize].is_empty()
    }

    /// Whether faces surround the vertex.
    pub(super) fn is_inner(&self, v: u32) -> bool {
        !self.is_orphan(v) && self.open[v as usize] == 0
    }

    /// Whether the face keeps the mesh edge-manifold, oriented and off surrounded vertices.
    pub(super) fn accepts(&self, face: [u32; 3]) -> bool {
        let [a, b, c] = face;
        !(self.has(a, b) || self.has(b, c) || self.has(c, a) || face.iter().any(|&v| self.is_inner(v)))
    }

    /// Adds a face that [`Self::accepts`] allows; returns its index.
    pub(super) fn add(&mut self, face: [u32; 3], center: Point) -> usize {
        debug_assert!(self.accepts(face));
        for k in 0..3 {
            let (a, b) = (face[k], face[(k + 1) % 3]);
            let closes = self.has(b, a);
            for v in [a, b] {
                let open = &mut self.open[v as usize];
                *open = if closes { *open - 1 } else { *open + 1 };
            }
            self.heads[a as usize].push(b);
        }
        self.faces.push(face);
        self.centers.push(center);
        self.faces.len() - 1
    }

    /// The open sides of a face, as the number of the corner where each starts.
    pub(super) fn open_sides(&self, face: usize) -> impl Iterator<Item = usize> + use<'_> {
        let corners = self.faces[face];
        (0..3).filter(move |&k| !self.has(corners[(k + 1) % 3], corners[k]))
    }
}
