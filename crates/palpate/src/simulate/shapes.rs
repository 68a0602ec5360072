use crate::geometry::{Point, TriangleMesh, Vector};
use std::f64::consts::{PI, TAU};

/// Solids with exact truth: a mesh of chosen accuracy and the exact signed distance.
///
/// Lengths in metres; centred in x and y, z up, resting on z = 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Solid {
    /// Box with edges `size`, one of the paper's printed shapes if cubic.
    Cuboid {
        /// Edge lengths.
        size: [f64; 3],
    },
    /// Upright prism over an equilateral triangle; one of the paper's printed shapes.
    TriangularPrism {
        /// Edge of the triangle.
        side: f64,
        /// Height.
        height: f64,
    },
    /// Square pyramid; one of the paper's printed shapes.
    Pyramid {
        /// Edge of the base.
        base: f64,
        /// Height.
        height: f64,
    },
    /// Ball.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// Upright cylinder.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Height.
        height: f64,
    },
    /// Upright cylinder with hemispherical ends.
    Capsule {
        /// Radius.
        radius: f64,
        /// Distance of the hemispheres' centres.
        length: f64,
    },
    /// Ring lying on the plane.
    Torus {
        /// Radius of the ring's centre line.
        major: f64,
        /// Radius of the tube.
        minor: f64,
    },
    /// L-shaped block with a slanted top: no symmetry at all.
    Bracket,
    /// A box with a tab on its −x side, off centre: the box is symmetric, the tab is not.
    TabbedBox,
}

/// Corners of a flat-faced solid and its triangles, counter-clockwise seen from outside.
struct Polyhedron {
    corners: Vec<Point>,
    triangles: Vec<[u32; 3]>,
}

impl Solid {
    /// Names that [`Self::named`] knows, in the sizes of a graspable object.
    pub const NAMES: [&'static str; 9] =
        ["cube", "prism", "pyramid", "sphere", "cylinder", "capsule", "torus", "bracket", "tabbed-box"];

    /// A solid of everyday size by name; `None` if there is none of this name.
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "cube" => Self::Cuboid { size: [0.06; 3] },
            "prism" => Self::TriangularPrism { side: 0.07, height: 0.08 },
            "pyramid" => Self::Pyramid { base: 0.08, height: 0.07 },
            "sphere" => Self::Sphere { radius: 0.04 },
            "cylinder" => Self::Cylinder { radius: 0.035, height: 0.1 },
            "capsule" => Self::Capsule { radius: 0.03, length: 0.07 },
            "torus" => Self::Torus { major: 0.045, minor: 0.015 },
            "bracket" => Self::Bracket,
            "tabbed-box" => Self::TabbedBox,
            _ => return None,
        })
    }

    /// A closed mesh with vertices on the exact surface.
    ///
    /// * `tolerance` – largest distance of a curved surface from its chords, metres; flat faces are exact
    /// * `max_edge` – edges of flat faces are split below this, metres, so that every triangle is small
    pub fn mesh(&self, tolerance: f64, max_edge: f64) -> TriangleMesh {
        if let Some(solid) = self.polyhedron() {
            return solid.subdivided(max_edge);
        }
        // A chord of length L on radius r stands off by L²/8r.
        let step = |r: f64| (8.0 * r * tolerance).sqrt().min(max_edge);
        // Multiples of four put vertices on the axes, so that the mesh's box is the solid's.
        let parts = |length: f64, r: f64| ((length / step(r) / 4.0).ceil().max(1.0) * 4.0) as usize;
        match *self {
            Self::Sphere { radius: r } => revolve(&arc(r, r, -PI / 2.0, PI / 2.0, parts(PI * r, r)), parts(TAU * r, r)),
            Self::Cylinder { radius: r, height: h } => {
                let line = |from: [f64; 2], to: [f64; 2], length: f64| {
                    let n = (length / max_edge).ceil() as usize;
                    (0..n).map(move |i| {
                        let t = i as f64 / n as f64;
                        [from[0] + t * (to[0] - from[0]), from[1] + t * (to[1] - from[1])]
                    })
                };
                let mut profile: Vec<[f64; 2]> = line([0.0, 0.0], [r, 0.0], r).collect();
                profile.extend(line([r, 0.0], [r, h], h));
                profile.extend(line([r, h], [0.0, h], r));
                profile.push([0.0, h]);
                revolve(&profile, parts(TAU * r, r))
            }
            Self::Capsule { radius: r, length } => {
                let quarter = parts(PI / 2.0 * r, r);
                let mut profile = arc(r, r, -PI / 2.0, 0.0, quarter);
                let n = (length / max_edge).ceil() as usize;
                profile.extend((1..n).map(|i| [r, r + length * i as f64 / n as f64]));
                profile.extend(arc(r, r + length, 0.0, PI / 2.0, quarter));
                revolve(&profile, parts(TAU * r, r))
            }
            Self::Torus { major, minor } => {
                torus(major, minor, parts(TAU * (major + minor), major + minor), parts(TAU * minor, minor))
            }
            // Covered by `polyhedron` above.
            _ => TriangleMesh::default(),
        }
    }

    /// Exact signed distance to the surface, metres, negative inside.
    pub fn signed_distance(&self, p: &Point) -> f64 {
        let radial = p.x.hypot(p.y);
        match *self {
            Self::Sphere { radius } => (p - Point::new(0.0, 0.0, radius)).norm() - radius,
            Self::Cylinder { radius, height } => {
                let (dr, dz) = (radial - radius, (p.z - height / 2.0).abs() - height / 2.0);
                dr.max(dz).min(0.0) + dr.max(0.0).hypot(dz.max(0.0))
            }
            Self::Capsule { radius, length } => {
                let z = p.z.clamp(radius, radius + length);
                radial.hypot(p.z - z) - radius
            }
            Self::Torus { major, minor } => (radial - major).hypot(p.z - minor) - minor,
            _ => self.polyhedron().map_or(f64::NAN, |solid| solid.signed_distance(p)),
        }
    }

    /// The flat-faced solids as polyhedra.
    fn polyhedron(&self) -> Option<Polyhedron> {
        Some(match *self {
            Self::Cuboid { size: [x, y, z] } => extrude(&rectangle(x, y), &[[0, 1, 2], [0, 2, 3]], |_| z),
            Self::TriangularPrism { side, height } => {
                let r = side / 3f64.sqrt();
                let corner = |i: f64| [r * (TAU * i / 3.0).cos(), r * (TAU * i / 3.0).sin()];
                extrude(&[corner(0.0), corner(1.0), corner(2.0)], &[[0, 1, 2]], |_| height)
            }
            Self::Pyramid { base, height } => {
                let mut corners: Vec<Point> = rectangle(base, base).map(|[x, y]| Point::new(x, y, 0.0)).to_vec();
                corners.push(Point::new(0.0, 0.0, height));
                Polyhedron {
                    corners,
                    triangles: vec![[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
                }
            }
            Self::Bracket => {
                let outline =
                    [[-0.04, -0.03], [0.04, -0.03], [0.04, -0.005], [-0.01, -0.005], [-0.01, 0.035], [-0.04, 0.035]];
                let cap = [[3, 4, 5], [3, 5, 0], [3, 0, 1], [3, 1, 2]];
                extrude(&outline, &cap, |[x, y]| 0.045 + 0.25 * x - 0.15 * y)
            }
            Self::TabbedBox => {
                let outline = [
                    [-0.025, -0.035],
                    [0.025, -0.035],
                    [0.025, 0.035],
                    [-0.025, 0.035],
                    [-0.025, 0.025],
                    [-0.04, 0.025],
                    [-0.04, 0.0],
                    [-0.025, 0.0],
                ];
                let cap = [[0, 1, 7], [1, 2, 4], [1, 4, 7], [2, 3, 4], [4, 5, 6], [4, 6, 7]];
                extrude(&outline, &cap, |_| 0.06)
            }
            _ => return None,
        })
    }
}

fn rectangle(x: f64, y: f64) -> [[f64; 2]; 4] {
    [[-x / 2.0, -y / 2.0], [x / 2.0, -y / 2.0], [x / 2.0, y / 2.0], [-x / 2.0, y / 2.0]]
}

/// Upright prism over a counter-clockwise outline, with the given triangulation of its caps and height at each corner.
fn extrude(outline: &[[f64; 2]], cap: &[[u32; 3]], top: impl Fn([f64; 2]) -> f64) -> Polyhedron {
    let n = outline.len() as u32;
    let mut corners: Vec<Point> = outline.iter().map(|&[x, y]| Point::new(x, y, 0.0)).collect();
    corners.extend(outline.iter().map(|&[x, y]| Point::new(x, y, top([x, y]))));
    let mut triangles: Vec<[u32; 3]> = cap.iter().map(|&[a, b, c]| [a, c, b]).collect();
    triangles.extend(cap.iter().map(|t| t.map(|i| i + n)));
    for i in 0..n {
        let j = (i + 1) % n;
        triangles.extend([[i, j, j + n], [i, j + n, i + n]]);
    }
    Polyhedron { corners, triangles }
}

impl Polyhedron {
    /// Each triangle split in k² equal ones, k the same for all, vertices shared.
    fn subdivided(&self, max_edge: f64) -> TriangleMesh {
        let mut mesh = TriangleMesh { vertices: self.corners.clone(), faces: self.triangles.clone(), colors: None };
        let longest = |m: &TriangleMesh| {
            m.faces
                .iter()
                .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
                .map(|(a, b)| edge(m, a, b))
                .fold(0.0, f64::max)
        };
        while longest(&mesh) > max_edge {
            mesh = halved(&mesh);
        }
        mesh
    }

    fn triangle(&self, t: &[u32; 3]) -> [Point; 3] {
        t.map(|i| self.corners[i as usize])
    }

    fn signed_distance(&self, p: &Point) -> f64 {
        let distance =
            self.triangles.iter().map(|t| point_triangle(p, &self.triangle(t))).fold(f64::INFINITY, f64::min);
        let winding: f64 = self.triangles.iter().map(|t| solid_angle(p, &self.triangle(t))).sum();
        if winding > TAU { -distance } else { distance }
    }
}

fn edge(mesh: &TriangleMesh, a: u32, b: u32) -> f64 {
    (mesh.vertices[a as usize] - mesh.vertices[b as usize]).norm()
}

/// Every triangle split in four at its edges' middles.
fn halved(mesh: &TriangleMesh) -> TriangleMesh {
    let mut vertices = mesh.vertices.clone();
    let mut middles = std::collections::BTreeMap::new();
    let mut middle = |a: u32, b: u32| {
        *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
            vertices.push(nalgebra::center(&mesh.vertices[a as usize], &mesh.vertices[b as usize]));
            vertices.len() as u32 - 1
        })
    };
    let mut faces = Vec::with_capacity(4 * mesh.faces.len());
    for &[a, b, c] in &mesh.faces {
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        faces.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    TriangleMesh { vertices, faces, colors: None }
}

/// Distance of a point from a triangle: to its plane if the foot is inside, else to its edges.
fn point_triangle(p: &Point, [a, b, c]: &[Point; 3]) -> f64 {
    let n = (b - a).cross(&(c - a));
    let inside = [(a, b), (b, c), (c, a)].iter().all(|(s, e)| n.dot(&(*e - *s).cross(&(p - *s))) >= 0.0);
    if inside {
        return (n.dot(&(p - a)) / n.norm()).abs();
    }
    let segment = |s: &Point, e: &Point| {
        let d = e - s;
        let t = ((p - s).dot(&d) / d.norm_squared()).clamp(0.0, 1.0);
        (p - (s + d * t)).norm()
    };
    segment(a, b).min(segment(b, c)).min(segment(c, a))
}

/// Signed solid angle of a triangle seen from a point (van Oosterom & Strackee 1983, eq. 8); 4π in sum inside a closed solid.
fn solid_angle(p: &Point, triangle: &[Point; 3]) -> f64 {
    let [a, b, c]: [Vector; 3] = triangle.map(|v| v - p);
    let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
    2.0 * a.dot(&b.cross(&c)).atan2(la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb)
}

/// Points (r, z) on a circle of radius `r` round (0, `z`) from angle `from` to `to`, both ends included.
fn arc(r: f64, z: f64, from: f64, to: f64, parts: usize) -> Vec<[f64; 2]> {
    (0..=parts)
        .map(|i| {
            let t = from + (to - from) * i as f64 / parts as f64;
            // The poles lie on the axis exactly.
            let x = if (t.abs() - PI / 2.0).abs() < 1e-12 { 0.0 } else { r * t.cos() };
            [x, z + r * t.sin()]
        })
        .collect()
}

/// The closed surface swept by a profile (r, z) from pole to pole, upwards outside.
fn revolve(profile: &[[f64; 2]], parts: usize) -> TriangleMesh {
    let n = parts as u32;
    let mut vertices = vec![Point::new(0.0, 0.0, profile[0][1])];
    let rings = profile.len() as u32 - 2;
    for [r, z] in &profile[1..=rings as usize] {
        vertices.extend((0..parts).map(|i| {
            let a = TAU * i as f64 / parts as f64;
            Point::new(r * a.cos(), r * a.sin(), *z)
        }));
    }
    vertices.push(Point::new(0.0, 0.0, profile[profile.len() - 1][1]));
    let top = vertices.len() as u32 - 1;
    let at = |ring: u32, i: u32| 1 + ring * n + i % n;
    let mut faces = Vec::new();
    for i in 0..n {
        faces.push([0, at(0, i + 1), at(0, i)]);
        for ring in 0..rings - 1 {
            faces.push([at(ring, i), at(ring, i + 1), at(ring + 1, i + 1)]);
            faces.push([at(ring, i), at(ring + 1, i + 1), at(ring + 1, i)]);
        }
        faces.push([top, at(rings - 1, i), at(rings - 1, i + 1)]);
    }
    TriangleMesh { vertices, faces, colors: None }
}

fn torus(major: f64, minor: f64, around: usize, tube: usize) -> TriangleMesh {
    let (n, m) = (around as u32, tube as u32);
    let mut vertices = Vec::with_capacity(around * tube);
    for i in 0..around {
        let a = TAU * i as f64 / around as f64;
        vertices.extend((0..tube).map(|j| {
            let b = TAU * j as f64 / tube as f64;
            let r = major + minor * b.cos();
            Point::new(r * a.cos(), r * a.sin(), minor + minor * b.sin())
        }));
    }
    let at = |i: u32, j: u32| (i % n) * m + j % m;
    let mut faces = Vec::with_capacity(2 * around * tube);
    for i in 0..n {
        for j in 0..m {
            faces.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            faces.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    TriangleMesh { vertices, faces, colors: None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn all() -> impl Iterator<Item = (&'static str, Solid)> {
        Solid::NAMES.into_iter().map(|n| (n, Solid::named(n).expect("listed")))
    }

    #[test]
    fn meshes_are_closed_oriented_and_rest_on_the_plane() {
        for (name, solid) in all() {
            let mesh = solid.mesh(50e-6, 5e-3);
            let mut edges = BTreeMap::new();
            for &[a, b, c] in &mesh.faces {
                for e in [(a, b), (b, c), (c, a)] {
                    *edges.entry(e).or_insert(0) += 1;
                }
            }
            for (&(a, b), &count) in &edges {
                assert_eq!(count, 1, "{name}: edge {a}-{b} used {count} times in one direction");
                assert!(edges.contains_key(&(b, a)), "{name}: edge {a}-{b} is open");
            }
            assert!(mesh.volume() > 0.0, "{name} is inside out");
            assert!(mesh.bounds().expect("not empty").min.z.abs() < 1e-12, "{name}");
        }
    }

    #[test]
    fn volumes_match_the_closed_forms() {
        let expected: [(&str, f64); 7] = [
            ("cube", 0.06f64.powi(3)),
            ("prism", 3f64.sqrt() / 4.0 * 0.07 * 0.07 * 0.08),
            ("pyramid", 0.08 * 0.08 * 0.07 / 3.0),
            ("sphere", 4.0 / 3.0 * PI * 0.04f64.powi(3)),
            ("cylinder", PI * 0.035f64.powi(2) * 0.1),
            ("capsule", PI * 0.03f64.powi(2) * (0.07 + 4.0 / 3.0 * 0.03)),
            ("torus", 2.0 * PI * PI * 0.045 * 0.015f64.powi(2)),
        ];
        for (name, volume) in expected {
            let found = Solid::named(name).expect("listed").mesh(5e-6, 3e-3).volume();
            assert!((found / volume - 1.0).abs() < 2e-3, "{name}: {found} of {volume}");
        }
    }

    #[test]
    fn mesh_vertices_and_centroids_have_zero_signed_distance_up_to_the_chord_error() {
        for (name, solid) in all() {
            let mesh = solid.mesh(5e-6, 3e-3);
            for v in mesh.vertices.iter().step_by(7) {
                assert!(solid.signed_distance(v).abs() < 1e-9, "{name} vertex {v}");
            }
            for f in (0..mesh.faces.len()).step_by(11) {
                let [a, b, c] = mesh.triangle(f);
                let centroid = Point::from((a.coords + b.coords + c.coords) / 3.0);
                assert!(solid.signed_distance(&centroid).abs() < 12e-6, "{name} face {f}");
                let out = centroid + mesh.face_normal(f) * 1e-4;
                assert!((solid.signed_distance(&out) - 1e-4).abs() < 15e-6, "{name} face {f}");
            }
        }
    }

    #[test]
    fn the_bracket_has_no_mirror_plane_through_its_centroid() {
        let mesh = Solid::Bracket.mesh(5e-6, 4e-3);
        let center = mesh.vertices.iter().map(|v| v.coords).sum::<Vector>() / mesh.vertices.len() as f64;
        for i in 0..200 {
            let (z, a) = (1.0 - (f64::from(i) + 0.5) / 100.0, 2.399963 * f64::from(i));
            let s = (1.0 - z * z).sqrt();
            let n = Vector::new(s * a.cos(), s * a.sin(), z);
            let plane = crate::geometry::Plane::new(n, &Point::from(center)).expect("unit");
            let worst = mesh
                .vertices
                .iter()
                .map(|v| Solid::Bracket.signed_distance(&plane.reflect_point(v)).abs())
                .fold(0.0, f64::max);
            assert!(worst > 4e-3, "{n:?}: {worst}");
        }
    }
}
