//! GelSight Mini, a ball of 2 mm radius.

use crate::measure::{Press, calibrate, report, split};
use palpate::io;
use palpate::render::render_indentation;
use palpate::tactile::{
    Border, CalibrationSample, LookupDecoder, LookupTable, NoContact, RegressorDecoder, SlopeRegressor, TactileDecoder,
    TactileSensor,
};
use std::error::Error;
use std::path::Path;

const RADIUS_MM: f64 = 2.0;
/// Stated by the set's authors; a ball cannot tell it, for slopes have no scale.
const PITCH_MM: f64 = 0.08;
const CALIBRATION: usize = 10;

pub(crate) fn run(folder: &Path, pictures: Option<&Path>) -> Result<SlopeRegressor, Box<dyn Error>> {
    let sensor = TactileSensor { pixel_pitch: 1e-3 * PITCH_MM, ..TactileSensor::preset("gelsight-mini")? };
    let no_contact = NoContact::new(io::read_color(folder.join("calib_ball_median_background.png"))?, &sensor)?;
    let (rows, cols) = no_contact.shape();
    let circles = io::read_text(folder.join("calib_ball_rough_circles.tsv"))?;
    let (mut clear, mut left_out) = (Vec::new(), Vec::new());
    for line in circles.lines().skip(1) {
        let mut fields = line.split('\t');
        let name = fields.next().ok_or("an empty line")?;
        let circle: Vec<f64> = fields.map(str::parse).collect::<Result<_, _>>()?;
        let [x, y, radius, ..] = circle[..] else { return Err(format!("a short line: {line}").into()) };
        let image = io::read_color(folder.join(name))?;
        let name = name.trim_end_matches(".jpg");
        match Press::find(name, image, &no_contact, ([x, y], radius))? {
            Some(press) if press.ball.is_clear(rows, cols) => clear.push(press),
            _ => left_out.push(name.to_owned()),
        }
    }
    let mean = |value: &dyn Fn(&Press) -> f64| clear.iter().map(value).sum::<f64>() / clear.len() as f64;
    let contact = mean(&|p| p.ball.contact_radius);
    println!("{} clear presses, contact radius {contact:.1} px; left out: {}", clear.len(), left_out.join(" "));
    let (calibration, held_out) = split(clear, CALIBRATION, [0.5 * cols as f64, 0.5 * rows as f64]);
    println!("calibration: {}", calibration.iter().map(|p| p.name.as_str()).collect::<Vec<_>>().join(" "));

    let radius_px = RADIUS_MM / PITCH_MM;
    let table = LookupDecoder::new(look_up(&calibration, &no_contact, radius_px)?, no_contact.clone(), Border::Free);
    report("look-up table, held out", &table, &held_out, &sensor, RADIUS_MM)?;
    let regressor = calibrate(&calibration, radius_px)?;
    let decoder = RegressorDecoder::new(regressor.clone(), no_contact);
    report("quadratic, calibration", &decoder, &calibration, &sensor, RADIUS_MM)?;
    report("quadratic, held out", &decoder, &held_out, &sensor, RADIUS_MM)?;
    if let Some(pictures) = pictures {
        for press in held_out.iter().step_by(9) {
            let contact = decoder.decode(&press.image, &sensor)?;
            let name = format!("ball_{}.png", press.name);
            io::write_color(pictures.join(name), &render_indentation(&contact, &sensor))?;
        }
    }
    Ok(regressor)
}

fn look_up(presses: &[Press], no_contact: &NoContact, radius_px: f64) -> Result<LookupTable, Box<dyn Error>> {
    let gains = LookupDecoder::gains(no_contact);
    let (rows, cols) = no_contact.shape();
    let samples = presses.iter().flat_map(|press| {
        let labels = press.ball.labels(rows, cols, radius_px).into_iter();
        labels.map(|(row, col, slope)| {
            let (change, gain) = (press.difference[(row, col)], gains[(row, col)]);
            CalibrationSample { scaled_difference: [0, 1, 2].map(|k| change[k] * gain[k]), slope }
        })
    });
    Ok(LookupTable::calibrate(samples)?)
}
