//! PCD 0.5–0.7 (Point Cloud Library): ascii, binary and binary_compressed.
//!
//! Read by ourselves: pcd-rs 0.13 panics when a compressed file unpacks to fewer bytes than its header claims, and allocates
//! what the header says before it looks at the file. The viewpoint is skipped: points stay in the frame they are stored in.

use super::raw::{Lines, Raw, check_claim, number, words};
use crate::geometry::{Point, Vector};

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Signed,
    Unsigned,
    Float,
}

struct Field {
    name: Vec<u8>,
    size: usize,
    kind: Kind,
    count: usize,
}

impl Field {
    fn bytes(&self) -> usize {
        self.size * self.count
    }

    /// The first value of the field from its stored bytes.
    fn value(&self, bytes: &[u8]) -> f64 {
        let mut word = [0; 8];
        word[..self.size].copy_from_slice(&bytes[..self.size]);
        let [a, b, c, d, ..] = word;
        match (self.kind, self.size) {
            (Kind::Float, 4) => f64::from(f32::from_le_bytes([a, b, c, d])),
            (Kind::Float, _) => f64::from_le_bytes(word),
            (Kind::Signed, 1) => f64::from(a as i8),
            (Kind::Signed, 2) => f64::from(i16::from_le_bytes([a, b])),
            (Kind::Signed, 4) => f64::from(i32::from_le_bytes([a, b, c, d])),
            (Kind::Signed, _) => i64::from_le_bytes(word) as f64,
            (Kind::Unsigned, _) => u64::from_le_bytes(word) as f64,
        }
    }
}

enum Encoding {
    Ascii,
    Binary,
    Compressed,
}

struct Header {
    fields: Vec<Field>,
    points: u64,
    encoding: Encoding,
}

/// Most bytes of one point: real files have under a hundred; the bound keeps every product far from overflow.
const RECORD_LIMIT: usize = 1 << 16;

/// Reads positions, with normals and packed colours where there are fields for them. NaN points are kept here.
pub(super) fn parse(bytes: &[u8]) -> Result<Raw, String> {
    let mut lines = Lines::new(bytes);
    let header = header(&mut lines)?;
    let record: usize = header.fields.iter().map(Field::bytes).sum();
    let mut columns = Columns::new(&header.fields)?;
    let body = lines.rest();
    match header.encoding {
        Encoding::Ascii => {
            let each = 2 * header.fields.iter().map(|f| f.count).sum::<usize>();
            let points = check_claim("points", header.points, each as u64, body.len())?;
            for i in 0..points {
                let (n, line) =
                    lines.next_content().ok_or_else(|| format!("the file ends before point {i} of {points}"))?;
                columns.push_text(line, &header.fields).map_err(|reason| format!("line {n}: {reason}"))?;
            }
        }
        Encoding::Binary => {
            let points = claim_exact(header.points, record, body.len())?;
            for point in body.chunks_exact(record).take(points) {
                columns
                    .push(|field, offset| header.fields[field].value(&point[offset..]), |offset| word(point, offset));
            }
        }
        Encoding::Compressed => {
            let size = |at: usize| body.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
            let (Some(packed), Some(unpacked)) = (size(0), size(4)) else {
                return Err("the file ends before the sizes of its compressed data".into());
            };
            let data = body[8..].get(..packed).ok_or_else(|| {
                format!("{packed} compressed bytes are announced, but {} are left: cut short", body.len() - 8)
            })?;
            let points = claim_exact(header.points, record, unpacked)?;
            let data = lzf_decompress(data, unpacked)?;
            // Stored field by field: field f of point i lies at points · (bytes before f) + i · (bytes of f).
            for i in 0..points {
                let at = |offset: usize, bytes: usize| points * offset + i * bytes;
                columns.push(
                    |field, offset| header.fields[field].value(&data[at(offset, header.fields[field].bytes())..]),
                    |offset| word(&data, at(offset, 4)),
                );
            }
        }
    }
    Ok(columns.into_raw())
}

fn word(bytes: &[u8], offset: usize) -> u32 {
    let b = &bytes[offset..offset + 4];
    u32::from_le_bytes([b[0], b[1], b[2], b[3]])
}

fn claim_exact(points: u64, record: usize, available: usize) -> Result<usize, String> {
    check_claim("points", points, record as u64, available.saturating_sub(1))
}

fn header(lines: &mut Lines) -> Result<Header, String> {
    let (mut names, mut sizes, mut kinds, mut counts) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut points, mut extent) = (None, [None, None]);
    while let Some((n, line)) = lines.next_content() {
        let at = |reason: String| format!("line {n}: {reason}");
        let mut words = words(line);
        let keyword = words.next().unwrap_or_default();
        let mut one = || number::<u64>(words.next().unwrap_or_default()).map_err(at);
        match keyword {
            b"FIELDS" | b"COLUMNS" => names = words.map(<[u8]>::to_vec).collect(),
            b"SIZE" => sizes = words.map(number::<usize>).collect::<Result<_, _>>().map_err(at)?,
            b"TYPE" => {
                kinds = words
                    .map(|w| match w {
                        b"I" => Ok(Kind::Signed),
                        b"U" => Ok(Kind::Unsigned),
                        b"F" => Ok(Kind::Float),
                        _ => Err(at(format!("'{}' is not a TYPE (I, U or F)", String::from_utf8_lossy(w)))),
                    })
                    .collect::<Result<_, _>>()?;
            }
            b"COUNT" => counts = words.map(number::<usize>).collect::<Result<_, _>>().map_err(at)?,
            b"POINTS" => points = Some(one()?),
            b"WIDTH" => extent[0] = Some(one()?),
            b"HEIGHT" => extent[1] = Some(one()?),
            b"DATA" => {
                let encoding = match words.next() {
                    Some(b"ascii") => Encoding::Ascii,
                    Some(b"binary") => Encoding::Binary,
                    Some(b"binary_compressed") => Encoding::Compressed,
                    _ => return Err(at("DATA must be ascii, binary or binary_compressed".into())),
                };
                let product = extent[0].and_then(|w| w.checked_mul(extent[1].unwrap_or(1)));
                let points = points.or(product).ok_or("the header has no POINTS")?;
                return Ok(Header { fields: fields(names, &sizes, &kinds, &counts)?, points, encoding });
            }
            b"VERSION" | b"VIEWPOINT" => {}
            _ => {
                return Err(at(format!(
                    "'{}' is not a header keyword",
                    String::from_utf8_lossy(&keyword[..keyword.len().min(20)])
                )));
            }
        }
    }
    Err("the header has no DATA line".into())
}

fn fields(names: Vec<Vec<u8>>, sizes: &[usize], kinds: &[Kind], counts: &[usize]) -> Result<Vec<Field>, String> {
    let n = names.len();
    if n == 0 || sizes.len() != n || kinds.len() != n || (!counts.is_empty() && counts.len() != n) {
        return Err(format!(
            "{n} FIELDS, {} SIZE, {} TYPE and {} COUNT entries: they must agree",
            sizes.len(),
            kinds.len(),
            counts.len()
        ));
    }
    let mut fields = Vec::with_capacity(n);
    for (i, name) in names.into_iter().enumerate() {
        let (size, kind) = (sizes[i], kinds[i]);
        if !matches!((kind, size), (Kind::Float, 4 | 8) | (Kind::Signed | Kind::Unsigned, 1 | 2 | 4 | 8)) {
            return Err(format!(
                "field '{}' has a SIZE of {size} that its TYPE cannot have",
                String::from_utf8_lossy(&name)
            ));
        }
        // The Point Cloud Library takes a COUNT of 0 for 1.
        let count = counts.get(i).map_or(1, |&c| c.max(1));
        if count > RECORD_LIMIT / 8 {
            return Err(format!("field '{}' has a COUNT of {count}", String::from_utf8_lossy(&name)));
        }
        fields.push(Field { name, size, kind, count });
    }
    if fields.iter().map(Field::bytes).sum::<usize>() > RECORD_LIMIT {
        return Err(format!("a point of more than {RECORD_LIMIT} bytes"));
    }
    Ok(fields)
}

/// Where the wanted values are, and the values so far.
struct Columns {
    /// Field number and byte offset of x, y, z.
    position: [(usize, usize); 3],
    normal: Option<[(usize, usize); 3]>,
    color: Option<(usize, usize)>,
    points: Vec<Point>,
    normals: Vec<Vector>,
    colors: Vec<[u8; 3]>,
}

impl Columns {
    fn new(fields: &[Field]) -> Result<Self, String> {
        let find = |name: &str| {
            let i = fields.iter().position(|f| f.name == name.as_bytes())?;
            Some((i, fields[..i].iter().map(Field::bytes).sum()))
        };
        let three = |names: [&str; 3]| Some([find(names[0])?, find(names[1])?, find(names[2])?]);
        Ok(Self {
            position: three(["x", "y", "z"]).ok_or("there are no fields x, y and z")?,
            normal: three(["normal_x", "normal_y", "normal_z"]),
            color: find("rgb").or_else(|| find("rgba")).filter(|c| fields[c.0].size == 4),
            points: Vec::new(),
            normals: Vec::new(),
            colors: Vec::new(),
        })
    }

    fn push(&mut self, value: impl Fn(usize, usize) -> f64, packed: impl Fn(usize) -> u32) {
        self.points.push(Point::from(self.position.map(|(f, o)| value(f, o))));
        if let Some(normal) = self.normal {
            self.normals.push(Vector::from(normal.map(|(f, o)| value(f, o))));
        }
        if let Some((_, offset)) = self.color {
            let [b, g, r, _] = packed(offset).to_le_bytes();
            self.colors.push([r, g, b]);
        }
    }

    fn push_text(&mut self, line: &[u8], fields: &[Field]) -> Result<(), String> {
        let words: Vec<&[u8]> = words(line).collect();
        let starts: Vec<usize> = fields.iter().scan(0, |at, f| Some(std::mem::replace(at, *at + f.count))).collect();
        let needed: usize = fields.iter().map(|f| f.count).sum();
        if words.len() != needed {
            return Err(format!("{} values, {needed} are needed", words.len()));
        }
        let wanted = self.position.into_iter().chain(self.normal.into_iter().flatten());
        let mut values = vec![0.0; fields.len()];
        for (field, _) in wanted {
            values[field] = number::<f64>(words[starts[field]])?;
        }
        let mut packed = 0;
        if let Some((field, _)) = self.color {
            let text = words[starts[field]];
            packed = match fields[field].kind {
                Kind::Float => number::<f32>(text)?.to_bits(),
                _ => number::<i64>(text)? as u32,
            };
        }
        self.push(|field, _| values[field], |_| packed);
        Ok(())
    }

    fn into_raw(self) -> Raw {
        Raw {
            points: self.points,
            normals: self.normal.map(|_| self.normals),
            colors: self.color.map(|_| self.colors),
            ..Raw::default()
        }
    }
}

/// Unpacks LZF (Lehmann's liblzf stream format): a control byte below 32 is followed by that many bytes + 1 as they are,
/// any other one means "repeat": 3 bits length − 2 (7: one more byte), 13 bits distance − 1.
fn lzf_decompress(packed: &[u8], unpacked: usize) -> Result<Vec<u8>, String> {
    // Three bytes make 264 at most.
    if unpacked / 88 > packed.len() + 3 {
        return Err(format!("{} compressed bytes cannot unpack to {unpacked}", packed.len()));
    }
    let mut out: Vec<u8> = Vec::with_capacity(unpacked);
    let mut rest = packed;
    let cut = "the compressed data ends in the middle of a command";
    while let Some((&control, after)) = rest.split_first() {
        rest = after;
        if control < 32 {
            let (literal, after) = rest.split_at_checked(usize::from(control) + 1).ok_or(cut)?;
            out.extend_from_slice(literal);
            rest = after;
        } else {
            let mut next = || {
                let (&byte, after) = rest.split_first().ok_or(cut)?;
                rest = after;
                Ok::<usize, &str>(usize::from(byte))
            };
            let mut n = usize::from(control >> 5) + 2;
            if n == 9 {
                n += next()?;
            }
            let distance = (usize::from(control & 31) << 8) + next()? + 1;
            let from = out.len().checked_sub(distance).ok_or("the compressed data refers to before its beginning")?;
            // Source and target may overlap: that is how runs are stored.
            for i in from..from + n {
                out.push(out[i]);
            }
        }
        if out.len() > unpacked {
            return Err(format!("the compressed data unpacks to more than the announced {unpacked} bytes"));
        }
    }
    if out.len() == unpacked {
        Ok(out)
    } else {
        Err(format!("unpacked to {} bytes, {unpacked} were announced", out.len()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "# .PCD v.7\nVERSION .7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\n";

    fn red_and_nan() -> [[f32; 4]; 2] {
        [[1.0, 2.0, 3.0, f32::from_bits(0x00ff_0102)], [f32::NAN, 0.0, 0.0, 0.0]]
    }

    fn check(raw: &Raw) {
        assert_eq!(raw.points[0], Point::new(1.0, 2.0, 3.0));
        assert!(raw.points[1].x.is_nan());
        assert_eq!(raw.colors.as_ref().expect("colours")[0], [255, 1, 2]);
    }

    #[test]
    fn the_three_encodings_agree() {
        let points = red_and_nan();
        let ascii = format!("{HEAD}DATA ascii\n1 2 3 {:e}\nnan 0 0 0\n", points[0][3]);
        check(&parse(ascii.as_bytes()).expect("ascii"));

        let mut binary = format!("{HEAD}DATA binary\n").into_bytes();
        binary.extend(points.iter().flatten().flat_map(|x| x.to_le_bytes()));
        check(&parse(&binary).expect("binary"));

        let columns: Vec<u8> = (0..4).flat_map(|f| points.map(|p| p[f].to_le_bytes())).flatten().collect();
        let mut compressed = format!("{HEAD}DATA binary_compressed\n").into_bytes();
        compressed.extend(33u32.to_le_bytes());
        compressed.extend(32u32.to_le_bytes());
        compressed.push(31);
        compressed.extend(&columns);
        check(&parse(&compressed).expect("compressed"));
    }

    #[test]
    fn lzf_repeats_overlapping_runs() {
        // "ab", then 7 bytes from two back (length code 5), then 10 more by the long form.
        assert_eq!(lzf_decompress(&[1, b'a', b'b', 5 << 5, 1], 9).expect("valid"), b"ababababa");
        assert_eq!(lzf_decompress(&[0, b'x', 7 << 5, 1, 0], 11).expect("valid"), b"xxxxxxxxxxx");
        assert!(lzf_decompress(&[1, b'a', b'b', 5 << 5, 9], 9).expect_err("before").contains("before its beginning"));
        assert!(lzf_decompress(&[0, b'x'], 1 << 31).expect_err("lie").contains("cannot unpack"));
    }

    #[test]
    fn lies_and_cuts_are_errors() {
        let lie = HEAD.replace("POINTS 2", "POINTS 1000000000000");
        for data in ["ascii", "binary"] {
            let reason = parse(format!("{lie}DATA {data}\n1 2 3 4\n").as_bytes()).expect_err("lie");
            assert!(reason.contains("claims 1000000000000 points"), "{reason}");
        }
        let mut short = format!("{HEAD}DATA binary_compressed\n").into_bytes();
        short.extend([9, 0, 0, 0, 32, 0, 0, 0, 1, 2]);
        assert!(parse(&short).expect_err("cut").contains("cut short"));
        let wide = HEAD.replace("COUNT 1 1 1 1", "COUNT 1 1 1 18446744073709551615");
        assert!(parse(format!("{wide}DATA binary\n").as_bytes()).is_err());
        // The unpacked data is shorter than the points need.
        let mut few = format!("{HEAD}DATA binary_compressed\n").into_bytes();
        few.extend([2, 0, 0, 0, 1, 0, 0, 0, 0, 7]);
        assert!(parse(&few).expect_err("short").contains("claims 2 points"));
    }
}
