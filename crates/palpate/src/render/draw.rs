use super::{Item, Paint, Shape, Viewpoint};
use crate::geometry::{KdTree, Point, PointCloud, TriangleMesh, Vector};
use rayon::prelude::*;

/// How a sample is lit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Nothing there.
    Empty,
    /// The ground: paper that catches the shadow.
    Ground,
    /// A surface.
    Lit,
    /// A surface that shows its colour as it is.
    Unlit,
}

/// What a sample of the picture sees.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fragment {
    /// Depth along the camera's z, metres; infinite where nothing is.
    pub(super) z: f32,
    /// Unit normal towards the viewer, camera frame.
    pub(super) normal: [f32; 3],
    /// sRGB, 0–255.
    pub(super) color: [f32; 3],
    /// How it is lit.
    pub(super) kind: Kind,
}

const EMPTY: Fragment = Fragment { z: f32::INFINITY, normal: [0.0; 3], color: [0.0; 3], kind: Kind::Empty };

/// The depth-buffered picture before lighting, row-major.
pub(super) struct Fragments {
    pub(super) cols: usize,
    pub(super) rows: usize,
    pub(super) data: Vec<Fragment>,
}

/// Rows drawn by one task. Fixed, so that the work is the same for any number of threads.
const BAND: usize = 24;
/// Vertex normals farther than this from their face's are an edge: the face stays flat there (cosine).
const CREASE: f64 = 0.88;

/// An item in the camera frame.
struct Placed<'a> {
    item: &'a Item<'a>,
    /// Camera-frame positions.
    points: Vec<Point>,
    /// Column, row and depth of each.
    pixels: Vec<[f64; 3]>,
    /// Camera-frame normals; zero where unknown.
    normals: Vec<Vector>,
    /// Radius of a point's disc, metres.
    radius: f64,
    /// The picture's camera.
    view: &'a Viewpoint,
}

impl<'a> Placed<'a> {
    fn new(item: &'a Item<'a>, view: &'a Viewpoint, smallest_px: f64) -> Self {
        let camera_from_world = view.world_from_camera.inverse();
        let points: Vec<Point> = item.points().par_iter().map(|p| camera_from_world * p).collect();
        let pixels = points.par_iter().map(|p| {
            let (u, v) = view.camera.project(p).unwrap_or((f64::NAN, f64::NAN));
            [u, v, p.z]
        });
        let pixels: Vec<[f64; 3]> = pixels.collect();
        let normals = match item.shape {
            Shape::Mesh(mesh) => mesh.vertex_normals(),
            Shape::Cloud(cloud) => cloud.normals.clone().unwrap_or_else(|| vec![Vector::zeros(); points.len()]),
        };
        let normals = normals.iter().map(|n| camera_from_world * n).collect();
        let radius = match item.shape {
            Shape::Mesh(_) => 0.0,
            Shape::Cloud(cloud) => {
                let depth = (view.center - Point::from(view.world_from_camera.translation.vector)).norm();
                disc_radius(cloud).max(smallest_px * depth / view.camera.fx)
            }
        };
        Self { item, points, pixels, normals, radius, view }
    }

    fn len(&self) -> usize {
        match self.item.shape {
            Shape::Mesh(mesh) => mesh.faces.len(),
            Shape::Cloud(_) => self.points.len(),
        }
    }

    /// First and last row that the primitive may touch; `None` if it is out of the picture.
    fn rows(&self, index: usize) -> Option<(usize, usize)> {
        let (low, high) = match self.item.shape {
            Shape::Mesh(mesh) => {
                let v = mesh.faces[index].map(|i| self.pixels[i as usize][1]);
                (v[0].min(v[1]).min(v[2]), v[0].max(v[1]).max(v[2]))
            }
            Shape::Cloud(_) => {
                let [_, v, z] = self.pixels[index];
                let reach = self.radius * self.view.camera.fy / z + 1.0;
                (v - reach, v + reach)
            }
        };
        let last = self.view.camera.height as f64 - 1.0;
        // NaN (behind the camera) fails both comparisons.
        (high >= 0.0 && low <= last).then(|| (low.max(0.0) as usize, high.min(last).ceil() as usize))
    }

    fn finish(&self, fragment: &mut Fragment, normal: Vector, ray: &Vector, color: [f32; 3]) {
        let away = normal.dot(ray) > 0.0;
        let facing = if away { -normal } else { normal };
        fragment.normal = [facing.x as f32, facing.y as f32, facing.z as f32];
        fragment.kind = Kind::Lit;
        fragment.color = color;
        if self.item.paint == Paint::Normal {
            let world = self.view.world_from_camera * normal;
            fragment.color = [0, 1, 2].map(|i| (127.5 * (world[i] + 1.0)) as f32);
            fragment.kind = Kind::Unlit;
        } else if away {
            let tint = if matches!(self.item.shape, Shape::Mesh(_)) { [0.72, 0.5, 0.46] } else { [0.72; 3] };
            for i in 0..3 {
                fragment.color[i] *= tint[i];
            }
        }
    }

    /// Perspective-correct triangle: 1/z and attribute/z are linear in the picture.
    fn draw_face(&self, mesh: &TriangleMesh, face: usize, band: &mut Band) {
        let ids = mesh.faces[face].map(|i| i as usize);
        let [a, b, c] = ids.map(|i| self.pixels[i]);
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let [p, q, r] = ids.map(|i| self.points[i]);
        let Some(flat) = (q - p).cross(&(r - p)).try_normalize(0.0) else { return };
        let normals = ids.map(|i| if self.normals[i].dot(&flat) > CREASE { self.normals[i] } else { flat });
        let colors = ids.map(|i| self.item.color(i).map(f32::from));
        let (left, right) = (a[0].min(b[0]).min(c[0]), a[0].max(b[0]).max(c[0]));
        let (top, bottom) = (a[1].min(b[1]).min(c[1]), a[1].max(b[1]).max(c[1]));
        let weight = |s: &[f64; 3], t: &[f64; 3], u: f64, v: f64| {
            ((t[0] - s[0]) * (v - s[1]) - (t[1] - s[1]) * (u - s[0])) / area
        };
        band.visit([left, right, top, bottom], |u, v, fragment| {
            let w = [weight(&b, &c, u, v), weight(&c, &a, u, v), weight(&a, &b, u, v)];
            if w.iter().any(|&w| w < 0.0) {
                return;
            }
            let w = [w[0] / a[2], w[1] / b[2], w[2] / c[2]];
            let z = 1.0 / (w[0] + w[1] + w[2]);
            if z as f32 >= fragment.z {
                return;
            }
            fragment.z = z as f32;
            let w = w.map(|w| w * z);
            let mut normal = normals[0] * w[0] + normals[1] * w[1] + normals[2] * w[2];
            let ray = self.view.ray(u, v);
            // Smooth normals may turn away at an outline although the face is seen from its front.
            if (normal.dot(&ray) > 0.0) != (flat.dot(&ray) > 0.0) {
                normal = flat;
            }
            let color = [0, 1, 2].map(|i| (0..3).map(|k| w[k] as f32 * colors[k][i]).sum());
            self.finish(fragment, normal.try_normalize(0.0).unwrap_or(flat), &ray, color);
        });
    }

    /// A disc across the point's normal.
    fn draw_point(&self, index: usize, band: &mut Band) {
        let [u0, v0, z0] = self.pixels[index];
        if !(u0.is_finite() && v0.is_finite()) {
            return;
        }
        let center = self.points[index];
        let towards_viewer = -center.coords.normalize();
        let known = self.normals[index];
        // A disc seen nearly edge-on would vanish: it is turned a little.
        let tilt = known.dot(&towards_viewer);
        let normal = if known == Vector::zeros() {
            towards_viewer
        } else if tilt.abs() < 0.2 {
            (known + towards_viewer * (0.2 * if tilt < 0.0 { -1.0 } else { 1.0 } - tilt)).normalize()
        } else {
            known
        };
        let reach = [self.radius * self.view.camera.fx / z0 + 1.0, self.radius * self.view.camera.fy / z0 + 1.0];
        let height = normal.dot(&center.coords);
        let color = self.item.color(index).map(f32::from);
        band.visit([u0 - reach[0], u0 + reach[0], v0 - reach[1], v0 + reach[1]], |u, v, fragment| {
            let ray = self.view.ray(u, v);
            let z = height / normal.dot(&ray);
            if !(z > 0.0 && (z as f32) < fragment.z) {
                return;
            }
            if (Point::from(ray * z) - center).norm_squared() <= self.radius * self.radius {
                fragment.z = z as f32;
                self.finish(fragment, if known == Vector::zeros() { normal } else { known }, &ray, color);
            }
        });
    }
}

/// Some rows of the picture.
struct Band<'a> {
    first_row: usize,
    cols: usize,
    data: &'a mut [Fragment],
}

impl Band<'_> {
    /// Calls `paint` for each sample of the rectangle [left, right, top, bottom] in the band.
    fn visit(&mut self, [left, right, top, bottom]: [f64; 4], mut paint: impl FnMut(f64, f64, &mut Fragment)) {
        let last_row = self.first_row + self.data.len() / self.cols - 1;
        let rows =
            top.ceil().max(self.first_row as f64) as usize..=bottom.floor().clamp(-1.0, last_row as f64) as usize;
        if right < 0.0 || bottom < 0.0 {
            return;
        }
        let cols = left.ceil().max(0.0) as usize..=right.floor().min(self.cols as f64 - 1.0) as usize;
        for row in rows {
            let line = &mut self.data[(row - self.first_row) * self.cols..][..self.cols];
            for col in cols.clone() {
                paint(col as f64, row as f64, &mut line[col]);
            }
        }
    }
}

/// Draws the items into a depth buffer; discs are at least `smallest_px` in radius.
pub(super) fn draw(items: &[Item], view: &Viewpoint, smallest_px: f64) -> Fragments {
    let (cols, rows) = (view.camera.width, view.camera.height);
    let placed: Vec<Placed> = items.iter().map(|item| Placed::new(item, view, smallest_px)).collect();
    let mut queues: Vec<Vec<(u32, u32)>> = vec![Vec::new(); rows.div_ceil(BAND)];
    for (k, item) in placed.iter().enumerate() {
        for index in 0..item.len() {
            if let Some((first, last)) = item.rows(index) {
                for queue in &mut queues[first / BAND..=(last / BAND).min(rows.div_ceil(BAND) - 1)] {
                    queue.push((k as u32, index as u32));
                }
            }
        }
    }
    let mut data = vec![EMPTY; rows * cols];
    data.par_chunks_mut(BAND * cols).zip(&queues).enumerate().for_each(|(k, (data, queue))| {
        let mut band = Band { first_row: k * BAND, cols, data };
        for &(item, index) in queue {
            let item = &placed[item as usize];
            match item.item.shape {
                Shape::Mesh(mesh) => item.draw_face(mesh, index as usize, &mut band),
                Shape::Cloud(_) => item.draw_point(index as usize, &mut band),
            }
        }
    });
    Fragments { cols, rows, data }
}

/// A disc radius that closes the gaps of a cloud: from the distance to the fourth neighbour, over 500 points.
fn disc_radius(cloud: &PointCloud) -> f64 {
    let finite: Vec<Point> = cloud.points.iter().filter(|p| p.iter().all(|c| c.is_finite())).copied().collect();
    if finite.len() < 6 {
        return cloud.bounds().map_or(0.0, |b| 0.02 * b.diagonal());
    }
    let tree = KdTree::new(&finite);
    let sampled = finite.iter().step_by(finite.len().div_ceil(500));
    let mut gaps: Vec<f64> = sampled.filter_map(|p| tree.nearest_n(p, 5).last().map(|n| n.1)).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() * 7 / 10).map_or(0.0, |g| 0.75 * g)
}
