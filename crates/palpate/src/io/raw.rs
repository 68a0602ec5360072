//! What every mesh and cloud format boils down to, and the small tools of their parsers.

use crate::geometry::{Point, Vector};

/// Parser output before any check of the coordinates.
#[derive(Debug, Default)]
pub(super) struct Raw {
    pub(super) points: Vec<Point>,
    pub(super) normals: Option<Vec<Vector>>,
    pub(super) colors: Option<Vec<[u8; 3]>>,
    pub(super) faces: Vec<[u32; 3]>,
    pub(super) knowledge: VertexValues,
}

/// What a `.ply` of a reconstruction says of each vertex; absent where the file does not.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct VertexValues {
    /// How far the vertex may be off, millimetres.
    pub sigma_mm: Option<Vec<f32>>,
    /// What it rests on: 0 seen, 1 felt, 2 guessed, 3 extrapolated.
    pub provenance: Option<Vec<u8>>,
}

impl Raw {
    /// Adds a polygon as a fan of triangles (exact for convex ones; watertight for all). Fewer than three corners: nothing.
    pub(super) fn push_polygon(&mut self, corners: &[u32]) {
        if let [first, rest @ ..] = corners {
            self.faces.extend(rest.windows(2).map(|edge| [*first, edge[0], edge[1]]));
        }
    }

    /// Says which face points past the vertices, if one does.
    pub(super) fn check_indices(&self) -> Result<(), String> {
        let n = self.points.len();
        match self.faces.iter().enumerate().find(|(_, f)| f.iter().any(|&i| i as usize >= n)) {
            Some((face, corners)) => {
                Err(format!("triangle {face} has the corners {corners:?}, but there are {n} vertices"))
            }
            None => Ok(()),
        }
    }
}

/// Compares a header's claim with what is there. `each` is the least number of bytes that an item can take.
pub(super) fn check_claim(what: &str, claimed: u64, each: u64, available: usize) -> Result<usize, String> {
    // One byte of slack: the last line of a text file may lack its line break.
    if u128::from(claimed) * u128::from(each) > available as u128 + 1 {
        return Err(format!(
            "the header claims {claimed} {what}, at least {each} bytes each, but {available} bytes are left: cut short, or the header is wrong"
        ));
    }
    usize::try_from(claimed).map_err(|_| format!("the header claims {claimed} {what}"))
}

/// Text tokens with their line, for messages.
pub(super) struct Lines<'a> {
    bytes: &'a [u8],
    number: usize,
}

impl<'a> Lines<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, number: 0 }
    }

    /// The next line without its break, and its number from 1.
    pub(super) fn next_line(&mut self) -> Option<(usize, &'a [u8])> {
        if self.bytes.is_empty() {
            return None;
        }
        let end = self.bytes.iter().position(|&b| b == b'\n');
        let (line, rest) = match end {
            Some(end) => (&self.bytes[..end], &self.bytes[end + 1..]),
            None => (self.bytes, &[][..]),
        };
        self.bytes = rest;
        self.number += 1;
        Some((self.number, line.strip_suffix(b"\r").unwrap_or(line)))
    }

    /// The next line that holds more than blanks and a comment after `#`.
    pub(super) fn next_content(&mut self) -> Option<(usize, &'a [u8])> {
        loop {
            let (number, line) = self.next_line()?;
            let line = line.split(|&b| b == b'#').next().unwrap_or(line);
            if !line.trim_ascii().is_empty() {
                return Some((number, line));
            }
        }
    }

    /// What has not been read yet.
    pub(super) fn rest(&self) -> &'a [u8] {
        self.bytes
    }
}

/// The words of a line.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty())
}

/// A number in any notation that Rust reads (`1.`, `.5`, `-1e-3`, `nan`, `inf`).
pub(super) fn number<T: std::str::FromStr>(word: &[u8]) -> Result<T, String> {
    let text = std::str::from_utf8(word).ok();
    text.and_then(|t| t.parse().ok()).ok_or_else(|| {
        format!("'{}' is not a number that fits here", String::from_utf8_lossy(&word[..word.len().min(40)]))
    })
}

/// Three numbers.
pub(super) fn triple<'a>(words: &mut impl Iterator<Item = &'a [u8]>) -> Result<[f64; 3], String> {
    let mut next = || number::<f64>(words.next().ok_or("three numbers are needed")?);
    Ok([next()?, next()?, next()?])
}

/// A colour channel given as 0–1.
pub(super) fn unit_to_byte(value: f64) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}
