//! Decodes real GelSight images: calibrates from presses of a ball, measures held-out presses, draws what objects left in the
//! gel. Makes the tables and pictures of `docs/real-tactile.md`. Usage: `real_tactile DATA [PICTURES]`, DATA holding
//! `gelsight_mini_balls/`, `gelsight_mini_objects/` and `gelsight_markers/`.

mod balls;
mod marker_gel;
mod measure;
mod objects;

use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1).map(PathBuf::from);
    let data = arguments.next().ok_or("usage: real_tactile DATA [PICTURES]")?;
    let pictures = arguments.next();
    let regressor = balls::run(&data.join("gelsight_mini_balls"), pictures.as_deref())?;
    objects::run(&data.join("gelsight_mini_objects"), &regressor, pictures.as_deref())?;
    marker_gel::run(&data.join("gelsight_markers"), pictures.as_deref())
}
