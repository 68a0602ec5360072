//! Progress on standard error: a spinner with the stage's name, shown only once the work takes long and only to a terminal.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::cell::RefCell;
use std::io::IsTerminal as _;
use std::sync::Once;
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
    fn say(&self, line: &str) {
        self.bar.suspend(|| eprintln!("{line}"));
    }

    /// Prints a warning without tearing the spinner.
    pub(crate) fn warn(&self, text: impl std::fmt::Display) {
        self.say(&crate::say::warning(text));
    }

    pub(crate) fn finish(&self) -> Timings {
        self.bar.finish_and_clear();
        let stages = self.stages.borrow();
        let ends = stages.iter().skip(1).map(|s| s.1).chain([Instant::now()]);
        stages.iter().zip(ends).map(|(s, end)| (s.0, (end - s.1).as_secs_f64())).collect()
    }
}

/// A bar of known length, on a terminal only.
///
/// * `template` – of indicatif
pub(crate) fn progress_bar(count: usize, template: &str) -> ProgressBar {
    let target =
        if std::io::stderr().is_terminal() { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
    let style = ProgressStyle::with_template(template).expect("the template is valid");
    ProgressBar::with_draw_target(Some(count as u64), target).with_style(style)
}

/// A bar that appears once the work has taken two seconds, and only on a terminal.
pub(crate) struct LateBar {
    bar: ProgressBar,
    begun: Instant,
    shown: Once,
}

impl LateBar {
    /// * `count` – steps, if they are known
    pub(crate) fn new(count: Option<usize>, what: &str) -> Self {
        let template = match count {
            Some(_) => format!("{{bar:40}} {{pos}}/{{len}} {what}, {{eta}} to go"),
            None => format!("{{spinner}} {{pos}} {what}, {{elapsed}} gone"),
        };
        let bar = ProgressBar::with_draw_target(count.map(|n| n as u64), ProgressDrawTarget::hidden());
        bar.set_style(ProgressStyle::with_template(&template).expect("the template is valid"));
        Self { bar, begun: Instant::now(), shown: Once::new() }
    }

    pub(crate) fn step(&self) {
        self.bar.inc(1);
        if self.begun.elapsed() > Duration::from_secs(2) {
            self.shown.call_once(|| self.bar.set_draw_target(ProgressDrawTarget::stderr()));
        }
    }
}

impl Drop for LateBar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
