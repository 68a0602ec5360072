//! NumPy arrays (`.npy`, format versions 1 to 3).
//!
//! Read by ourselves: npyz 0.9.1 overflows on the product of a hostile shape, recurses into nested brackets of the header until
//! the stack ends, and reserves what the header claims.

use super::error::read_bytes;
use super::raw::{check_claim, number};
use super::{IoError, atomic_write};
use crate::geometry::Raster;
use std::io::Write as _;
use std::path::{Path, PathBuf};

const FORMAT: &str = "npy";

/// A numeric array of any shape, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct NpyArray {
    /// Size along each axis.
    pub shape: Vec<usize>,
    /// Values, last axis fastest; booleans are 0 and 1.
    pub values: Vec<f64>,
}

/// Reads a numeric or boolean array.
///
/// # Errors
/// [`IoError::Read`], or [`IoError::Malformed`] if it is cut short or holds anything but numbers.
pub fn read_npy(path: impl AsRef<Path>) -> Result<NpyArray, IoError> {
    parse_npy(path.as_ref(), &read_bytes(path.as_ref())?)
}

/// [`read_npy`] from memory; `name` is used in messages.
///
/// # Errors
/// As [`read_npy`].
pub fn parse_npy(name: &Path, bytes: &[u8]) -> Result<NpyArray, IoError> {
    parse(bytes).map_err(|reason| IoError::malformed(name, FORMAT, reason))
}

fn parse(bytes: &[u8]) -> Result<NpyArray, String> {
    let (header, data) = split_header(bytes)?;
    let header = String::from_utf8_lossy(header);
    let kind = value_of(&header, "descr")?;
    let kind = kind.get(1..).and_then(|k| k.split(['\'', '"']).next()).unwrap_or_default();
    let decode = decoder(kind).ok_or_else(|| {
        format!("the type is '{kind}'; booleans, integers and floats of 1, 2, 4 or 8 bytes can be read")
    })?;
    let each = kind.as_bytes().last().map_or(1, |b| usize::from(b - b'0'));
    let fortran = value_of(&header, "fortran_order")?.starts_with("True");
    let shape = value_of(&header, "shape")?.strip_prefix('(').and_then(|s| s.split(')').next()).unwrap_or("?");
    let axes = shape.split(',').map(str::trim).filter(|axis| !axis.is_empty());
    let axes: Vec<u64> = axes.map(|axis| number(axis.as_bytes())).collect::<Result<_, _>>()?;
    let product = axes.iter().try_fold(1u64, |n, &axis| n.checked_mul(axis)).unwrap_or(u64::MAX);
    let claimed = if axes.contains(&0) { 0 } else { product };
    let count = check_claim(&format!("values (shape {axes:?})"), claimed, each as u64, data.len().saturating_sub(1))?;
    let values: Vec<f64> = data.chunks_exact(each).take(count).map(decode).collect();
    let shape: Vec<usize> = axes.iter().map(|&n| n as usize).collect();
    Ok(NpyArray { values: if fortran { row_major(&shape, &values) } else { values }, shape })
}

/// The header's text and the bytes behind it.
fn split_header(bytes: &[u8]) -> Result<(&[u8], &[u8]), String> {
    let version = bytes.get(..8).filter(|b| b.starts_with(b"\x93NUMPY")).ok_or("it does not begin as a NumPy file")?[6];
    let begin = if version == 1 { 10 } else { 12 };
    let length = bytes.get(8..begin).ok_or("the file ends in its header")?;
    let length = length.iter().rev().fold(0, |n, &b| (n << 8) | usize::from(b));
    bytes[begin..].split_at_checked(length).ok_or_else(|| format!("its header of {length} bytes is cut short"))
}

/// What follows `'key':` in the header, a Python dictionary of three entries.
fn value_of<'a>(header: &'a str, key: &str) -> Result<&'a str, String> {
    let mut after = ['\'', '"'].iter().filter_map(|q| header.split_once(&format!("{q}{key}{q}")));
    let value = after.next().and_then(|(_, rest)| rest.trim_start().strip_prefix(':'));
    value.map(str::trim_start).ok_or_else(|| format!("the header has no '{key}'"))
}

/// How to turn the bytes of one value into a number, by NumPy's name of the type.
fn decoder(kind: &str) -> Option<fn(&[u8]) -> f64> {
    macro_rules! number {
        ($t:ty, $from:ident) => {
            |b| <[u8; size_of::<$t>()]>::try_from(b).map_or(f64::NAN, |b| <$t>::$from(b) as f64)
        };
    }
    Some(match kind {
        "|b1" => |b| f64::from(b[0] != 0),
        "|u1" | "<u1" | ">u1" => |b| f64::from(b[0]),
        "|i1" | "<i1" | ">i1" => |b| f64::from(b[0] as i8),
        "<u2" => number!(u16, from_le_bytes),
        "<i2" => number!(i16, from_le_bytes),
        "<u4" => number!(u32, from_le_bytes),
        "<i4" => number!(i32, from_le_bytes),
        "<u8" => number!(u64, from_le_bytes),
        "<i8" => number!(i64, from_le_bytes),
        "<f2" => |b| <[u8; 2]>::try_from(b).map_or(f64::NAN, |b| half::f16::from_le_bytes(b).to_f64()),
        "<f4" => number!(f32, from_le_bytes),
        "<f8" => number!(f64, from_le_bytes),
        ">u2" => number!(u16, from_be_bytes),
        ">i2" => number!(i16, from_be_bytes),
        ">u4" => number!(u32, from_be_bytes),
        ">i4" => number!(i32, from_be_bytes),
        ">u8" => number!(u64, from_be_bytes),
        ">i8" => number!(i64, from_be_bytes),
        ">f4" => number!(f32, from_be_bytes),
        ">f8" => number!(f64, from_be_bytes),
        _ => return None,
    })
}

/// First axis fastest to last axis fastest.
fn row_major(shape: &[usize], values: &[f64]) -> Vec<f64> {
    let mut strides = vec![1usize; shape.len()];
    for axis in 1..shape.len() {
        // Wraps only if another axis is 0, and then nothing is read.
        strides[axis] = strides[axis - 1].wrapping_mul(shape[axis - 1]);
    }
    let mut index = vec![0; shape.len()];
    let mut out = Vec::with_capacity(values.len());
    for _ in 0..values.len() {
        out.push(values[index.iter().zip(&strides).map(|(i, s)| i * s).sum::<usize>()]);
        for axis in (0..shape.len()).rev() {
            index[axis] += 1;
            if index[axis] < shape[axis] {
                break;
            }
            index[axis] = 0;
        }
    }
    out
}

/// Writes an array of 32-bit floats; `values` are row-major and fill `shape`.
///
/// # Errors
/// As [`atomic_write`].
pub fn write_npy(path: impl AsRef<Path>, shape: &[usize], values: &[f32]) -> Result<(), IoError> {
    debug_assert_eq!(shape.iter().product::<usize>(), values.len());
    write_array(path.as_ref(), "<f4", shape, values.iter().map(|v| v.to_le_bytes()))
}

/// Writes a mask (rows, cols) as NumPy booleans.
pub(super) fn write_mask_npy(path: &Path, mask: &Raster<bool>) -> Result<(), IoError> {
    write_array(path, "|b1", &[mask.rows(), mask.cols()], mask.as_slice().iter().map(|&m| [u8::from(m)]))
}

/// Writes values that are already bytes.
pub(super) fn write_array<const N: usize>(
    path: &Path,
    descr: &str,
    shape: &[usize],
    mut values: impl Iterator<Item = [u8; N]>,
) -> Result<(), IoError> {
    // Python writes one axis as `(n,)`, which a trailing comma everywhere covers.
    let axes = shape.iter().fold(String::new(), |text, n| text + &n.to_string() + ", ");
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({}), }}", axes.trim_end());
    // Data begins at a multiple of 64, after a line break (numpy.lib.format).
    let padding = (10 + header.len() + 1).next_multiple_of(64) - (10 + header.len() + 1);
    header.extend(std::iter::repeat_n(' ', padding));
    header.push('\n');
    atomic_write(path, |w| {
        w.write_all(b"\x93NUMPY\x01\x00")?;
        w.write_all(&(header.len() as u16).to_le_bytes())?;
        w.write_all(header.as_bytes())?;
        values.try_for_each(|v| w.write_all(&v))
    })
}

/// One entry at a time of a file with many, along its first axis.
pub(super) struct NpyRows {
    path: PathBuf,
    file: std::fs::File,
    /// First byte of the data.
    begin: u64,
    /// Bytes of one entry.
    each: usize,
    entries: usize,
}

impl NpyRows {
    /// Opens a file of `descr` values whose axes after the first are `shape`; a shorter file than its header says is an error.
    pub(super) fn open(path: &Path, descr: &str, shape: &[usize]) -> Result<Self, IoError> {
        use std::io::Read as _;
        /// More than any header that NumPy writes for a plain array.
        const HEADER_LIMIT: u64 = 4096;
        let failed = |source| IoError::Read { path: path.to_owned(), source };
        let malformed = |reason: String| IoError::malformed(path, FORMAT, reason);
        let file = std::fs::File::open(path).map_err(failed)?;
        let mut start = Vec::new();
        (&file).take(HEADER_LIMIT).read_to_end(&mut start).map_err(failed)?;
        let (header, rest) = split_header(&start).map_err(malformed)?;
        let begin = (start.len() - rest.len()) as u64;
        let header = String::from_utf8_lossy(header);
        let found = value_of(&header, "descr").map_err(malformed)?;
        let axes = value_of(&header, "shape").map_err(malformed)?;
        let axes = axes.strip_prefix('(').and_then(|s| s.split(')').next()).unwrap_or("?");
        let axes: Vec<usize> = axes.split(',').filter_map(|axis| axis.trim().parse().ok()).collect();
        let kind = found.get(1..1 + descr.len()).unwrap_or_default();
        if kind != descr || axes.get(1..) != Some(shape) {
            let reason = format!("it holds '{kind}' of shape {axes:?}; '{descr}' of shape [any, {shape:?}] is needed");
            return Err(malformed(reason));
        }
        let width = usize::from(descr.as_bytes()[descr.len() - 1] - b'0');
        let each = shape.iter().product::<usize>() * width;
        let length = file.metadata().map_err(failed)?.len();
        let needed = (axes[0] as u64).checked_mul(each as u64).and_then(|n| n.checked_add(begin));
        if needed.is_none_or(|needed| length < needed) {
            return Err(malformed(format!(
                "it is cut short: {length} bytes, {} entries of {each} bytes are claimed",
                axes[0]
            )));
        }
        Ok(Self { path: path.to_owned(), file, begin, each, entries: axes[0] })
    }

    /// Bytes of entry `i`.
    pub(super) fn read(&mut self, i: usize) -> Result<Vec<u8>, IoError> {
        use std::io::{Read as _, Seek as _, SeekFrom};
        if i >= self.entries {
            let reason = format!("entry {i} is asked for; it holds {}", self.entries);
            return Err(IoError::malformed(&self.path, FORMAT, reason));
        }
        let mut bytes = vec![0; self.each];
        let at = self.begin + (i * self.each) as u64;
        let done = self.file.seek(SeekFrom::Start(at)).and_then(|_| self.file.read_exact(&mut bytes));
        done.map_err(|source| IoError::Read { path: self.path.clone(), source })?;
        Ok(bytes)
    }
}

/// Reads a height map: two axes (rows, cols), metres. Every value is finite and within 20 mm of the relaxed gel's apex.
///
/// # Errors
/// [`IoError::Malformed`], or [`IoError::Content`] for NaN, infinity, or heights that are surely not metres.
pub fn read_height_map_npy(path: impl AsRef<Path>) -> Result<Raster<f32>, IoError> {
    let path = path.as_ref();
    let array = read_npy(path)?;
    let &[rows, cols] = array.shape.as_slice() else {
        return Err(IoError::content(
            path,
            format!("the shape is {:?}; a height map has two axes (rows, cols)", array.shape),
        ));
    };
    let map =
        Raster::from_vec(rows, cols, array.values.iter().map(|&v| v as f32).collect()).filter(|_| rows * cols > 0);
    let map = map.ok_or_else(|| IoError::content(path, format!("an empty height map ({rows}×{cols})")))?;
    check_heights(path, &map)?;
    Ok(map)
}

/// Largest |z| that a gel pad can have, metres.
const HEIGHT_LIMIT: f32 = 0.020;

fn check_heights(path: &Path, map: &Raster<f32>) -> Result<(), IoError> {
    if let Some((row, col, z)) = map.pixels().find(|(.., z)| !z.is_finite()) {
        let bad = map.as_slice().iter().filter(|z| !z.is_finite()).count();
        return Err(IoError::content(
            path,
            format!("the height at row {row}, column {col} is {z} ({bad} such pixels); finite metres are needed"),
        ));
    }
    let largest = map.as_slice().iter().fold(0.0f32, |m, z| m.max(z.abs()));
    if largest > HEIGHT_LIMIT {
        return Err(IoError::content(
            path,
            format!(
                "|z| reaches {largest}; heights are metres and at most {HEIGHT_LIMIT} (20 mm): is the map in millimetres or in pixels?"
            ),
        ));
    }
    Ok(())
}

/// Writes a height map (rows, cols) as 32-bit floats, metres.
///
/// # Errors
/// As [`atomic_write`].
pub fn write_height_map_npy(path: impl AsRef<Path>, map: &Raster<f32>) -> Result<(), IoError> {
    write_npy(path, &[map.rows(), map.cols()], map.as_slice())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let text = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn byte_orders_and_axis_orders() {
        let data: Vec<u8> = [1.0f64, 2.0, 3.0, 4.0, 5.0, 6.0].iter().flat_map(|x| x.to_be_bytes()).collect();
        let c = parse(&file(">f8", "False", "(2, 3)", &data)).expect("readable");
        assert_eq!((c.shape.as_slice(), c.values.as_slice()), (&[2, 3][..], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0][..]));
        let f = parse(&file(">f8", "True", "(2, 3)", &data)).expect("readable");
        assert_eq!(f.values, [1.0, 3.0, 5.0, 2.0, 4.0, 6.0]);
        assert_eq!(parse(&file("|b1", "False", "(2,)", &[1, 0])).expect("readable").values, [1.0, 0.0]);
    }

    #[test]
    fn claims_nesting_and_cuts_are_errors() {
        let lie = parse(&file("<f4", "False", "(1000000, 1000000)", &[0; 8])).expect_err("lie");
        assert!(lie.contains("claims 1000000000000 values"), "{lie}");
        let overflow = parse(&file("<f4", "False", "(4294967296, 4294967296, 4294967296)", &[0; 8]));
        assert!(overflow.is_err());
        let nested = format!("{}1{}", "(".repeat(2000), ")".repeat(2000));
        assert!(parse(&file("<f4", "False", &nested, &[])).is_err());
        let whole = file("<f4", "False", "(2,)", &[0; 8]);
        for end in 0..whole.len() {
            assert!(parse(&whole[..end]).is_err(), "cut at {end}");
        }
        assert!(parse(&file("|O", "False", "(1,)", &[0; 8])).is_err());
    }

    #[test]
    fn what_is_written_is_read_back() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("map.npy");
        let map = Raster::from_fn(3, 2, |r, c| -1e-3 * r as f32 - 1e-5 * c as f32);
        write_height_map_npy(&path, &map).expect("written");
        assert_eq!(read_height_map_npy(&path).expect("read"), map);
        assert_eq!(std::fs::read(&path).expect("there").len(), 128 + 4 * 6);
        write_npy(&path, &[3], &[1.0, 2.0, 3.0]).expect("written");
        assert_eq!(read_npy(&path).expect("read").shape, [3]);
        assert!(read_height_map_npy(&path).expect_err("one axis").to_string().contains("two axes"));
    }

    #[test]
    fn heights_in_pixels_or_not_numbers_are_refused() {
        let path = Path::new("000_height.npy");
        let pixels = check_heights(path, &Raster::filled(2, 2, -33.9)).expect_err("pixels");
        assert!(pixels.to_string().contains("is the map in millimetres or in pixels?"), "{pixels}");
        let mut map = Raster::filled(2, 2, -0.001);
        assert!(check_heights(path, &map).is_ok());
        map[(1, 0)] = f32::NAN;
        let nan = check_heights(path, &map).expect_err("NaN");
        assert!(nan.to_string().contains("row 1, column 0 is NaN"), "{nan}");
    }
}
