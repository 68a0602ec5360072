//! The ROS 2 messages that a scene is made of.

use crate::CdrReader;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

/// When and in which frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// Nanoseconds.
    pub stamp: i64,
    /// Name of the frame.
    pub frame: String,
}

/// `sensor_msgs/msg/Image`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// When and where.
    pub header: Header,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Like `rgb8` or `16UC1`.
    pub encoding: String,
    /// Byte order of the pixels.
    pub big_endian: bool,
    /// Bytes of a row.
    pub step: usize,
    /// Pixels.
    pub data: Vec<u8>,
}

/// `sensor_msgs/msg/CompressedImage`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CompressedImage {
    /// When and where.
    pub header: Header,
    /// Like `jpeg` or `16UC1; compressedDepth png`.
    pub format: String,
    /// The file.
    pub data: Vec<u8>,
}

/// `sensor_msgs/msg/CameraInfo`, as far as it matters.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraInfo {
    /// When and where.
    pub header: Header,
    /// Image height.
    pub height: usize,
    /// Image width.
    pub width: usize,
    /// Like `plumb_bob`.
    pub model: String,
    /// Its coefficients.
    pub distortion: Vec<f64>,
    /// fx 0 cx 0 fy cy 0 0 1.
    pub k: [f64; 9],
    /// Projection matrix, 3 × 4.
    pub p: [f64; 12],
}

/// `sensor_msgs/msg/PointCloud2`, its points.
#[derive(Debug, Clone, PartialEq)]
pub struct PointCloud2 {
    /// When and where.
    pub header: Header,
    /// Positions, metres; those that are not finite left out.
    pub points: Vec<[f64; 3]>,
}

/// `geometry_msgs/msg/PoseStamped`.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseStamped {
    /// When, and the frame in which the pose is given.
    pub header: Header,
    /// The pose.
    pub pose: Isometry3<f64>,
}

/// One transform of `tf2_msgs/msg/TFMessage`.
#[derive(Debug, Clone, PartialEq)]
pub struct TransformStamped {
    /// When, and the parent.
    pub header: Header,
    /// The child.
    pub child: String,
    /// From the child's frame to the parent's.
    pub parent_from_child: Isometry3<f64>,
}

impl Header {
    fn read(r: &mut CdrReader) -> Result<Self, String> {
        let (seconds, nanoseconds) = (r.i32()?, r.u32()?);
        let frame = r.string()?;
        let stamp = i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds);
        // tf calls the same frame with and without a leading slash.
        Ok(Self { stamp, frame: frame.trim_start_matches('/').to_owned() })
    }

    /// The header alone, of any message that begins with one.
    ///
    /// # Errors
    /// What is wrong with the message.
    pub fn of(message: &[u8]) -> Result<Self, String> {
        Self::read(&mut CdrReader::new(message)?)
    }
}

fn pose(r: &mut CdrReader) -> Result<Isometry3<f64>, String> {
    let [x, y, z] = r.floats()?;
    let [qx, qy, qz, qw] = r.floats()?;
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    // Written so that NaN fails too.
    if !((quaternion.norm() - 1.0).abs() < 0.1) || ![x, y, z].iter().all(|v| v.is_finite()) {
        return Err(format!("the pose ({x}, {y}, {z}; {qx}, {qy}, {qz}, {qw}) is none"));
    }
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion)))
}

impl Image {
    /// From the bytes of a message.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn parse(message: &[u8]) -> Result<Self, String> {
        let r = &mut CdrReader::new(message)?;
        let header = Header::read(r)?;
        let (height, width) = (r.u32()? as usize, r.u32()? as usize);
        let (encoding, big_endian, step) = (r.string()?, r.u8()? != 0, r.u32()? as usize);
        let data = r.bytes()?.to_vec();
        if step.checked_mul(height) != Some(data.len()) || height == 0 || width == 0 {
            return Err(format!("{width}×{height} pixels in rows of {step} bytes do not make {} bytes", data.len()));
        }
        Ok(Self { header, height, width, encoding, big_endian, step, data })
    }
}

impl CompressedImage {
    /// From the bytes of a message.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn parse(message: &[u8]) -> Result<Self, String> {
        let r = &mut CdrReader::new(message)?;
        Ok(Self { header: Header::read(r)?, format: r.string()?, data: r.bytes()?.to_vec() })
    }
}

impl CameraInfo {
    /// From the bytes of a message.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn parse(message: &[u8]) -> Result<Self, String> {
        let r = &mut CdrReader::new(message)?;
        let header = Header::read(r)?;
        let (height, width) = (r.u32()? as usize, r.u32()? as usize);
        let (model, distortion) = (r.string()?, r.sequence(CdrReader::f64)?);
        let (k, _r, p) = (r.floats()?, r.floats::<9>()?, r.floats()?);
        Ok(Self { header, height, width, model, distortion, k, p })
    }
}

impl PoseStamped {
    /// From the bytes of a message.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn parse(message: &[u8]) -> Result<Self, String> {
        let r = &mut CdrReader::new(message)?;
        Ok(Self { header: Header::read(r)?, pose: pose(r)? })
    }
}

impl TransformStamped {
    /// The transforms of a TFMessage.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse_all(message: &[u8]) -> Result<Vec<Self>, String> {
        CdrReader::new(message)?.sequence(|r| {
            let header = Header::read(r)?;
            let child = r.string()?.trim_start_matches('/').to_owned();
            Ok(Self { header, child, parent_from_child: pose(r)? })
        })
    }
}

impl PointCloud2 {
    /// From the bytes of a message: the fields x, y, z as 32- or 64-bit floats.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn parse(message: &[u8]) -> Result<Self, String> {
        let r = &mut CdrReader::new(message)?;
        let header = Header::read(r)?;
        let (height, width) = (r.u32()? as usize, r.u32()? as usize);
        let fields = r.sequence(|r| Ok((r.string()?, r.u32()? as usize, r.u8()?, r.u32()?)))?;
        let (big_endian, step, row_step) = (r.u8()? != 0, r.u32()? as usize, r.u32()? as usize);
        let data = r.bytes()?;
        if height == 0 || width == 0 {
            return Err(format!("a cloud of {width}×{height} points is empty"));
        }
        let offset = |name: &str| {
            let field =
                fields.iter().find(|f| f.0 == name).ok_or_else(|| format!("the cloud has no field '{name}'"))?;
            match field.2 {
                7 => Ok((field.1, 4)),
                8 => Ok((field.1, 8)),
                other => Err(format!("field '{name}' is of datatype {other}; 7 (float32) or 8 (float64) is needed")),
            }
        };
        let xyz = [offset("x")?, offset("y")?, offset("z")?];
        let fits = xyz.iter().all(|&(at, size)| at.checked_add(size).is_some_and(|end| end <= step))
            && step.checked_mul(width).is_some_and(|row| row <= row_step)
            && row_step.checked_mul(height).is_some_and(|all| all <= data.len());
        if !fits {
            return Err(format!("{width}×{height} points of {step} bytes do not fit {} bytes", data.len()));
        }
        let value = |bytes: &[u8]| {
            let mut bytes = bytes.to_vec();
            if big_endian {
                bytes.reverse();
            }
            match bytes[..] {
                [a, b, c, d] => f64::from(f32::from_le_bytes([a, b, c, d])),
                [a, b, c, d, e, f, g, h] => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
                _ => f64::NAN,
            }
        };
        let mut points = Vec::new();
        for row in 0..height {
            for col in 0..width {
                let start = row * row_step + col * step;
                let point = xyz.map(|(at, size)| value(&data[start + at..start + at + size]));
                if point.iter().all(|v| v.is_finite()) {
                    points.push(point);
                }
            }
        }
        Ok(Self { header, points })
    }
}
