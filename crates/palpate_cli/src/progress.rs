//! Progress on standard error: a spinner with the stage's name, shown only once the work takes long and only to a terminal.

use indicatif::{ProgressBar, ProgressStyle};
use std::cell::RefCell;
use std::time::{Duration, Instant};

/// Names the running stage to the user and times every stage.
pub(crate) struct StageClock {
    bar: ProgressBar,
    stages: RefCell<Vec<(&'static str, Instant)>>,
}

/// Seconds of each stage, in order.
pub(crate) type Timings = Vec<(&'static str, f64)>;

impl StageClock {
    pub(crate) fn start() -> Self {
        let bar = ProgressBar::new_spinner();
        bar.set_style(ProgressStyle::with_template("{spinner} {msg} {elapsed}").expect("the template is valid"));
        Self { bar, stages: RefCell::default() }
    }

    /// Times, shows nothing: for runs beside one another.
    pub(crate) fn silent() -> Self {
        Self { bar: ProgressBar::hidden(), stages: RefCell::default() }
    }

    pub(crate) fn begin(&self, stage: &'static str) {
        self.stages.borrow_mut().push((stage, Instant::now()));
        self.bar.set_message(stage);
        self.bar.enable_steady_tick(Duration::from_millis(200));
    }

    /// Prints a line without tearing the spinner.
    pub(crate) fn say(&self, line: &str) {
        self.bar.suspend(|| eprintln!("{line}"));
    }

    pub(crate) fn finish(&self) -> Timings {
        self.bar.finish_and_clear();
        let stages = self.stages.borrow();
        let ends = stages.iter().skip(1).map(|s| s.1).chain([Instant::now()]);
        stages.iter().zip(ends).map(|(s, end)| (s.0, (end - s.1).as_secs_f64())).collect()
    }
}
