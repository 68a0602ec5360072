use crate::geometry::Raster;

/// Side of the cells that are compared, pixels: noise averages out in them.
const CELL: usize = 16;

/// When a contact counts as settled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WatchParams {
    /// Frames at the start that are averaged into the background: nothing may touch the gel.
    pub warm_up: usize,
    /// Share of a frame without contact that goes into the running background: it follows slow drifts of the light.
    pub follow: f32,
    /// Deviation of a cell from the background, beyond the drift of the whole, that is contact; grey levels.
    pub contact: f32,
    /// Cells that must deviate so.
    pub cells: usize,
    /// Largest change of a cell from frame to frame while a contact is settled, grey levels.
    pub still: f32,
    /// Frames in a row that it must be still.
    pub settle: usize,
}

impl Default for WatchParams {
    fn default() -> Self {
        Self { warm_up: 10, follow: 0.02, contact: 4.0, cells: 2, still: 1.5, settle: 5 }
    }
}

/// What a frame shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Watched {
    /// The background is being averaged.
    WarmUp,
    /// Nothing touches.
    NoContact,
    /// A contact that is not yet settled.
    Moving,
    /// The first frame of a settled contact: this one is to be saved.
    Settled,
    /// A contact that has been saved.
    Held,
}

/// Why a stream cannot be watched.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WatchError {
    /// A frame has another size than the first.
    #[error("a frame is {}×{} px, those before {}×{} (width × height)", found.0, found.1, needed.0, needed.1)]
    Size {
        /// Width and height found.
        found: (usize, usize),
        /// Width and height of the first.
        needed: (usize, usize),
    },
    /// A parameter is out of range.
    #[error("{field} is {value}; it must be {rule}")]
    Parameter {
        /// Name of the parameter.
        field: &'static str,
        /// What was found.
        value: f64,
        /// What is needed.
        rule: &'static str,
    },
}

impl WatchParams {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`WatchError::Parameter`] names the first that is out of range.
    pub fn validate(&self) -> Result<(), WatchError> {
        let count = "at least 1";
        let level = "finite and positive, in grey levels";
        let check = |ok: bool, field, value: f64, rule| {
            if ok { Ok(()) } else { Err(WatchError::Parameter { field, value, rule }) }
        };
        check(self.warm_up > 0, "warm_up", self.warm_up as f64, count)?;
        check((0.0..=1.0).contains(&self.follow), "follow", f64::from(self.follow), "between 0 and 1")?;
        check(self.contact.is_finite() && self.contact > 0.0, "contact", f64::from(self.contact), level)?;
        check(self.cells > 0, "cells", self.cells as f64, count)?;
        check(self.still.is_finite() && self.still > 0.0, "still", f64::from(self.still), level)?;
        check(self.settle > 0, "settle", self.settle as f64, count)
    }
}

/// Watches a stream of tactile images for settled contacts, against a running background.
#[derive(Debug, Clone)]
pub struct ContactWatcher {
    params: WatchParams,
    background: Option<Raster<[f32; 3]>>,
    seen: usize,
    before: Vec<[f32; 3]>,
    still: usize,
    saved: bool,
}

impl ContactWatcher {
    /// Begins with nothing known.
    ///
    /// # Errors
    /// As [`WatchParams::validate`].
    pub fn new(params: WatchParams) -> Result<Self, WatchError> {
        params.validate()?;
        Ok(Self { params, background: None, seen: 0, before: Vec::new(), still: 0, saved: false })
    }

    /// Begins with a background that was taken before.
    ///
    /// # Errors
    /// As [`WatchParams::validate`].
    pub fn with_background(params: WatchParams, background: &Raster<[u8; 3]>) -> Result<Self, WatchError> {
        let mut watcher = Self::new(params)?;
        watcher.background = Some(background.map(|p| p.map(f32::from)));
        watcher.seen = params.warm_up;
        Ok(watcher)
    }

    /// The background as it is now; `None` while it is being averaged.
    pub fn background(&self) -> Option<Raster<[u8; 3]>> {
        let ready = self.background.as_ref().filter(|_| self.seen >= self.params.warm_up)?;
        Some(ready.map(|p| p.map(|v| v.round() as u8)))
    }

    /// After a gap in the stream (a device that was unplugged): what came before says nothing about stillness. A contact that was
    /// saved is not saved again unless it was let go.
    pub fn gap(&mut self) {
        self.before.clear();
        self.still = 0;
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// [`WatchError::Size`] if it has another size than those before.
    pub fn step(&mut self, frame: &Raster<[u8; 3]>) -> Result<Watched, WatchError> {
        let background = self.background.get_or_insert_with(|| frame.map(|_| [0.0; 3]));
        if background.shape() != frame.shape() {
            let size = |r: (usize, usize)| (r.1, r.0);
            return Err(WatchError::Size { found: size(frame.shape()), needed: size(background.shape()) });
        }
        if self.seen < self.params.warm_up {
            self.seen += 1;
            mix(background, frame, 1.0 / self.seen as f32);
            return Ok(Watched::WarmUp);
        }
        let cells = cells(frame, background);
        let moved = largest_change(&cells, &self.before);
        self.before.clone_from(&cells);
        if !self.touches(&cells) {
            (self.still, self.saved) = (0, false);
            let follow = self.params.follow;
            if let Some(background) = &mut self.background {
                mix(background, frame, follow);
            }
            return Ok(Watched::NoContact);
        }
        if self.saved {
            return Ok(Watched::Held);
        }
        self.still = if moved <= self.params.still { self.still + 1 } else { 0 };
        if self.still < self.params.settle {
            return Ok(Watched::Moving);
        }
        self.saved = true;
        Ok(Watched::Settled)
    }

    /// Whether enough cells deviate from the background by more than the drift of the whole.
    fn touches(&self, cells: &[[f32; 3]]) -> bool {
        let drift = [0, 1, 2].map(|k| median(cells.iter().map(|c| c[k]).collect()));
        let deviates = |cell: &&[f32; 3]| (0..3).any(|k| (cell[k] - drift[k]).abs() > self.params.contact);
        cells.iter().filter(deviates).count() >= self.params.cells.min(cells.len())
    }
}

fn mix(background: &mut Raster<[f32; 3]>, frame: &Raster<[u8; 3]>, share: f32) {
    for (old, new) in background.as_mut_slice().iter_mut().zip(frame.as_slice()) {
        (0..3).for_each(|k| old[k] += share * (f32::from(new[k]) - old[k]));
    }
}

/// Mean difference to the background in each cell.
fn cells(frame: &Raster<[u8; 3]>, background: &Raster<[f32; 3]>) -> Vec<[f32; 3]> {
    let (rows, cols) = frame.shape();
    let (down, across) = (rows.div_ceil(CELL), cols.div_ceil(CELL));
    let mut sums = vec![[0.0f32; 4]; down * across];
    for ((row, col, new), old) in frame.pixels().zip(background.as_slice()) {
        let sum = &mut sums[row / CELL * across + col / CELL];
        (0..3).for_each(|k| sum[k] += f32::from(new[k]) - old[k]);
        sum[3] += 1.0;
    }
    sums.into_iter().map(|[r, g, b, n]| [r / n, g / n, b / n]).collect()
}

/// Infinite if there was no frame before.
fn largest_change(now: &[[f32; 3]], before: &[[f32; 3]]) -> f32 {
    if before.len() != now.len() {
        return f32::INFINITY;
    }
    let pairs = now.iter().flatten().zip(before.iter().flatten());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

fn median(mut values: Vec<f32>) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The gel, touched so deep (0 to 1), lit so much brighter, with noise.
    fn frame(depth: f32, light: f32, seed: u32) -> Raster<[u8; 3]> {
        let mut state = seed.wrapping_mul(2_654_435_761);
        Raster::from_fn(96, 128, |r, c| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = (state >> 24) as f32 / 64.0 - 2.0;
            let (y, x) = (r as f32 - 48.0, c as f32 - 60.0);
            let press = if y.hypot(x) < 24.0 { depth * 2.0 * x } else { 0.0 };
            [90.0 + press, 120.0, 140.0 - press].map(|v| (v + light + noise) as u8)
        })
    }

    fn run(frames: &[(f32, f32)]) -> Vec<Watched> {
        let mut watcher = ContactWatcher::new(WatchParams::default()).expect("the defaults are valid");
        let step = |(i, &(depth, light)): (usize, &(f32, f32))| {
            watcher.step(&frame(depth, light, i as u32)).expect("one size")
        };
        frames.iter().enumerate().map(step).collect()
    }

    fn count(all: &[Watched], what: Watched) -> usize {
        all.iter().filter(|w| **w == what).count()
    }

    #[test]
    fn each_press_is_saved_once_and_only_when_it_has_settled() {
        let mut frames = vec![(0.0, 0.0); 15];
        for _ in 0..2 {
            frames.extend((1..=8).map(|i| (i as f32 / 8.0, 0.0)));
            frames.extend([(1.0, 0.0); 12]);
            frames.extend((0..8).rev().map(|i| (i as f32 / 8.0, 0.0)));
            frames.extend([(0.0, 0.0); 6]);
        }
        let all = run(&frames);
        assert_eq!(count(&all, Watched::Settled), 2, "{all:?}");
        // Pressed in until frame 22: the first still frame is 23, the fifth 27.
        assert_eq!(all.iter().position(|w| *w == Watched::Settled), Some(27), "{all:?}");
        assert_eq!(count(&all[..10], Watched::WarmUp), 10);
        assert!(all[10..15].iter().all(|w| *w == Watched::NoContact));
    }

    #[test]
    fn a_press_that_keeps_moving_and_drifting_light_are_not_saved() {
        let mut frames = vec![(0.0, 0.0); 12];
        frames.extend((0..30).map(|i| (0.5 + 0.4 * (i as f32).sin(), 0.0)));
        assert_eq!(count(&run(&frames), Watched::Settled), 0);
        let drift: Vec<(f32, f32)> = (0..200).map(|i| (0.0, 0.1 * i as f32)).collect();
        let all = run(&drift);
        assert_eq!(count(&all, Watched::NoContact), 190, "{all:?}");
    }

    #[test]
    fn a_gap_needs_stillness_anew_and_saves_no_contact_twice() {
        let mut watcher = ContactWatcher::with_background(WatchParams::default(), &frame(0.0, 0.0, 0))
            .expect("the defaults are valid");
        let step = |watcher: &mut ContactWatcher, depth| watcher.step(&frame(depth, 0.0, 1)).expect("one size");
        (0..4).for_each(|_| assert_eq!(step(&mut watcher, 1.0), Watched::Moving));
        watcher.gap();
        let again: Vec<Watched> = (0..7).map(|_| step(&mut watcher, 1.0)).collect();
        assert_eq!((again[5], again[6]), (Watched::Settled, Watched::Held), "{again:?}");
        watcher.gap();
        assert_eq!(step(&mut watcher, 1.0), Watched::Held);
    }

    #[test]
    fn another_size_and_impossible_parameters_are_errors() {
        let mut watcher = ContactWatcher::new(WatchParams::default()).expect("valid");
        watcher.step(&frame(0.0, 0.0, 0)).expect("the first");
        let error = watcher.step(&Raster::filled(10, 20, [0; 3])).expect_err("smaller").to_string();
        assert_eq!(error, "a frame is 20×10 px, those before 128×96 (width × height)");
        let bad = ContactWatcher::new(WatchParams { contact: f32::NAN, ..WatchParams::default() });
        assert!(matches!(bad, Err(WatchError::Parameter { field: "contact", .. })));
        assert!(ContactWatcher::new(WatchParams { settle: 0, ..WatchParams::default() }).is_err());
    }
}
