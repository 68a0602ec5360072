use crate::geometry::Raster;

/// A stroke font drawn for this project. A glyph is its width and its strokes; a point is two digits, x and y, with the
/// baseline at y = 2, small letters up to 6, capitals up to 8, descenders down to 0. Corners inside a stroke are rounded
/// (quadratic B-spline); a sharp corner starts a new stroke.
const GLYPHS: &[(char, u8, &str)] = &[
    (' ', 2, ""),
    ('a', 4, "26 06 02 42 46 26/46 42"),
    ('b', 4, "08 02/26 06 02 42 46 26"),
    ('c', 4, "45 46 06 02 42 43"),
    ('d', 4, "48 42/26 06 02 42 46 26"),
    ('e', 4, "04 44/44 46 06 02 42 43"),
    ('f', 3, "38 18 16 12/06 36"),
    ('g', 4, "26 06 02 42 46 26/46 40 00 01"),
    ('h', 4, "08 02/04 06 46 42"),
    ('i', 0, "06 02/08 08"),
    ('j', 1, "16 10 00/18 18"),
    ('k', 3, "08 02/36 03/14 32"),
    ('l', 0, "08 02"),
    ('m', 6, "06 02/04 06 36 32/34 36 66 62"),
    ('n', 4, "06 02/04 06 46 42"),
    ('o', 4, "26 06 02 42 46 26"),
    ('p', 4, "06 00/26 06 02 42 46 26"),
    ('q', 4, "46 40/26 06 02 42 46 26"),
    ('r', 3, "06 02/04 06 36"),
    ('s', 3, "35 36 06 04 34 32 02 03"),
    ('t', 3, "18 14 12 32/06 36"),
    ('u', 4, "06 02 42 44/46 42"),
    ('v', 4, "06 22/22 46"),
    ('w', 6, "06 12/12 36/36 52/52 66"),
    ('x', 4, "06 42/02 46"),
    ('y', 4, "06 22/46 10"),
    ('z', 4, "06 46/46 02/02 42"),
    ('A', 4, "02 28/28 42/14 34"),
    ('B', 4, "02 08/08 48 45 05/05 45 42 02"),
    ('C', 4, "47 48 08 02 42 43"),
    ('D', 4, "02 08/08 48 42 02"),
    ('E', 4, "48 08/08 02/02 42/05 35"),
    ('F', 4, "48 08/08 02/05 35"),
    ('G', 4, "47 48 08 02 42 45/45 25"),
    ('H', 4, "08 02/48 42/05 45"),
    ('I', 0, "08 02"),
    ('J', 3, "38 32 02 03"),
    ('K', 4, "08 02/48 04/15 42"),
    ('L', 4, "08 02/02 42"),
    ('M', 4, "02 08/08 25/25 48/48 42"),
    ('N', 4, "02 08/08 42/42 48"),
    ('O', 4, "28 08 02 42 48 28"),
    ('P', 4, "02 08/08 48 44 04"),
    ('Q', 4, "28 08 02 42 48 28/23 41"),
    ('R', 4, "02 08/08 48 44 04/24 42"),
    ('S', 4, "47 48 08 05 45 42 02 03"),
    ('T', 4, "08 48/28 22"),
    ('U', 4, "08 02 42 48"),
    ('V', 4, "08 22/22 48"),
    ('W', 6, "08 12/12 38/38 52/52 68"),
    ('X', 4, "08 42/02 48"),
    ('Y', 4, "08 25/25 48/25 22"),
    ('Z', 4, "08 48/48 02/02 42"),
    ('0', 4, "28 08 02 42 48 28"),
    ('1', 2, "07 28/28 22"),
    ('2', 4, "07 08 48 45 02/02 42"),
    ('3', 4, "07 08 48 45 25/25 45 42 02 03"),
    ('4', 4, "32 38/38 04/04 44"),
    ('5', 4, "48 08/08 05/05 45 42 02 03"),
    ('6', 4, "47 48 08 02 42 45 05"),
    ('7', 4, "08 48/48 12"),
    ('8', 4, "28 08 05 45 48 28/25 05 02 42 45 25"),
    ('9', 4, "03 02 42 48 08 05 45"),
    ('.', 0, "02 02"),
    (',', 1, "12 01"),
    (':', 0, "02 02/05 05"),
    ('-', 3, "04 34"),
    ('_', 4, "01 41"),
    ('+', 4, "04 44/26 22"),
    ('=', 4, "03 43/05 45"),
    ('/', 4, "01 48"),
    ('(', 1, "18 07 02 11"),
    (')', 1, "08 17 12 01"),
    ('%', 4, "02 48/08 18 17 07 08/33 43 42 32 33"),
    ('·', 0, "05 05"),
    ('×', 2, "03 25/05 23"),
    ('°', 1, "08 18 17 07 08"),
];
/// Drawn for a character that the font lacks.
const UNKNOWN: (char, u8, &str) = ('\u{fffd}', 3, "02 08/08 38/38 32/32 02");
/// Height of capitals, font units.
const CAPITAL: f64 = 6.0;
/// Space between glyphs, font units.
const GAP: f64 = 1.7;
/// Thickness of a stroke, font units.
const PEN: f64 = 0.78;

fn glyph(c: char) -> &'static (char, u8, &'static str) {
    GLYPHS.iter().find(|g| g.0 == c).unwrap_or(&UNKNOWN)
}

/// Width of a text with capitals of the given height, pixels.
pub(super) fn width(text: &str, height: f64) -> f64 {
    let units: f64 = text.chars().map(|c| f64::from(glyph(c).1) + GAP).sum();
    (units - GAP).max(0.0) * height / CAPITAL
}

/// Writes a line of text centred on `anchor` = [middle, baseline] in pixels, anti-aliased.
pub(super) fn write(picture: &mut Raster<[u8; 3]>, text: &str, anchor: [f64; 2], height: f64, ink: [u8; 3]) {
    let unit = height / CAPITAL;
    let mut left = anchor[0] - 0.5 * width(text, height);
    for c in text.chars() {
        let &(_, advance, strokes) = glyph(c);
        for stroke in strokes.split('/') {
            let points = rounded(&parse(stroke));
            let points: Vec<[f64; 2]> =
                points.iter().map(|p| [left + p[0] * unit, anchor[1] - (p[1] - 2.0) * unit]).collect();
            draw_stroke(picture, &points, 0.5 * PEN * unit, ink);
        }
        left += (f64::from(advance) + GAP) * unit;
    }
}

fn parse(stroke: &str) -> Vec<[f64; 2]> {
    let digit = |b: u8| f64::from(b.saturating_sub(b'0'));
    stroke.split_ascii_whitespace().map(|p| [digit(p.as_bytes()[0]), digit(p.as_bytes()[1])]).collect()
}

/// Chaikin's corner cutting, thrice, with the ends kept.
fn rounded(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut points = points.to_vec();
    for _ in 0..3 {
        if points.len() < 3 {
            break;
        }
        let mut cut = vec![points[0]];
        for (i, pair) in points.windows(2).enumerate() {
            let mix = |t: f64| [0, 1].map(|k| (1.0 - t) * pair[0][k] + t * pair[1][k]);
            if i > 0 {
                cut.push(mix(0.25));
            }
            if i + 2 < points.len() {
                cut.push(mix(0.75));
            }
        }
        cut.push(points[points.len() - 1]);
        points = cut;
    }
    points
}

/// A polyline with round ends: a pixel is inked by how far it lies inside the pen's reach of the nearest segment.
fn draw_stroke(picture: &mut Raster<[u8; 3]>, points: &[[f64; 2]], pen: f64, ink: [u8; 3]) {
    let bound = |k: usize, sign: f64| points.iter().map(|p| sign * p[k]).fold(f64::MIN, f64::max) * sign;
    if points.is_empty() {
        return;
    }
    let margin = pen + 1.0;
    let range = |k: usize, size: usize| {
        let low = (bound(k, -1.0) - margin).max(0.0) as usize;
        let high = (bound(k, 1.0) + margin).ceil().clamp(0.0, size as f64) as usize;
        low..high
    };
    for row in range(1, picture.rows()) {
        for col in range(0, picture.cols()) {
            let p = [col as f64, row as f64];
            let nearest = points.windows(2).map(|s| distance_to_segment(p, s[0], s[1])).fold(f64::INFINITY, f64::min);
            let cover = (pen + 0.5 - nearest).clamp(0.0, 1.0);
            let pixel = &mut picture[(row, col)];
            for k in 0..3 {
                let (paper, ink) = (f64::from(pixel[k]), f64::from(ink[k]));
                pixel[k] = (paper + cover * (ink - paper)).round() as u8;
            }
        }
    }
}

fn distance_to_segment(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (d, e) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let length = d[0] * d[0] + d[1] * d[1];
    let t = if length > 0.0 { ((d[0] * e[0] + d[1] * e[1]) / length).clamp(0.0, 1.0) } else { 0.0 };
    (e[0] - t * d[0]).hypot(e[1] - t * d[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_glyph_is_well_formed_and_fits_its_width() {
        for (c, advance, strokes) in GLYPHS {
            for stroke in strokes.split('/').filter(|s| !s.is_empty()) {
                let points = parse(stroke);
                assert!(points.len() >= 2, "'{c}' has a stroke of {} points", points.len());
                assert!(points.iter().all(|p| p[0] <= f64::from(*advance) && p[1] <= 8.0), "'{c}' leaves its box");
            }
            assert_eq!(GLYPHS.iter().filter(|g| g.0 == *c).count(), 1, "'{c}' is there twice");
        }
        assert!((' '..='~').filter(char::is_ascii_alphanumeric).all(|c| glyph(c).0 == c));
    }

    #[test]
    fn text_is_written_where_it_was_asked_for() {
        let paper = [255; 3];
        let mut picture = Raster::filled(40, 120, paper);
        write(&mut picture, "IoU 0.9", [60.0, 30.0], 12.0, [0; 3]);
        let inked: Vec<(usize, usize)> = picture.pixels().filter(|p| *p.2 != paper).map(|p| (p.0, p.1)).collect();
        let half = 0.5 * width("IoU 0.9", 12.0) + 2.0;
        assert!(inked.iter().all(|&(r, c)| (15..=32).contains(&r) && (c as f64 - 60.0).abs() <= half), "{inked:?}");
        assert!(inked.iter().any(|&(r, c)| r < 22 && c < 34), "the capital I starts the line");
    }
}
