//! STL, binary and ascii; corners at exactly the same position become one vertex.
//!
//! Read by ourselves: stl_io 0.11 takes a binary file whose header begins with "solid " for text, reads only the first of several
//! solids, and keeps 0 and −0 apart when welding, which leaves cracks along coordinate planes.

use super::raw::{Raw, check_claim, number};
use crate::geometry::{Point, TriangleMesh};
use std::collections::HashMap;
use std::io::{self, Write};

pub(super) fn parse(bytes: &[u8]) -> Result<Raw, String> {
    let claimed = bytes.get(80..84).map(|n| u64::from(u32::from_le_bytes([n[0], n[1], n[2], n[3]])));
    let exact = claimed.is_some_and(|n| bytes.len() as u64 == 84 + 50 * n);
    if !exact && bytes.trim_ascii_start().get(..5).is_some_and(|w| w.eq_ignore_ascii_case(b"solid")) {
        return ascii(bytes);
    }
    let claimed = claimed.ok_or_else(|| format!("{} bytes: a binary file has at least 84", bytes.len()))?;
    check_claim("triangles", claimed, 50, (bytes.len() - 84).saturating_sub(1))?;
    let mut weld = Weld::default();
    for record in bytes[84..].chunks_exact(50).take(claimed as usize) {
        let mut values = record[12..48].chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let mut next = || values.next().unwrap_or(f32::NAN);
        weld.triangle([(); 3].map(|()| [next(), next(), next()]));
    }
    Ok(weld.raw)
}

fn ascii(bytes: &[u8]) -> Result<Raw, String> {
    let mut weld = Weld::default();
    let (mut corners, mut open) = (Vec::with_capacity(3), false);
    let mut words = bytes.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
    while let Some(word) = words.next() {
        if word.eq_ignore_ascii_case(b"vertex") {
            let mut next = || number::<f32>(words.next().ok_or("the file ends in the middle of a vertex")?);
            corners.push([next()?, next()?, next()?]);
        } else if word.eq_ignore_ascii_case(b"endfacet") {
            let triangle = <[[f32; 3]; 3]>::try_from(corners.as_slice())
                .map_err(|_| format!("triangle {} has {} corners", weld.triangles, corners.len()))?;
            weld.triangle(triangle);
            corners.clear();
        } else if word.eq_ignore_ascii_case(b"facet") {
            open = true;
        } else if word.eq_ignore_ascii_case(b"endsolid") {
            open = false;
        }
    }
    if open || !corners.is_empty() {
        return Err(format!("the text ends without 'endsolid' after {} triangles: cut short", weld.triangles));
    }
    Ok(weld.raw)
}

#[derive(Default)]
struct Weld {
    raw: Raw,
    triangles: usize,
    index: HashMap<[u32; 3], u32>,
}

impl Weld {
    fn triangle(&mut self, corners: [[f32; 3]; 3]) {
        self.triangles += 1;
        let face = corners.map(|c| {
            // Adding +0 turns −0 into 0.
            *self.index.entry(c.map(|x| (x + 0.0).to_bits())).or_insert_with(|| {
                self.raw.points.push(Point::new(c[0].into(), c[1].into(), c[2].into()));
                self.raw.points.len() as u32 - 1
            })
        });
        let [a, b, c] = face;
        // A triangle of two positions has no area, and its neighbours close over it.
        if a != b && b != c && c != a {
            self.raw.faces.push(face);
        }
    }
}

pub(super) fn write(w: &mut impl Write, mesh: &TriangleMesh) -> io::Result<()> {
    let mut header = [0; 80];
    let text = format!("palpate {}, metres", env!("CARGO_PKG_VERSION"));
    header[..text.len()].copy_from_slice(text.as_bytes());
    w.write_all(&header)?;
    let count = u32::try_from(mesh.faces.len()).map_err(|_| io::Error::other("STL holds at most 2³² triangles"))?;
    w.write_all(&count.to_le_bytes())?;
    for face in 0..mesh.faces.len() {
        let normal = mesh.face_normal(face);
        for x in normal.iter().chain(mesh.triangle(face).iter().flat_map(|p| p.iter())) {
            w.write_all(&(*x as f32).to_le_bytes())?;
        }
        w.write_all(&[0; 2])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facet(corners: &str) -> String {
        format!("facet normal 0 0 1\nouter loop\n{corners}\nendloop\nendfacet\n")
    }

    #[test]
    fn ascii_welds_zero_with_minus_zero_over_several_solids() {
        let text = format!(
            "solid a\n{}endsolid a\nsolid b\n{}endsolid b\n",
            facet("vertex 0 0 0 vertex 1 0 0 vertex 0 1 0"),
            facet("vertex -0 0 0 vertex 0 -1 0 vertex 1 0 -0")
        );
        let raw = parse(text.as_bytes()).expect("readable");
        assert_eq!(raw.faces, [[0, 1, 2], [0, 3, 1]]);
        assert!(parse(&text.as_bytes()[..text.len() - 12]).expect_err("cut").contains("without 'endsolid'"));
    }

    #[test]
    fn a_binary_file_may_begin_with_solid() {
        let mesh = TriangleMesh::new(
            vec![Point::origin(), Point::new(1.0, 0.0, 0.0), Point::new(0.0, 1.0, 0.0)],
            vec![[0, 1, 2]],
        );
        let mut bytes = Vec::new();
        write(&mut bytes, &mesh.expect("valid")).expect("memory");
        bytes[..6].copy_from_slice(b"solid ");
        assert_eq!(parse(&bytes).expect("readable").faces, [[0, 1, 2]]);
        let cut =
            parse(&bytes[..bytes.len() - 1].iter().map(|b| if *b == b's' { b'S' + 1 } else { *b }).collect::<Vec<_>>());
        assert!(cut.expect_err("cut").contains("claims 1 triangles"));
    }
}
