//! OFF (Geomview): `OFF`, `COFF` and `NOFF` text files. Read by ourselves: no crate of the field reads it.

use super::raw::{Lines, Raw, check_claim, number, triple, unit_to_byte, words};
use crate::geometry::Point;

pub(super) fn parse(bytes: &[u8]) -> Result<Raw, String> {
    let mut lines = Lines::new(bytes);
    let (_, first) = lines.next_content().ok_or("the file is empty")?;
    let mut head = words(first).peekable();
    let keyword = head.next().unwrap_or_default();
    let has_colors = match keyword {
        b"OFF" | b"NOFF" => false,
        b"COFF" => true,
        _ => {
            return Err(format!(
                "it begins with '{}', not with OFF, COFF or NOFF",
                String::from_utf8_lossy(&keyword[..keyword.len().min(20)])
            ));
        }
    };
    let counts = if head.peek().is_some() {
        first.trim_ascii_start().get(keyword.len()..)
    } else {
        lines.next_content().map(|l| l.1)
    };
    let mut counts = words(counts.ok_or("the numbers of vertices and faces are missing")?);
    let mut count = |what| number::<u64>(counts.next().ok_or(format!("the number of {what} is missing"))?);
    let vertices = check_claim("vertices", count("vertices")?, 6, lines.rest().len())?;
    let faces = check_claim("faces", count("faces")?, 2, lines.rest().len())?;

    let mut raw = Raw { points: Vec::with_capacity(vertices), ..Raw::default() };
    let mut colors = Vec::new();
    for i in 0..vertices {
        let (n, line) = lines.next_content().ok_or_else(|| format!("the file ends before vertex {i} of {vertices}"))?;
        let mut words = words(line);
        let [x, y, z] = triple(&mut words).map_err(|reason| format!("line {n}: {reason}"))?;
        raw.points.push(Point::new(x, y, z));
        if has_colors {
            colors.push(triple(&mut words).map_err(|reason| format!("line {n}: {reason}"))?);
        }
    }
    let mut corners = Vec::new();
    for i in 0..faces {
        let (n, line) = lines.next_content().ok_or_else(|| format!("the file ends before face {i} of {faces}"))?;
        let at = |reason: String| format!("line {n}: {reason}");
        let mut words = words(line);
        let sides: usize = number(words.next().unwrap_or_default()).map_err(at)?;
        corners.clear();
        for _ in 0..sides {
            let word = words.next().ok_or_else(|| at(format!("{sides} vertex indices are needed")))?;
            corners.push(number(word).map_err(at)?);
        }
        raw.push_polygon(&corners);
    }
    if has_colors {
        let scale = if colors.iter().flatten().any(|&c| c > 1.0) { 1.0 / 255.0 } else { 1.0 };
        raw.colors = Some(colors.iter().map(|c| c.map(|c| unit_to_byte(c * scale))).collect());
    }
    raw.check_indices()?;
    Ok(raw)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_on_either_line_comments_and_colours() {
        for head in ["OFF\n# by hand\n\n4 2 0\n", "OFF 4 2 0\n"] {
            let text = format!("{head}0 0 0\n1 0 0\n1 1 0\n0 1 0 # last\n4 0 1 2 3 255 0 0\n3 0 1 2\n");
            assert_eq!(parse(text.as_bytes()).expect("readable").faces, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
        }
        let colored = parse(b"COFF\n1 0 0\n0 0 0 255 128 0 255\n").expect("readable");
        assert_eq!(colored.colors, Some(vec![[255, 128, 0]]));
    }

    #[test]
    fn lies_and_cuts_are_named() {
        assert!(parse(b"OFF\n1000000000000 5 0\n0 0 0\n").expect_err("lie").contains("claims 1000000000000 vertices"));
        assert!(parse(b"OFF\n2 1 0\n0 0 0        \n").expect_err("cut").contains("ends before vertex 1"));
        assert!(parse(b"OFF\n1 1 0\n0 0 0\n3 0 0 5\n").expect_err("index").contains("there are 1 vertices"));
        assert!(parse(b"OFF BINARY\n1 1 0\n").is_err());
    }
}
