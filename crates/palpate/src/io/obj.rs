//! Wavefront OBJ: positions (with vertex colours) and faces; materials, texture and smoothing are skipped.
//!
//! Read by ourselves: tobj 4.0.5 gives every group its own vertices, which cuts a closed mesh of several groups apart, and
//! drops and reorders vertices.

use super::raw::{Lines, Raw, number, triple, unit_to_byte, words};
use crate::geometry::{Point, TriangleMesh};
use std::io::{self, Write};

pub(super) fn parse(bytes: &[u8]) -> Result<Raw, String> {
    let mut lines = Lines::new(bytes);
    let (mut raw, mut colors, mut corners) = (Raw::default(), Vec::<[f64; 3]>::new(), Vec::new());
    while let Some((n, line)) = lines.next_content() {
        let at = |reason: String| format!("line {n}: {reason}");
        let mut words = words(line);
        match words.next() {
            Some(b"v") => {
                let [x, y, z] = triple(&mut words).map_err(at)?;
                raw.points.push(Point::new(x, y, z));
                let rest: Vec<&[u8]> = words.collect();
                if rest.len() >= 3 {
                    colors.push(triple(&mut rest.into_iter()).map_err(at)?);
                }
            }
            Some(b"f") => {
                corners.clear();
                for word in words.filter(|w| *w != b"\\") {
                    corners.push(corner(word, raw.points.len()).map_err(at)?);
                }
                raw.push_polygon(&corners);
            }
            _ => {}
        }
    }
    if !colors.is_empty() && colors.len() == raw.points.len() {
        // Written as 0–1 by most tools, as 0–255 by some.
        let scale = if colors.iter().flatten().any(|&c| c > 1.0) { 1.0 / 255.0 } else { 1.0 };
        raw.colors = Some(colors.iter().map(|c| c.map(|c| unit_to_byte(c * scale))).collect());
    }
    raw.check_indices()?;
    Ok(raw)
}

/// The position index of `v`, `v/vt`, `v//vn` or `v/vt/vn`: from 1, or negative from the last vertex backwards.
fn corner(word: &[u8], vertices: usize) -> Result<u32, String> {
    let first = word.split(|&b| b == b'/').next().unwrap_or(word);
    let index: i64 = number(first)?;
    let resolved = if index < 0 { vertices as i64 + index } else { index - 1 };
    u32::try_from(resolved).map_err(|_| format!("vertex index {index} with {vertices} vertices so far"))
}

pub(super) fn write(w: &mut impl Write, mesh: &TriangleMesh) -> io::Result<()> {
    writeln!(w, "# palpate {}, metres", env!("CARGO_PKG_VERSION"))?;
    for (i, p) in mesh.vertices.iter().enumerate() {
        write!(w, "v {} {} {}", p.x as f32, p.y as f32, p.z as f32)?;
        if let Some(colors) = &mesh.colors {
            let [r, g, b] = colors[i].map(|c| f32::from(c) / 255.0);
            write!(w, " {r:.4} {g:.4} {b:.4}")?;
        }
        writeln!(w)?;
    }
    for [a, b, c] in mesh.faces.iter().map(|f| f.map(|i| i + 1)) {
        writeln!(w, "f {a} {b} {c}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_share_vertices_and_negative_indices_count_back() {
        let text =
            "v 0 0 0\nv 1 0 0\nv 0 1 0\ng one\nf 1/1/1 2//2 3\nv 0 0 1 # top\ng two\nusemtl x\nf -4 -1 -3\nf 1 2 3 4\n";
        let raw = parse(text.as_bytes()).expect("readable");
        assert_eq!(raw.points.len(), 4);
        assert_eq!(raw.faces, [[0, 1, 2], [0, 3, 1], [0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn wrong_indices_are_named_with_their_line() {
        assert!(parse(b"v 0 0 0\nf 0 1 1\n").expect_err("zero").contains("line 2: vertex index 0"));
        assert!(parse(b"v 0 0 0\nf 1 1 7\n").expect_err("past the end").contains("there are 1 vertices"));
        assert!(parse(b"v 0 0\n").expect_err("short").contains("line 1: three numbers"));
    }
}
