use crate::geometry::{Raster, Vector};
use crate::tactile::TactileSensor;
use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;

/// An analytic indenter: its surface is exact, without the facets of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Primitive {
    shape: Shape,
    /// Place under the pad, metres.
    center: (f64, f64),
    /// Rotation in the pad's plane, radians.
    yaw: f64,
    /// Slope of the whole along its own x and y, tangents.
    tilt: (f64, f64),
    /// Amplitude (metres) and wave number (1/m) of bumps, two phases; amplitude 0 for none.
    bumps: (f64, f64, f64, f64),
}

/// z grows away from the pad; every shape has its highest point at z = 0 over the origin. Lengths in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Shape {
    Ellipsoid {
        radii: (f64, f64, f64),
    },
    Cylinder {
        radius: f64,
    },
    /// A ridge: two planes that meet in the y axis, falling by these tangents.
    Wedge {
        left: f64,
        right: f64,
    },
    /// Three planes that meet in a point.
    Corner {
        slopes: [f64; 3],
    },
    /// A flat face that ends at x = edge; beyond it nothing.
    HalfPlane {
        edge: f64,
    },
    /// A flat rectangle with these half sides.
    Rectangle {
        half: (f64, f64),
    },
    Plane,
    /// A flat disc, as the end of a pin.
    Disc {
        radius: f64,
    },
    /// The rim of a tube.
    Ring {
        radius: f64,
        thickness: f64,
    },
}

impl Primitive {
    /// Names of the families that [`Self::random`] draws from.
    pub const NAMES: [&'static str; 9] =
        ["ellipsoid", "cylinder", "wedge", "corner", "half-plane", "rectangle", "plane", "disc", "ring"];

    /// Draws a shape, its place, tilt and bumps. Flat faces, whose level gradients alone cannot tell, are drawn most often.
    pub fn random(rng: &mut Pcg64Mcg) -> Self {
        let mut within = |low: f64, high: f64| low + (high - low) * rng.random::<f64>();
        let kind = within(0.0, 1.0);
        let log = |low: f64, high: f64, t: f64| low * (high / low).powf(t);
        let mut flat = true;
        let shape = if kind < 0.18 {
            flat = false;
            let r = log(1e-3, 40e-3, within(0.0, 1.0));
            let squash = (within(0.6, 1.6), within(0.5, 1.5));
            Shape::Ellipsoid { radii: (r * squash.0, r * squash.1, r) }
        } else if kind < 0.32 {
            flat = false;
            Shape::Cylinder { radius: log(1e-3, 60e-3, within(0.0, 1.0)) }
        } else if kind < 0.42 {
            Shape::Wedge { left: within(0.0, 1.5), right: within(0.15, 1.5) }
        } else if kind < 0.48 {
            Shape::Corner { slopes: [within(0.1, 1.2), within(0.1, 1.2), within(0.1, 1.2)] }
        } else if kind < 0.64 {
            Shape::HalfPlane { edge: within(-5e-3, 9e-3) }
        } else if kind < 0.76 {
            Shape::Rectangle { half: (within(1e-3, 9e-3), within(1e-3, 9e-3)) }
        } else if kind < 0.90 {
            Shape::Plane
        } else if kind < 0.95 {
            Shape::Disc { radius: within(1e-3, 7e-3) }
        } else {
            Shape::Ring { radius: within(2e-3, 8e-3), thickness: within(0.4e-3, 2e-3) }
        };
        let center = (within(-6e-3, 6e-3), within(-4.5e-3, 4.5e-3));
        let yaw = within(0.0, std::f64::consts::TAU);
        let steep = if flat { 0.14 } else { 0.25 };
        let tilted = within(0.0, 1.0) < 0.6;
        let tilt = if tilted { (within(-steep, steep), within(-steep, steep)) } else { (0.0, 0.0) };
        let bumpy = within(0.0, 1.0) < 0.2;
        let bumps = (
            if bumpy { log(0.02e-3, 0.25e-3, within(0.0, 1.0)) } else { 0.0 },
            std::f64::consts::TAU / log(0.8e-3, 6e-3, within(0.0, 1.0)),
            within(0.0, 6.0),
            within(0.0, 6.0),
        );
        Self { shape, center, yaw, tilt, bumps }
    }

    /// An untilted smooth face that covers the whole pad, tilted by these tangents: the case that gradients alone fail on.
    pub fn tilted_plane(tilt: (f64, f64)) -> Self {
        Self { shape: Shape::Plane, center: (0.0, 0.0), yaw: 0.0, tilt, bumps: (0.0, 1.0, 0.0, 0.0) }
    }

    /// A ball under the middle of the pad, metres.
    pub fn ball(radius: f64, center: (f64, f64)) -> Self {
        let shape = Shape::Ellipsoid { radii: (radius, radius, radius) };
        Self { shape, center, yaw: 0.0, tilt: (0.0, 0.0), bumps: (0.0, 1.0, 0.0, 0.0) }
    }

    /// Family of the shape, one of [`Self::NAMES`].
    pub fn name(&self) -> &'static str {
        match self.shape {
            Shape::Ellipsoid { .. } => "ellipsoid",
            Shape::Cylinder { .. } => "cylinder",
            Shape::Wedge { .. } => "wedge",
            Shape::Corner { .. } => "corner",
            Shape::HalfPlane { .. } => "half-plane",
            Shape::Rectangle { .. } => "rectangle",
            Shape::Plane => "plane",
            Shape::Disc { .. } => "disc",
            Shape::Ring { .. } => "ring",
        }
    }

    /// z of the surface over the whole pad, metres, +z into the object, infinite where there is none.
    pub fn surface(&self, sensor: &TactileSensor, rows: usize, cols: usize) -> Raster<f32> {
        let (sin, cos) = self.yaw.sin_cos();
        Raster::from_fn(rows, cols, |row, col| {
            let (px, py) = sensor.pixel_position(row, col, rows, cols);
            let (dx, dy) = (px - self.center.0, py - self.center.1);
            let (x, y) = (cos * dx + sin * dy, cos * dy - sin * dx);
            let (amplitude, wave, a, b) = self.bumps;
            let bump = amplitude * ((wave * x + a).sin() + (wave * y + b).sin());
            (self.shape.depth(x, y) + self.tilt.0 * x + self.tilt.1 * y + bump) as f32
        })
    }
}

impl Shape {
    /// Depth of the surface below its highest point, metres ≥ 0; infinite where there is none.
    fn depth(&self, x: f64, y: f64) -> f64 {
        let ends = |inside: bool| if inside { 0.0 } else { f64::INFINITY };
        match *self {
            Self::Ellipsoid { radii: (a, b, c) } => {
                let rest = 1.0 - (x / a).powi(2) - (y / b).powi(2);
                if rest > 0.0 { c * (1.0 - rest.sqrt()) } else { f64::INFINITY }
            }
            Self::Cylinder { radius } => {
                let rest = radius * radius - x * x;
                if rest > 0.0 { radius - rest.sqrt() } else { f64::INFINITY }
            }
            Self::Wedge { left, right } => {
                if x < 0.0 {
                    -left * x
                } else {
                    right * x
                }
            }
            Self::Corner { slopes } => (0..3)
                .map(|k| {
                    let (sin, cos) = (std::f64::consts::TAU * k as f64 / 3.0).sin_cos();
                    slopes[k] * (cos * x + sin * y)
                })
                .fold(0.0, f64::max),
            Self::HalfPlane { edge } => ends(x < edge),
            Self::Rectangle { half } => ends(x.abs() < half.0 && y.abs() < half.1),
            Self::Plane => 0.0,
            Self::Disc { radius } => ends(Vector::new(x, y, 0.0).norm() < radius),
            Self::Ring { radius, thickness } => ends((x.hypot(y) - radius).abs() < 0.5 * thickness),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng as _;

    #[test]
    fn every_family_is_drawn_and_named() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let drawn: Vec<_> = (0..400).map(|_| Primitive::random(&mut rng).name()).collect();
        for name in Primitive::NAMES {
            assert!(drawn.contains(&name), "{name}");
        }
    }

    #[test]
    fn a_ball_is_a_sphere() {
        let sensor = TactileSensor::preset("gelsight-mini").expect("listed");
        let ball = Primitive::ball(4e-3, (1e-3, -0.5e-3)).surface(&sensor, 240, 320);
        for (row, col, &z) in ball.pixels() {
            let (x, y) = sensor.pixel_position(row, col, 240, 320);
            let r = (x - 1e-3).hypot(y + 0.5e-3);
            if r < 3.9e-3 {
                let to_center = r.hypot(f64::from(z) - 4e-3);
                assert!((to_center - 4e-3).abs() < 1e-8, "{row} {col}");
            } else if r > 4e-3 {
                assert!(z.is_infinite());
            }
        }
    }
}
