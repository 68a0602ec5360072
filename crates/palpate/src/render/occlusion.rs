use super::Viewpoint;
use super::draw::{Fragment, Fragments, Kind};
use crate::geometry::{Point, Vector};
use rayon::prelude::*;

/// How much light reaches a sample: from everywhere, and from the main light (both 0–1).
#[derive(Debug, Clone, Copy)]
pub(super) struct Light {
    pub(super) ambient: f32,
    pub(super) key: f32,
}

impl Light {
    const FULL: Self = Self { ambient: 1.0, key: 1.0 };

    /// Full light mixed with a share of this one.
    pub(super) fn faded(self, share: f32) -> Self {
        Self { ambient: 1.0 - share * (1.0 - self.ambient), key: 1.0 - share * (1.0 - self.key) }
    }
}

/// Hemisphere taps per sample; 4 × 4 neighbouring samples use different ones and are averaged.
const TAPS: usize = 12;
/// Side of the block over which taps are dithered and then averaged.
const BLOCK: usize = 4;

/// Screen-space ambient occlusion and a soft shadow, both dithered over blocks of samples and smoothed within a surface.
///
/// The occlusion follows Mittring, *Finding next gen: CryEngine 2* (SIGGRAPH courses 2007), with the hemisphere above the
/// normal instead of the whole ball.
pub(super) fn lighting(picture: &Fragments, view: &Viewpoint, shadow: &Fragments, light: &Viewpoint) -> Vec<Light> {
    let radius = 0.07 * view.extent;
    let light_from_camera = light.world_from_camera.inverse() * view.world_from_camera;
    let taps = hemisphere();
    let cols = picture.cols;
    let reach_px = (view.camera.fx * radius / nearest_depth(picture)).ceil();
    let near = surroundings(picture, if reach_px.is_finite() { reach_px as usize } else { cols });
    let casters = surroundings(shadow, 12);
    let mut raw = vec![Light::FULL; picture.data.len()];
    raw.par_chunks_mut(cols).enumerate().for_each(|(row, line)| {
        for (col, out) in line.iter_mut().enumerate() {
            let fragment = picture.data[row * cols + col];
            if matches!(fragment.kind, Kind::Empty | Kind::Unlit) {
                continue;
            }
            let dither = (row % BLOCK) * BLOCK + col % BLOCK;
            let point = Point::from(view.ray(col as f64, row as f64) * f64::from(fragment.z));
            let normal = Vector::from(fragment.normal.map(f64::from));
            if near.contains(row, col) {
                out.ambient = 1.0 - occlusion(picture, view, &point, &normal, radius, &taps[dither]);
            }
            let lifted = light_from_camera * (point + normal * (0.004 * view.extent));
            out.key = visibility(shadow, &casters, light, &lifted, dither, fragment.kind);
        }
    });
    smoothed(picture, &raw, 0.3 * radius as f32)
}

/// Rows and columns that hold the shapes and what they may darken.
struct Surroundings {
    rows: std::ops::Range<usize>,
    cols: std::ops::Range<usize>,
}

impl Surroundings {
    fn contains(&self, row: usize, col: usize) -> bool {
        self.rows.contains(&row) && self.cols.contains(&col)
    }
}

fn surroundings(picture: &Fragments, margin: usize) -> Surroundings {
    let (mut rows, mut cols) = (picture.rows..0, picture.cols..0);
    for (row, line) in picture.data.chunks(picture.cols).enumerate() {
        let shape = |f: &Fragment| f.kind == Kind::Lit;
        let (Some(first), Some(last)) = (line.iter().position(shape), line.iter().rposition(shape)) else { continue };
        rows = rows.start.min(row)..row + 1;
        cols = cols.start.min(first)..cols.end.max(last + 1);
    }
    Surroundings {
        rows: rows.start.saturating_sub(margin)..rows.end + margin,
        cols: cols.start.saturating_sub(margin)..cols.end + margin,
    }
}

fn nearest_depth(picture: &Fragments) -> f64 {
    let shapes = picture.data.iter().filter(|f| f.kind == Kind::Lit);
    shapes.map(|f| f64::from(f.z)).fold(f64::INFINITY, f64::min)
}

/// Directions in the upper half ball, denser near its centre, one set per place in the block.
fn hemisphere() -> Vec<[Vector; TAPS]> {
    let golden = 0.618_033_988_749_895;
    let sets = BLOCK * BLOCK;
    (0..sets)
        .map(|set| {
            std::array::from_fn(|k| {
                let i = (k * sets + set) as f64;
                let turn = std::f64::consts::TAU * (i * golden).fract();
                // Cosine-weighted direction; the length is a second golden sequence.
                let s = (k as f64 + 0.5) / TAPS as f64;
                let (horizontal, up) = (s.sqrt(), (1.0 - s).sqrt());
                let length = 0.08 + 0.92 * (i * golden * golden + 0.37).fract().powi(2);
                Vector::new(horizontal * turn.cos(), horizontal * turn.sin(), up) * length
            })
        })
        .collect()
}

/// Share of the hemisphere above a point that nearby surfaces hide.
fn occlusion(picture: &Fragments, view: &Viewpoint, p: &Point, n: &Vector, radius: f64, taps: &[Vector; TAPS]) -> f32 {
    let side = if n.x.abs() < 0.7 { Vector::x() } else { Vector::y() };
    let t = n.cross(&side).normalize();
    let b = n.cross(&t);
    let bias = 0.03 * radius;
    let mut hidden = 0.0;
    for tap in taps {
        let q = p + (t * tap.x + b * tap.y + n * tap.z) * radius;
        let u = view.camera.fx * q.x / q.z + view.camera.cx;
        let v = view.camera.fy * q.y / q.z + view.camera.cy;
        let (col, row) = (u.round(), v.round());
        if col < 0.0 || row < 0.0 || col >= picture.cols as f64 || row >= picture.rows as f64 {
            continue;
        }
        let front = f64::from(picture.data[row as usize * picture.cols + col as usize].z);
        if front < q.z - bias {
            // Something far in front does not darken what is behind it.
            hidden += (radius / (p.z - front).abs().max(radius)).powi(2);
        }
    }
    (hidden / TAPS as f64) as f32
}

/// Share of the main light that reaches a point (light frame): percentage-closer filtering, wider on the ground.
fn visibility(
    shadow: &Fragments,
    casters: &Surroundings,
    light: &Viewpoint,
    p: &Point,
    dither: usize,
    kind: Kind,
) -> f32 {
    let spread = if kind == Kind::Ground { 7.0 } else { 2.5 };
    let (u, v) = (light.camera.fx * p.x / p.z + light.camera.cx, light.camera.fy * p.y / p.z + light.camera.cy);
    if !(u >= 0.0 && v >= 0.0 && casters.contains(v as usize, u as usize)) {
        return 1.0;
    }
    let (du, dv) = ((dither % BLOCK) as f64 / BLOCK as f64 - 0.375, (dither / BLOCK) as f64 / BLOCK as f64 - 0.375);
    let mut lit = 0.0;
    for i in 0..3 {
        for j in 0..3 {
            let col = (u + (i as f64 - 1.0 + du) * spread).round();
            let row = (v + (j as f64 - 1.0 + dv) * spread).round();
            let inside = col >= 0.0 && row >= 0.0 && col < shadow.cols as f64 && row < shadow.rows as f64;
            let blocked = inside && f64::from(shadow.data[row as usize * shadow.cols + col as usize].z) < p.z;
            lit += if blocked { 0.0 } else { 1.0 };
        }
    }
    lit / 9.0
}

/// Averages over the dither block, among samples of the same surface.
fn smoothed(picture: &Fragments, raw: &[Light], reach: f32) -> Vec<Light> {
    let (rows, cols) = (picture.rows, picture.cols);
    let same = |a: &Fragment, b: &Fragment| a.kind == b.kind && (a.z - b.z).abs() < reach;
    let mut out = raw.to_vec();
    let full = |l: &Light| l.ambient == 1.0 && l.key == 1.0;
    let bright: Vec<bool> = raw.par_chunks(cols).map(|line| line.iter().all(full)).collect();
    out.par_chunks_mut(cols).enumerate().for_each(|(row, line)| {
        if bright[row.saturating_sub(BLOCK / 2)..(row + BLOCK / 2).min(rows)].iter().all(|&b| b) {
            return;
        }
        for (col, light) in line.iter_mut().enumerate() {
            let here = &picture.data[row * cols + col];
            if matches!(here.kind, Kind::Empty | Kind::Unlit) {
                continue;
            }
            let (mut ambient, mut key, mut count) = (0.0, 0.0, 0.0);
            for r in row.saturating_sub(BLOCK / 2)..(row + BLOCK / 2).min(rows) {
                for c in col.saturating_sub(BLOCK / 2)..(col + BLOCK / 2).min(cols) {
                    if same(here, &picture.data[r * cols + c]) {
                        ambient += raw[r * cols + c].ambient;
                        key += raw[r * cols + c].key;
                        count += 1.0;
                    }
                }
            }
            *light = Light { ambient: ambient / count, key: key / count };
        }
    });
    out
}
