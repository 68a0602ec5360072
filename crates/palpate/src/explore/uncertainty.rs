use super::BeliefParams;
use crate::geometry::{KdTree, Point, PointCloud, Vector};
use crate::pipeline::Reconstruction;

/// Says how far the surface may be off at points of it: the prior of [`super::Belief`], to be replaced where something better is known.
pub trait SurfaceUncertainty {
    /// σ along the normal at each point, metres.
    fn sigma(&self, points: &[Point], normals: &[Vector]) -> Vec<f64>;
}

/// σ from the distance to what was measured: σ² = σ₀² + (g · `growth` · d)², d the distance to the nearest seen or felt point that
/// faces alike, at most `largest_sigma`; g = `guessed_share` where a guessed point lies, else 1.
pub struct EvidenceDistance {
    measured: Faced,
    guessed: Faced,
    params: BeliefParams,
}

/// Two normals face alike from this cosine on.
const ALIKE: f64 = 0.5;
/// A guess covers a place within this, metres.
const GUESS_RADIUS: f64 = 5e-3;

impl EvidenceDistance {
    /// Takes the seen, felt and guessed points of a reconstruction.
    pub fn new(reconstruction: &Reconstruction, params: &BeliefParams) -> Self {
        let mut measured = reconstruction.visible.clone();
        measured.append(&reconstruction.felt);
        Self { measured: Faced::new(&measured), guessed: Faced::new(&reconstruction.moved), params: *params }
    }
}

impl SurfaceUncertainty for EvidenceDistance {
    fn sigma(&self, points: &[Point], normals: &[Vector]) -> Vec<f64> {
        let b = &self.params;
        let of = |(p, n): (&Point, &Vector)| {
            let away = self.measured.distance(p, n).unwrap_or(f64::INFINITY);
            let guessed = self.guessed.distance(p, n).is_some_and(|d| d < GUESS_RADIUS);
            let share = if guessed { b.guessed_share } else { 1.0 };
            b.measured_sigma.hypot(share * (b.growth * away).min(b.largest_sigma))
        };
        points.iter().zip(normals).map(of).collect()
    }
}

/// Points by octant of their normal's largest component, so that a thin wall's other side is not near.
struct Faced {
    trees: Vec<KdTree>,
    members: Vec<Vec<(Point, Vector)>>,
}

impl Faced {
    fn new(cloud: &PointCloud) -> Self {
        let mut members = vec![Vec::new(); 6];
        if let Some(normals) = &cloud.normals {
            for (p, n) in cloud.points.iter().zip(normals) {
                // A normal belongs to every side it faces by more than half of `ALIKE`, so that no alike pair is missed.
                for (side, direction) in SIDES.iter().enumerate() {
                    if n.dot(&Vector::from(*direction)) > 0.25 {
                        members[side].push((*p, *n));
                    }
                }
            }
        }
        let tree = |m: &Vec<(Point, Vector)>| KdTree::new(&m.iter().map(|(p, _)| *p).collect::<Vec<_>>());
        Self { trees: members.iter().map(tree).collect(), members }
    }

    /// Distance to the nearest point that faces alike, among the nearest few on the side that `n` faces most.
    fn distance(&self, p: &Point, n: &Vector) -> Option<f64> {
        let facing = |side: &usize| n.dot(&Vector::from(SIDES[*side]));
        let side = (0..6).max_by(|a, b| facing(a).total_cmp(&facing(b)))?;
        let near = self.trees[side].nearest_n(p, 24);
        let alike = near.iter().find(|(i, _)| self.members[side][*i].1.dot(n) > ALIKE);
        // None of the nearest faces alike: it is at least as far as the farthest of them.
        alike.or(near.last()).map(|(_, d)| *d)
    }
}

const SIDES: [[f64; 3]; 6] =
    [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
