use super::GelPress;
use crate::geometry::{Point, Sphere};
use crate::tactile::{Contact, TactileSensor};

/// A held-out press, decoded, against the ball it is of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PressQuality {
    /// Radius of the sphere through the decoded surface inside the contact, metres.
    pub radius: f64,
    /// The ball's radius, metres.
    pub ball_radius: f64,
    /// Root mean square distance in height of the decoded surface from the true ball at the found centre, up to a shift in depth,
    /// metres.
    pub residual: f64,
    /// Depth of the cap within the contact, metres.
    pub cap: f64,
}

/// Quality over all held-out presses.
#[derive(Debug, Clone, PartialEq)]
pub struct Quality {
    /// Each press; `None` where no sphere could be fitted.
    pub presses: Vec<Option<PressQuality>>,
}

impl PressQuality {
    pub(super) fn of(contact: &Contact, press: &GelPress, sensor: &TactileSensor) -> Option<Self> {
        let pitch = sensor.map_pitch(contact.height_map.cols());
        let ball = &press.ball;
        let points: Vec<Point> = (contact.height_map.pixels().filter(|(row, col, _)| ball.touches(*row, *col)))
            .map(|(row, col, &z)| {
                let (x, y) = (col as f64 - ball.center[0], row as f64 - ball.center[1]);
                Point::new(pitch * x, pitch * y, -f64::from(z))
            })
            .collect();
        let sphere = Sphere::fit(&points)?;
        let true_radius = press.ball_radius;
        let over = |p: &Point| p.z - (true_radius * true_radius - p.x * p.x - p.y * p.y).max(0.0).sqrt();
        let n = points.len() as f64;
        let mean = points.iter().map(over).sum::<f64>() / n;
        let residual = (points.iter().map(|p| (over(p) - mean).powi(2)).sum::<f64>() / n).sqrt();
        Some(Self { radius: sphere.radius, ball_radius: true_radius, residual, cap: press.cap(pitch) })
    }

    /// Radius found over the true one, less 1.
    pub fn radius_error(&self) -> f64 {
        self.radius / self.ball_radius - 1.0
    }
}

impl Quality {
    fn mean(&self, value: impl Fn(&PressQuality) -> f64) -> f64 {
        let all: Vec<f64> = self.presses.iter().flatten().map(value).collect();
        all.iter().sum::<f64>() / all.len().max(1) as f64
    }

    /// Mean error of the radius, as a share: its sign says whether surfaces come out too flat (+) or too curved (−).
    pub fn radius_error(&self) -> f64 {
        self.mean(PressQuality::radius_error)
    }

    /// Mean size of a press's radius error, as a share.
    pub fn radius_error_size(&self) -> f64 {
        self.mean(|p| p.radius_error().abs())
    }

    /// Mean residual, metres.
    pub fn residual(&self) -> f64 {
        self.mean(|p| p.residual)
    }

    /// Mean residual as a share of the cap's depth.
    pub fn residual_share(&self) -> f64 {
        self.mean(|p| p.residual / p.cap)
    }

    /// Presses whose radius is within a share of the true one.
    pub fn within(&self, share: f64) -> usize {
        self.presses.iter().flatten().filter(|p| p.radius_error().abs() <= share).count()
    }
}
