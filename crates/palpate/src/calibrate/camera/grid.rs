//! Corners joined into a grid: neighbours lie along each other's lines, and light and dark change sides from one to the next.

use super::corners::Corner;
use super::homography::homography;
use super::subpixel;
use crate::geometry::Raster;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::f64::consts::PI;

/// Largest angle between a line and the way to the neighbour along it, radians.
const CONE: f64 = 0.40;
/// Largest angle between the lines of neighbours, radians.
const PARALLEL: f64 = 0.35;
/// Neighbours looked at around a corner.
const NEAREST: usize = 16;
/// Share of a board's corners that must be found before the rest is filled in.
const MOST: f64 = 0.8;
/// How far beyond its outer corners a board is looked at, as a share of a square: it may be cut to half a square there.
const BEYOND: f64 = 0.25;
/// Contrast of the squares there that is needed, as a share of that inside.
const RIM: f64 = 0.3;

/// Corners by their column and row.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    cells: BTreeMap<(i32, i32), usize>,
}

/// A board's place in a grid.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    at: (i32, i32),
    pub(super) filled: usize,
    pub(super) response: f64,
}

/// Grids of at least nine corners, the largest first.
pub(super) fn assemble(corners: &[Corner]) -> Vec<Grid> {
    let links = links(corners);
    let mut taken = vec![false; corners.len()];
    let mut grids = Vec::new();
    for seed in 0..corners.len() {
        if !taken[seed] && links[seed].iter().filter(|l| l.is_some()).count() >= 2 {
            let grid = grow(seed, &links, &mut taken);
            if grid.cells.len() >= 9 {
                grids.push(grid);
            }
        }
    }
    grids.sort_by_key(|g| std::cmp::Reverse(g.cells.len()));
    grids
}

/// For each corner its neighbour along +first, +second, −first, −second line, where both choose each other.
fn links(corners: &[Corner]) -> Vec<[Option<(usize, usize)>; 4]> {
    let near = nearest(corners);
    let choice: Vec<[Option<usize>; 4]> =
        (0..corners.len()).map(|i| std::array::from_fn(|k| neighbour(corners, &near[i], i, k))).collect();
    (0..corners.len())
        .map(|i| {
            std::array::from_fn(|k| {
                let j = choice[i][k]?;
                // From the neighbour the way back runs along its other kind of line, for light and dark have changed sides.
                let back = (0..4).find(|&b| b % 2 != k % 2 && choice[j][b] == Some(i))?;
                Some((j, back))
            })
        })
        .collect()
}

/// The nearest others of each corner, by cells of equal size.
fn nearest(corners: &[Corner]) -> Vec<Vec<usize>> {
    let distance = |i: usize, j: usize| {
        let (a, b) = (corners[i].at, corners[j].at);
        (a[0] - b[0]).hypot(a[1] - b[1])
    };
    let points: Vec<_> = corners.iter().map(|c| crate::geometry::Point::new(c.at[0], c.at[1], 0.0)).collect();
    let tree = crate::geometry::KdTree::new(&points);
    (0..corners.len())
        .map(|i| {
            let mut near: Vec<usize> =
                tree.nearest_n(&points[i], NEAREST + 1).into_iter().map(|(j, _)| j).filter(|&j| j != i).collect();
            near.sort_by(|&a, &b| distance(i, a).total_cmp(&distance(i, b)).then(a.cmp(&b)));
            near
        })
        .collect()
}

fn direction(corner: &Corner, k: usize) -> f64 {
    corner.axes[k % 2] + if k >= 2 { PI } else { 0.0 }
}

/// Smallest turn between two directions.
fn between(a: f64, b: f64) -> f64 {
    let turn = (a - b).rem_euclid(2.0 * PI);
    turn.min(2.0 * PI - turn)
}

/// The same of two lines.
fn between_lines(a: f64, b: f64) -> f64 {
    let turn = (a - b).rem_euclid(PI);
    turn.min(PI - turn)
}

fn neighbour(corners: &[Corner], near: &[usize], i: usize, k: usize) -> Option<usize> {
    let (from, along) = (&corners[i], direction(&corners[i], k));
    let cost = |&j: &usize| {
        let to = &corners[j];
        let (dx, dy) = (to.at[0] - from.at[0], to.at[1] - from.at[1]);
        let (turn, length) = (between(dy.atan2(dx), along), dx.hypot(dy));
        let fits = turn < CONE && between_lines(to.axes[1 - k % 2], along) < PARALLEL && length > 2.0;
        fits.then_some((length * (1.0 + 2.0 * turn), j))
    };
    near.iter().filter_map(cost).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, j)| j)
}

/// Walks along the links; each corner's lines get the grid's directions from the neighbour it was reached from.
fn grow(seed: usize, links: &[[Option<(usize, usize)>; 4]], taken: &mut [bool]) -> Grid {
    let turn = |(x, y): (i32, i32)| (-y, x);
    let mut cells = BTreeMap::from([((0, 0), seed)]);
    let mut queue = VecDeque::from([(seed, (0, 0), [(1, 0), (0, 1), (-1, 0), (0, -1)])]);
    taken[seed] = true;
    while let Some((i, at, steps)) = queue.pop_front() {
        for k in 0..4 {
            let Some((j, back)) = links[i][k] else { continue };
            let place = (at.0 + steps[k].0, at.1 + steps[k].1);
            if taken[j] || cells.contains_key(&place) {
                continue;
            }
            taken[j] = true;
            cells.insert(place, j);
            let mut theirs = [(0, 0); 4];
            let mut step = (-steps[k].0, -steps[k].1);
            for n in 0..4 {
                theirs[(back + n) % 4] = step;
                step = turn(step);
            }
            queue.push_back((j, place, theirs));
        }
    }
    Grid { cells }
}

impl Grid {
    fn bounds(&self) -> (i32, i32, i32, i32) {
        let keys = self.cells.keys();
        keys.fold((i32::MAX, i32::MIN, i32::MAX, i32::MIN), |(a, b, c, d), &(x, y)| {
            (a.min(x), b.max(x), c.min(y), d.max(y))
        })
    }

    /// Columns and rows, the larger first.
    pub(super) fn size(&self) -> (usize, usize) {
        let (x0, x1, y0, y1) = self.bounds();
        let (a, b) = ((x1 - x0 + 1) as usize, (y1 - y0 + 1) as usize);
        (a.max(b), a.min(b))
    }

    /// The same corners, turned by a quarter.
    pub(super) fn turned(&self) -> Self {
        Self { cells: self.cells.iter().map(|(&(x, y), &i)| ((y, -x), i)).collect() }
    }

    /// Places where most of a board of this size was found.
    pub(super) fn windows(&self, cols: usize, rows: usize) -> Vec<Window> {
        let (x0, x1, y0, y1) = self.bounds();
        let mut windows = Vec::new();
        let starts = |low: i32, high: i32, n: usize| {
            let last = high - n as i32 + 1;
            low.min(last)..=low.max(last)
        };
        for y in starts(y0, y1, rows) {
            for x in starts(x0, x1, cols) {
                let filled = self.cells.range((x, i32::MIN)..(x + cols as i32, i32::MIN));
                let filled = filled.filter(|((_, cy), _)| (y..y + rows as i32).contains(cy)).count();
                if filled as f64 >= MOST * (cols * rows) as f64 {
                    windows.push(Window { at: (x, y), filled, response: 0.0 });
                }
            }
        }
        windows
    }

    /// The pixel of each of the board's corners, those not found predicted from the others and looked for.
    pub(super) fn complete(
        &self,
        window: &Window,
        (cols, rows): (usize, usize),
        corners: &[Corner],
        picture: &Raster<f32>,
    ) -> Option<Vec<[f64; 2]>> {
        let key = |i: usize| (window.at.0 + (i % cols) as i32, window.at.1 + (i / cols) as i32);
        let mut places: Vec<Option<[f64; 2]>> =
            (0..cols * rows).map(|i| self.cells.get(&key(i)).map(|&c| corners[c].at)).collect();
        for i in 0..places.len() {
            if places[i].is_none() {
                let guess = predict(&places, cols, (i % cols) as f64, (i / cols) as f64)?;
                let spacing = spacing(&places, cols, i)?;
                places[i] = Some(subpixel::find_missing(picture, guess, spacing)?);
            }
        }
        let places: Vec<[f64; 2]> = places.into_iter().collect::<Option<_>>()?;
        regular(&places, cols).then_some(places)
    }

    /// The size of the grid if it goes on past the window: a whole line more of good corners.
    pub(super) fn grows(
        &self,
        window: &Window,
        (cols, rows): (usize, usize),
        corners: &[Corner],
    ) -> Option<(usize, usize)> {
        let (x, y, w, h) = (window.at.0, window.at.1, cols as i32, rows as i32);
        let column = |cx: i32| (y..y + h).map(move |cy| (cx, cy)).collect::<Vec<_>>();
        let row = |cy: i32| (x..x + w).map(move |cx| (cx, cy)).collect::<Vec<_>>();
        let mut places: Vec<Option<[f64; 2]>> = Vec::new();
        for i in 0..cols * rows {
            let key = (x + (i % cols) as i32, y + (i / cols) as i32);
            places.push(self.cells.get(&key).map(|&c| corners[c].at));
        }
        let weakest = (0..cols * rows)
            .filter_map(|i| self.cells.get(&(x + (i % cols) as i32, y + (i / cols) as i32)))
            .map(|&c| corners[c].response)
            .fold(f64::INFINITY, f64::min);
        let fits = |keys: &[(i32, i32)]| {
            keys.iter().all(|&key| {
                let Some(&corner) = self.cells.get(&key) else { return false };
                let at = (f64::from(key.0 - x), f64::from(key.1 - y));
                let Some(guess) = predict(&places, cols, at.0, at.1) else { return false };
                let Some(spacing) = spacing(&places, cols, 0) else { return false };
                let off = (guess[0] - corners[corner].at[0]).hypot(guess[1] - corners[corner].at[1]);
                off < 0.25 * spacing && corners[corner].response > 0.5 * weakest
            })
        };
        let more = |lines: [Vec<(i32, i32)>; 2]| lines.iter().filter(|l| fits(l)).count();
        let (more_cols, more_rows) = (more([column(x - 1), column(x + w)]), more([row(y - 1), row(y + h)]));
        (more_cols + more_rows > 0).then_some((cols + more_cols, rows + more_rows))
    }
}

/// Where the corner at column `x` and row `y` should be, by a homography through the ones within two steps.
fn predict(places: &[Option<[f64; 2]>], cols: usize, x: f64, y: f64) -> Option<[f64; 2]> {
    for reach in [2.0, 3.0, 100.0] {
        let mut pairs = Vec::new();
        for (i, place) in places.iter().enumerate() {
            let at = [(i % cols) as f64, (i / cols) as f64];
            if let Some(place) = place.filter(|_| (at[0] - x).abs() <= reach && (at[1] - y).abs() <= reach) {
                pairs.push((at, place));
            }
        }
        let columns: BTreeSet<i64> = pairs.iter().map(|p| p.0[0] as i64).collect();
        let rows: BTreeSet<i64> = pairs.iter().map(|p| p.0[1] as i64).collect();
        if pairs.len() >= 6 && columns.len() >= 2 && rows.len() >= 2 {
            let (from, to): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
            let h = homography(&from, &to)?;
            let p = h * nalgebra::Vector3::new(x, y, 1.0);
            return (p.z.abs() > 1e-12).then(|| [p.x / p.z, p.y / p.z]);
        }
    }
    None
}

/// Mean distance to the neighbours of a corner that are there.
fn spacing(places: &[Option<[f64; 2]>], cols: usize, i: usize) -> Option<f64> {
    let rows = places.len() / cols;
    let (x, y) = ((i % cols) as i64, (i / cols) as i64);
    for reach in 1..4 {
        let (mut sum, mut n) = (0.0, 0.0);
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let at = |x: i64, y: i64| {
                    let inside = (0..cols as i64).contains(&x) && (0..rows as i64).contains(&y);
                    inside.then(|| places[y as usize * cols + x as usize]).flatten()
                };
                for (ex, ey) in [(1, 0), (0, 1)] {
                    if let (Some(a), Some(b)) = (at(x + dx, y + dy), at(x + dx + ex, y + dy + ey)) {
                        sum += (a[0] - b[0]).hypot(a[1] - b[1]);
                        n += 1.0;
                    }
                }
            }
        }
        if n > 0.0 {
            return Some(sum / n);
        }
    }
    None
}

/// Whether steps change little from one to the next, as on a flat board behind any usual lens.
fn regular(places: &[[f64; 2]], cols: usize) -> bool {
    let rows = places.len() / cols;
    let at = |x: usize, y: usize| places[y * cols + x];
    let bends = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        let bend = (a[0] - 2.0 * b[0] + c[0]).hypot(a[1] - 2.0 * b[1] + c[1]);
        let step = (c[0] - a[0]).hypot(c[1] - a[1]) / 2.0;
        bend > 0.4 * step
    };
    let along = (0..rows).all(|y| (2..cols).all(|x| !bends(at(x - 2, y), at(x - 1, y), at(x, y))));
    let across = (0..cols).all(|x| (2..rows).all(|y| !bends(at(x, y - 2), at(x, y - 1), at(x, y))));
    along && across
}

/// Whether squares go on beyond each of the four outer lines: along the edge of a board whose outer squares are cut, the ends of the dark
/// ones look like corners too, but what follows is plain.
pub(super) fn rimmed(picture: &Raster<f32>, places: &[[f64; 2]], cols: usize) -> bool {
    let rows = places.len() / cols;
    let line = |n: usize, at: &dyn Fn(usize) -> usize| (0..n).map(|i| places[at(i)]).collect::<Vec<_>>();
    let lines = [
        (line(cols, &|x| x), line(cols, &|x| cols + x)),
        (line(cols, &|x| (rows - 1) * cols + x), line(cols, &|x| (rows - 2) * cols + x)),
        (line(rows, &|y| y * cols), line(rows, &|y| y * cols + 1)),
        (line(rows, &|y| y * cols + cols - 1), line(rows, &|y| y * cols + cols - 2)),
    ];
    lines.iter().all(|(outer, inner)| {
        let contrast = |beyond: f64| {
            // From square to square along the line the grey changes to and fro.
            let shades: Option<Vec<f64>> = (1..outer.len())
                .map(|i| {
                    let middle = |k: usize| 0.5 * (outer[i - 1][k] + outer[i][k]);
                    let back = |k: usize| 0.5 * (inner[i - 1][k] + inner[i][k]);
                    let at = [0, 1].map(|k| middle(k) + beyond * (middle(k) - back(k)));
                    subpixel::sample(picture, at[0], at[1])
                })
                .collect();
            let shades = shades?;
            let signed = shades.windows(2).enumerate().map(|(i, w)| if i % 2 == 0 { w[0] - w[1] } else { w[1] - w[0] });
            Some(signed.sum::<f64>() / (shades.len() - 1) as f64)
        };
        match (contrast(-BEYOND), contrast(BEYOND)) {
            (Some(inside), Some(outside)) => -outside * inside.signum() > RIM * inside.abs(),
            // At the border of the image nothing beyond is to be seen.
            _ => true,
        }
    })
}

/// Mean grey of the squares like the first less that of the others.
pub(super) fn chequer(image: &Raster<f32>, corners: &[[f64; 2]], (cols, rows): (usize, usize)) -> f64 {
    let mut sums = [0.0; 2];
    let mut counts = [0.0; 2];
    for y in 0..rows - 1 {
        for x in 0..cols - 1 {
            let four = [y * cols + x, y * cols + x + 1, (y + 1) * cols + x, (y + 1) * cols + x + 1];
            let middle = [0, 1].map(|k| four.iter().map(|&i| corners[i][k]).sum::<f64>() / 4.0);
            if let Some(value) = subpixel::sample(image, middle[0], middle[1]) {
                sums[(x + y) % 2] += value;
                counts[(x + y) % 2] += 1.0;
            }
        }
    }
    sums[0] / f64::max(counts[0], 1.0) - sums[1] / f64::max(counts[1], 1.0)
}
