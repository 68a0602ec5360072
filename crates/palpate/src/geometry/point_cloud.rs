use super::{Aabb, Isometry, Point, Vector};

/// Points with, if known, an outward unit normal and a colour each.
///
/// Invariant: `normals` and `colors`, when present, have one entry per point.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointCloud {
    /// Positions, metres.
    pub points: Vec<Point>,
    /// Outward unit normals.
    pub normals: Option<Vec<Vector>>,
    /// sRGB colours.
    pub colors: Option<Vec<[u8; 3]>>,
}

impl PointCloud {
    /// A cloud with normals; `None` if the numbers differ.
    pub fn with_normals(points: Vec<Point>, normals: Vec<Vector>) -> Option<Self> {
        (points.len() == normals.len()).then_some(Self { points, normals: Some(normals), colors: None })
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The smallest box round the points.
    pub fn bounds(&self) -> Option<Aabb> {
        Aabb::of(&self.points)
    }

    /// The cloud in frame `a`, given `a_from_b` and the cloud in `b`.
    pub fn transformed(&self, a_from_b: &Isometry) -> Self {
        Self {
            points: self.points.iter().map(|p| a_from_b * p).collect(),
            normals: self.normals.as_ref().map(|n| n.iter().map(|n| a_from_b * n).collect()),
            colors: self.colors.clone(),
        }
    }

    /// The points whose index satisfies `keep`, in order.
    pub fn filtered(&self, mut keep: impl FnMut(usize) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.len()).filter(|&i| keep(i)).collect();
        Self {
            points: kept.iter().map(|&i| self.points[i]).collect(),
            normals: self.normals.as_ref().map(|n| kept.iter().map(|&i| n[i]).collect()),
            colors: self.colors.as_ref().map(|c| kept.iter().map(|&i| c[i]).collect()),
        }
    }

    /// Appends another cloud; normals and colours survive only where both have them.
    pub fn append(&mut self, other: &Self) {
        let was_empty = self.is_empty();
        self.points.extend_from_slice(&other.points);
        self.normals = joined(self.normals.take(), other.normals.as_ref(), was_empty);
        self.colors = joined(self.colors.take(), other.colors.as_ref(), was_empty);
    }
}

fn joined<T: Clone>(a: Option<Vec<T>>, b: Option<&Vec<T>>, a_was_empty: bool) -> Option<Vec<T>> {
    let b = b?;
    let mut a = if a_was_empty { Vec::new() } else { a? };
    a.extend_from_slice(b);
    Some(a)
}
