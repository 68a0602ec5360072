//! A set of presses of one ball: split, calibrated, measured.

use palpate::geometry::{Point, Raster, Sphere};
use palpate::tactile::{
    BallPress, Contact, NoContact, SlopeRegressor, SlopeSample, TactileDecoder, TactileSensor, refine_ball,
};
use std::error::Error;

/// Ridges that are tried, by leaving out one calibration press after the other.
const RIDGES: [f64; 3] = [0.1, 1.0, 10.0];

pub(crate) struct Press {
    pub(crate) name: String,
    pub(crate) image: Raster<[u8; 3]>,
    pub(crate) difference: Raster<[f32; 3]>,
    pub(crate) relative: Raster<[f32; 3]>,
    pub(crate) ball: BallPress,
}

impl Press {
    /// `None` if the image shows no ball.
    pub(crate) fn find(
        name: &str,
        image: Raster<[u8; 3]>,
        no_contact: &NoContact,
        rough: ([f64; 2], f64),
    ) -> Result<Option<Self>, Box<dyn Error>> {
        let difference = no_contact.difference(&image)?;
        let relative = SlopeRegressor::relative_difference(no_contact, &difference);
        let ball = refine_ball(&difference, rough.0, rough.1);
        Ok(ball.map(|ball| Self { name: name.to_owned(), image, difference, relative, ball }))
    }
}

/// Calibration presses, spread over the pad: the one nearest to its middle, then always the one farthest from all taken. Looks at
/// places only, so the held-out presses have no say.
pub(crate) fn split(mut presses: Vec<Press>, count: usize, middle: [f64; 2]) -> (Vec<Press>, Vec<Press>) {
    let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let mut taken: Vec<Press> = Vec::new();
    while taken.len() < count && !presses.is_empty() {
        let room = |p: &Press| taken.iter().map(|t| apart(t.ball.center, p.ball.center)).fold(f64::INFINITY, f64::min);
        let score = |p: &Press| if taken.is_empty() { -apart(p.ball.center, middle) } else { room(p) };
        let best = (0..presses.len()).max_by(|&a, &b| score(&presses[a]).total_cmp(&score(&presses[b])));
        taken.push(presses.remove(best.expect("not empty")));
    }
    (taken, presses)
}

/// The regressor of these presses, its ridge chosen by leaving one out: least error of the slopes on the ball left out.
pub(crate) fn calibrate(presses: &[Press], ball_radius_px: f64) -> Result<SlopeRegressor, Box<dyn Error>> {
    let samples: Vec<Vec<SlopeSample>> =
        presses.iter().map(|p| SlopeRegressor::samples(&p.relative, &p.ball, ball_radius_px)).collect();
    let without = |left_out: usize| samples.iter().enumerate().filter(move |(i, _)| *i != left_out);
    let mut best = (f64::INFINITY, 0.0);
    for ridge in RIDGES {
        let mut sum = 0.0;
        for (i, left_out) in samples.iter().enumerate() {
            let rest = SlopeRegressor::fit(without(i).flat_map(|(_, s)| s.iter().copied()), ridge)?;
            sum += slope_error(&rest, left_out) / samples.len() as f64;
        }
        println!("ridge {ridge}: slope error on the press left out {sum:.3} (rms, mean over calibration presses)");
        best = if sum < best.0 { (sum, ridge) } else { best };
    }
    println!("ridge {} taken", best.1);
    Ok(SlopeRegressor::fit(samples.iter().flatten().copied(), best.1)?)
}

/// Root mean square over the pixels on the ball.
fn slope_error(regressor: &SlopeRegressor, samples: &[SlopeSample]) -> f64 {
    let on_ball: Vec<&SlopeSample> = samples.iter().filter(|s| s.slope != [0.0; 2]).collect();
    let error = |s: &&SlopeSample| {
        let found = regressor.slope(s.relative, s.place);
        f64::from((found[0] - s.slope[0]).powi(2) + (found[1] - s.slope[1]).powi(2))
    };
    (on_ball.iter().map(error).sum::<f64>() / on_ball.len().max(1) as f64).sqrt()
}

/// A decoded press against the ball, millimetres.
#[derive(Clone, Copy)]
pub(crate) struct Measured {
    pub(crate) radius: f64,
    pub(crate) residual: f64,
    pub(crate) cap: f64,
}

/// Radius of the sphere through the decoded surface inside the contact, and what is left of that surface over a ball of the true
/// radius at the refined centre, up to a shift in depth.
pub(crate) fn measure(contact: &Contact, ball: &BallPress, sensor: &TactileSensor, radius_mm: f64) -> Option<Measured> {
    let pitch = 1e3 * sensor.map_pitch(contact.height_map.cols());
    let points: Vec<Point> = (contact.height_map.pixels().filter(|(row, col, _)| ball.touches(*row, *col)))
        .map(|(row, col, &z)| {
            Point::new(
                pitch * (col as f64 - ball.center[0]),
                pitch * (row as f64 - ball.center[1]),
                -1e3 * f64::from(z),
            )
        })
        .collect();
    let sphere = Sphere::fit(&points)?;
    let over = |p: &Point| p.z - (radius_mm * radius_mm - p.x * p.x - p.y * p.y).max(0.0).sqrt();
    let mean = points.iter().map(over).sum::<f64>() / points.len() as f64;
    let residual = (points.iter().map(|p| (over(p) - mean).powi(2)).sum::<f64>() / points.len() as f64).sqrt();
    let edge = (pitch * ball.contact_radius).min(radius_mm);
    Some(Measured { radius: sphere.radius, residual, cap: radius_mm - (radius_mm * radius_mm - edge * edge).sqrt() })
}

/// Decodes and measures presses, prints a line for each and one for all.
pub(crate) fn report(
    title: &str,
    decoder: &dyn TactileDecoder,
    presses: &[Press],
    sensor: &TactileSensor,
    radius_mm: f64,
) -> Result<(), Box<dyn Error>> {
    println!("\n{title}\n| press | radius mm | error mm | error % | residual mm | of the cap % | cap mm |");
    println!("|---|---|---|---|---|---|---|");
    let mut all = Vec::new();
    for press in presses {
        let contact = decoder.decode(&press.image, sensor)?;
        let Some(m) = measure(&contact, &press.ball, sensor, radius_mm) else {
            println!("| {} | no sphere | | | | | |", press.name);
            continue;
        };
        line(&press.name, m, radius_mm);
        all.push(m);
    }
    let mean = |value: &dyn Fn(&Measured) -> f64| all.iter().map(value).sum::<f64>() / all.len() as f64;
    let radius = mean(&|m| m.radius);
    let sd = (mean(&|m| (m.radius - radius).powi(2)) * all.len() as f64 / (all.len() as f64 - 1.0)).sqrt();
    let off = mean(&|m| (m.radius - radius_mm).abs());
    let within = |share: f64| all.iter().filter(|m| (m.radius - radius_mm).abs() <= share * radius_mm).count();
    println!(
        "{title}: {} presses, radius {radius:.3} ± {sd:.3} mm, error of the mean {:+.3} mm ({:+.1} %), mean |error| {off:.3} mm \
         ({:.1} %), {} within 5 %, {} within 10 %; residual {:.3} mm, {:.1} % of the cap",
        all.len(),
        radius - radius_mm,
        100.0 * (radius / radius_mm - 1.0),
        100.0 * off / radius_mm,
        within(0.05),
        within(0.1),
        mean(&|m| m.residual),
        100.0 * mean(&|m| m.residual / m.cap),
    );
    Ok(())
}

fn line(name: &str, m: Measured, radius_mm: f64) {
    let error = m.radius - radius_mm;
    println!(
        "| {name} | {:.3} | {error:+.3} | {:+.1} | {:.3} | {:.1} | {:.2} |",
        m.radius,
        100.0 * error / radius_mm,
        m.residual,
        100.0 * m.residual / m.cap,
        m.cap
    );
}
