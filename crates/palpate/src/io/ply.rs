//! PLY (Turk 1994): ascii and both binary byte orders in, binary little endian out.
//!
//! Read by ourselves: ply-rs-bw 4.0.1 rejects `nan`, `1.` and `.5` in ascii files, merges properties of the same name (which
//! shifts everything behind them in a binary file), and counts through an element of 10¹² items that have no property.

use super::raw::{Lines, Raw, check_claim, number, unit_to_byte, words};
use crate::geometry::{Point, Vector};
use std::io::{self, Write};

#[derive(Debug, Clone, Copy, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(word: &[u8]) -> Result<Self, String> {
        Ok(match word {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return Err(format!("'{}' is not a PLY type", String::from_utf8_lossy(word))),
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// A channel of this type as 0–255.
    fn channel(self, value: f64) -> u8 {
        match self {
            Self::F32 | Self::F64 => unit_to_byte(value),
            Self::U16 => unit_to_byte(value / 65535.0),
            _ => value.clamp(0.0, 255.0) as u8,
        }
    }
}

struct Property {
    name: Vec<u8>,
    /// Type of the length, if it is a list.
    length: Option<Scalar>,
    scalar: Scalar,
}

struct Element {
    name: Vec<u8>,
    count: u64,
    properties: Vec<Property>,
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

/// Values in file order, whatever the encoding.
struct Values<'a> {
    bytes: &'a [u8],
    encoding: Encoding,
}

impl<'a> Values<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], String> {
        let (head, rest) = self.bytes.split_at_checked(n).ok_or("the file ends in the middle of its data")?;
        self.bytes = rest;
        Ok(head)
    }

    fn next(&mut self, scalar: Scalar) -> Result<f64, String> {
        if self.encoding == Encoding::Ascii {
            let start = self
                .bytes
                .iter()
                .position(|b| !b.is_ascii_whitespace())
                .ok_or("the file ends in the middle of its data")?;
            let text = &self.bytes[start..];
            let end = text.iter().position(u8::is_ascii_whitespace).unwrap_or(text.len());
            self.bytes = &text[end..];
            return number(&text[..end]);
        }
        let mut word = [0; 8];
        let n = scalar.size();
        word[..n].copy_from_slice(self.take(n)?);
        if self.encoding == Encoding::Big {
            word[..n].reverse();
        }
        let [a, b, c, d, ..] = word;
        Ok(match scalar {
            Scalar::I8 => f64::from(a as i8),
            Scalar::U8 => f64::from(a),
            Scalar::I16 => f64::from(i16::from_le_bytes([a, b])),
            Scalar::U16 => f64::from(u16::from_le_bytes([a, b])),
            Scalar::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Scalar::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Scalar::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Scalar::F64 => f64::from_le_bytes(word),
        })
    }

    fn index(&mut self, scalar: Scalar, what: &str) -> Result<u32, String> {
        let value = self.next(scalar)?;
        if value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value) {
            Ok(value as u32)
        } else {
            Err(format!("{value} is not a possible {what}"))
        }
    }
}

/// Reads vertices (with normals and colours, if there) and faces; everything else is skipped.
pub(super) fn parse(bytes: &[u8]) -> Result<Raw, String> {
    let (encoding, elements, body) = header(bytes)?;
    let mut values = Values { bytes: body, encoding };
    let mut raw = Raw::default();
    for element in &elements {
        let least: usize = element
            .properties
            .iter()
            .map(|p| if encoding == Encoding::Ascii { 2 } else { p.length.unwrap_or(p.scalar).size() })
            .sum();
        let name = String::from_utf8_lossy(&element.name).into_owned();
        let count = check_claim(&format!("'{name}' elements"), element.count, least as u64, values.bytes.len())?;
        let at = |i: usize| {
            move |reason: String| format!("{name} {i}: {reason}", name = String::from_utf8_lossy(&element.name))
        };
        if least == 0 {
            continue; // items without a property take no space
        }
        match element.name.as_slice() {
            b"vertex" => vertices(&mut values, element, count, &mut raw)?,
            b"face" => {
                let mut corners = Vec::new();
                for i in 0..count {
                    face(&mut values, element, &mut corners).map_err(at(i))?;
                    raw.push_polygon(&corners);
                }
            }
            _ => {
                for i in 0..count {
                    element.properties.iter().try_for_each(|p| skip(&mut values, p)).map_err(at(i))?;
                }
            }
        }
    }
    raw.check_indices()?;
    Ok(raw)
}

fn header(bytes: &[u8]) -> Result<(Encoding, Vec<Element>, &[u8]), String> {
    let mut lines = Lines::new(bytes);
    if lines.next_line().is_none_or(|(_, line)| line.trim_ascii() != b"ply") {
        return Err("the first line is not 'ply'".into());
    }
    let (mut encoding, mut elements) = (None, Vec::<Element>::new());
    while let Some((n, line)) = lines.next_line() {
        let at = |reason: String| format!("line {n}: {reason}");
        let mut words = words(line);
        match words.next() {
            Some(b"format") => {
                encoding = Some(match words.next() {
                    Some(b"ascii") => Encoding::Ascii,
                    Some(b"binary_little_endian") => Encoding::Little,
                    Some(b"binary_big_endian") => Encoding::Big,
                    _ => return Err(at("the format must be ascii, binary_little_endian or binary_big_endian".into())),
                });
            }
            None | Some(b"comment" | b"obj_info") => {}
            Some(b"element") => {
                let (Some(name), Some(count)) = (words.next(), words.next()) else {
                    return Err(at("an element needs a name and a number".into()));
                };
                elements.push(Element {
                    name: name.to_vec(),
                    count: number(count).map_err(at)?,
                    properties: Vec::new(),
                });
            }
            Some(b"property") => {
                let element = elements.last_mut().ok_or_else(|| at("a property before any element".into()))?;
                element.properties.push(property(&mut words).map_err(at)?);
            }
            Some(b"end_header") => {
                return Ok((encoding.ok_or("the header has no format line")?, elements, lines.rest()));
            }
            Some(word) => return Err(at(format!("'{}' is not a header keyword", String::from_utf8_lossy(word)))),
        }
    }
    Err("the header has no end".into())
}

fn property<'a>(words: &mut impl Iterator<Item = &'a [u8]>) -> Result<Property, String> {
    let mut next = || words.next().ok_or_else(|| "a property needs a type and a name".to_string());
    let kind = next()?;
    let (length, scalar) = if kind == b"list" {
        let length = Scalar::parse(next()?)?;
        if matches!(length, Scalar::F32 | Scalar::F64) {
            return Err("the length of a list must be an integer type".into());
        }
        (Some(length), Scalar::parse(next()?)?)
    } else {
        (None, Scalar::parse(kind)?)
    };
    Ok(Property { name: next()?.to_vec(), length, scalar })
}

fn skip(values: &mut Values, property: &Property) -> Result<(), String> {
    let items = match property.length {
        None => 1,
        Some(length) => values.index(length, "list length")? as usize,
    };
    if values.encoding == Encoding::Ascii {
        (0..items).try_for_each(|_| values.next(property.scalar).map(|_| ()))
    } else {
        values.take(items.saturating_mul(property.scalar.size())).map(|_| ())
    }
}

/// Where a vertex property goes: 0–2 position, 3–5 normal, 6–8 colour, 9 σ, 10 provenance.
fn slot(name: &[u8]) -> Option<usize> {
    let names: [&[&[u8]]; 11] = [
        &[b"x"],
        &[b"y"],
        &[b"z"],
        &[b"nx", b"normal_x"],
        &[b"ny", b"normal_y"],
        &[b"nz", b"normal_z"],
        &[b"red", b"r", b"diffuse_red"],
        &[b"green", b"g", b"diffuse_green"],
        &[b"blue", b"b", b"diffuse_blue"],
        &[b"sigma_mm"],
        &[b"provenance"],
    ];
    names.iter().position(|n| n.contains(&name))
}

fn vertices(values: &mut Values, element: &Element, count: usize, raw: &mut Raw) -> Result<(), String> {
    let slots: Vec<Option<usize>> =
        element.properties.iter().map(|p| if p.length.is_none() { slot(&p.name) } else { None }).collect();
    let has = |range: std::ops::Range<usize>| range.clone().all(|s| slots.contains(&Some(s)));
    if !has(0..3) {
        return Err("the vertices have no x, y and z".into());
    }
    let (has_normals, has_colors) = (has(3..6), has(6..9));
    let (has_sigma, has_provenance) = (has(9..10), has(10..11));
    let (mut normals, mut colors) = (Vec::new(), Vec::new());
    let (mut sigma, mut provenance) = (Vec::new(), Vec::new());
    raw.points.reserve(count);
    for i in 0..count {
        let mut v = [0.0; 11];
        for (property, slot) in element.properties.iter().zip(&slots) {
            let done = match *slot {
                None => skip(values, property),
                Some(s) => values.next(property.scalar).map(|x| {
                    v[s] = if (6..9).contains(&s) { f64::from(property.scalar.channel(x)) } else { x };
                }),
            };
            done.map_err(|reason| format!("vertex {i}: {reason}"))?;
        }
        raw.points.push(Point::new(v[0], v[1], v[2]));
        if has_normals {
            normals.push(Vector::new(v[3], v[4], v[5]));
        }
        if has_colors {
            colors.push([v[6] as u8, v[7] as u8, v[8] as u8]);
        }
        if has_sigma {
            sigma.push(v[9] as f32);
        }
        if has_provenance {
            provenance.push(v[10] as u8);
        }
    }
    raw.normals = has_normals.then_some(normals);
    raw.colors = has_colors.then_some(colors);
    raw.knowledge.sigma_mm = has_sigma.then_some(sigma);
    raw.knowledge.provenance = has_provenance.then_some(provenance);
    Ok(())
}

fn face(values: &mut Values, element: &Element, corners: &mut Vec<u32>) -> Result<(), String> {
    corners.clear();
    for property in &element.properties {
        match (property.length, property.name.as_slice()) {
            (Some(length), b"vertex_indices" | b"vertex_index") => {
                let n = values.index(length, "number of corners")?;
                for _ in 0..n {
                    corners.push(values.index(property.scalar, "vertex index")?);
                }
            }
            _ => skip(values, property)?,
        }
    }
    Ok(())
}

/// A further value of each vertex, written under its own name.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VertexProperty<'a> {
    /// Name in the header: letters, digits and underscores.
    pub name: &'a str,
    /// One value a vertex.
    pub values: PropertyValues<'a>,
}

/// Values of a vertex property and the type they are written as.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum PropertyValues<'a> {
    /// `float`.
    Float(&'a [f32]),
    /// `uchar`.
    Uchar(&'a [u8]),
}

impl PropertyValues<'_> {
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Float(values) => values.len(),
            Self::Uchar(values) => values.len(),
        }
    }
}

/// Writes binary little endian: float positions, float normals and uchar colours where given, then the further properties; int faces if any.
pub(super) fn write(
    w: &mut impl Write,
    points: &[Point],
    normals: Option<&[Vector]>,
    colors: Option<&[[u8; 3]]>,
    faces: Option<&[[u32; 3]]>,
    properties: &[VertexProperty],
) -> io::Result<()> {
    write!(w, "ply\nformat binary_little_endian 1.0\ncomment palpate {}, metres\n", env!("CARGO_PKG_VERSION"))?;
    write!(w, "element vertex {}\nproperty float x\nproperty float y\nproperty float z\n", points.len())?;
    if normals.is_some() {
        w.write_all(b"property float nx\nproperty float ny\nproperty float nz\n")?;
    }
    if colors.is_some() {
        w.write_all(b"property uchar red\nproperty uchar green\nproperty uchar blue\n")?;
    }
    for property in properties {
        let kind = match property.values {
            PropertyValues::Float(_) => "float",
            PropertyValues::Uchar(_) => "uchar",
        };
        writeln!(w, "property {kind} {}", property.name)?;
    }
    if let Some(faces) = faces {
        write!(w, "element face {}\nproperty list uchar int vertex_indices\n", faces.len())?;
    }
    w.write_all(b"end_header\n")?;
    for (i, p) in points.iter().enumerate() {
        let floats = p.iter().chain(normals.map(|n| &n[i]).into_iter().flatten());
        for &x in floats {
            w.write_all(&(x as f32).to_le_bytes())?;
        }
        if let Some(colors) = colors {
            w.write_all(&colors[i])?;
        }
        for property in properties {
            match property.values {
                PropertyValues::Float(values) => w.write_all(&values[i].to_le_bytes())?,
                PropertyValues::Uchar(values) => w.write_all(&[values[i]])?,
            }
        }
    }
    for face in faces.into_iter().flatten() {
        w.write_all(&[3])?;
        for &i in face {
            w.write_all(&i.to_le_bytes())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: &str = "ply\nformat ascii 1.0\ncomment hand-made\nelement vertex 4\nproperty double x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nproperty list uchar int extra\nelement face 1\nproperty uchar flags\nproperty list uchar int vertex_indices\nend_header\n0 0 0 255 0 0 0\n1. 0 0 0 255 0 1 7\n1 1 .5 0 0 255 2 7 7\n0 1 nan 9 9 9 0\n1 4 0 1 2 3\n";

    #[test]
    fn ascii_with_lists_and_a_polygon() {
        let raw = parse(SQUARE.as_bytes()).expect("readable");
        assert_eq!(raw.faces, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(raw.points[2], Point::new(1.0, 1.0, 0.5));
        assert!(raw.points[3].z.is_nan());
        assert_eq!(raw.colors.expect("colours")[1], [0, 255, 0]);
    }

    #[test]
    fn big_endian() {
        let mut bytes = b"ply\nformat binary_big_endian 1.0\nelement vertex 1\nproperty short x\nproperty float y\nproperty double z\nend_header\n".to_vec();
        bytes.extend((-2i16).to_be_bytes());
        bytes.extend(0.25f32.to_be_bytes());
        bytes.extend(1e-3f64.to_be_bytes());
        assert_eq!(parse(&bytes).expect("readable").points, [Point::new(-2.0, 0.25, 1e-3)]);
    }

    #[test]
    fn claims_are_checked_before_anything_is_allocated() {
        for format in ["ascii", "binary_little_endian"] {
            let text = format!(
                "ply\nformat {format} 1.0\nelement vertex 1000000000000\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n"
            );
            let reason = parse(text.as_bytes()).expect_err("a lie");
            assert!(reason.contains("claims 1000000000000 'vertex' elements"), "{reason}");
        }
        // Items without a property take no bytes: nothing to count through.
        let empty = "ply\nformat ascii 1.0\nelement nothing 1000000000000\nend_header\n";
        assert_eq!(parse(empty.as_bytes()).expect("harmless").points.len(), 0);
        let list = b"ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list uint int vertex_indices\nend_header\n\xff\xff\xff\xff".to_vec();
        assert!(parse(&list).expect_err("a lie").contains("ends in the middle"));
    }

    #[test]
    fn bad_index_and_negative_length_are_named() {
        let bad = SQUARE.replace("1 4 0 1 2 3", "1 3 0 1 9");
        assert!(parse(bad.as_bytes()).expect_err("index").contains("there are 4 vertices"));
        let negative = SQUARE.replace("1 4 0 1 2 3", "1 -3 0 1 2");
        assert!(parse(negative.as_bytes()).expect_err("length").contains("-3 is not a possible number of corners"));
    }
}
