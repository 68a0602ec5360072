//! MCAP files: a magic number, then records of one byte of kind, eight of length and their content, some in compressed chunks.
//!
//! # References
//! *MCAP file format specification*, mcap.dev/spec.

use crate::ImportError;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

const MAGIC: [u8; 8] = [0x89, b'M', b'C', b'A', b'P', 0x30, b'\r', b'\n'];
/// Largest chunk that is unpacked, bytes.
const CHUNK_LIMIT: u64 = 1 << 30;

/// One message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Its topic.
    pub topic: String,
    /// Type, like `sensor_msgs/msg/Image`.
    pub kind: String,
    /// How it is encoded, like `cdr`.
    pub encoding: String,
    /// When it was logged, nanoseconds.
    pub log_time: u64,
    /// Its bytes.
    pub data: Vec<u8>,
}

#[derive(Debug, Clone)]
struct Channel {
    schema: u16,
    topic: String,
    encoding: String,
}

/// The messages of one or several MCAP files, in order.
pub struct Mcap {
    files: Vec<PathBuf>,
    next: usize,
    current: Option<Source>,
    allow_truncated: bool,
    messages: usize,
}

/// One file being read.
struct Source {
    path: PathBuf,
    reader: BufReader<File>,
    length: u64,
    at: u64,
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Channel>,
    /// A chunk's records that are not yet read, last first.
    pending: Vec<Message>,
    ended: bool,
}

/// What a topic holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicSummary {
    /// Type.
    pub kind: String,
    /// Encoding.
    pub encoding: String,
    /// Messages.
    pub count: usize,
}

/// Every topic of a recording.
///
/// # Errors
/// As [`Mcap::open`] and its iteration.
pub fn summarise(path: &Path, allow_truncated: bool) -> Result<BTreeMap<String, TopicSummary>, ImportError> {
    let mut topics: BTreeMap<String, TopicSummary> = BTreeMap::new();
    for message in Mcap::open(path, allow_truncated)? {
        let message = message?;
        let fresh = TopicSummary { kind: message.kind, encoding: message.encoding, count: 0 };
        topics.entry(message.topic).or_insert(fresh).count += 1;
    }
    Ok(topics)
}

impl Mcap {
    /// Opens a file, or a folder of rosbag2 with MCAP storage.
    ///
    /// * `allow_truncated` – a recording without its end counts as far as it goes
    ///
    /// # Errors
    /// [`ImportError::Read`], [`ImportError::Folder`]; while iterating [`ImportError::Malformed`] and [`ImportError::Truncated`].
    pub fn open(path: &Path, allow_truncated: bool) -> Result<Self, ImportError> {
        let files = if path.is_dir() { folder_files(path)? } else { vec![path.to_owned()] };
        Ok(Self { files, next: 0, current: None, allow_truncated, messages: 0 })
    }

    fn step(&mut self) -> Result<Option<Message>, ImportError> {
        loop {
            if self.current.is_none() {
                let Some(path) = self.files.get(self.next) else { return Ok(None) };
                self.current = Some(Source::open(path)?);
                self.next += 1;
            }
            let Some(source) = &mut self.current else { return Ok(None) };
            match source.step(self.messages) {
                Ok(Some(message)) => {
                    self.messages += 1;
                    return Ok(Some(message));
                }
                Ok(None) => self.current = None,
                Err(ImportError::Truncated { .. }) if self.allow_truncated => self.current = None,
                Err(error) => return Err(error),
            }
        }
    }
}

impl Iterator for Mcap {
    type Item = Result<Message, ImportError>;

    fn next(&mut self) -> Option<Self::Item> {
        let step = self.step();
        if step.is_err() {
            // Nothing sensible comes after an error.
            (self.current, self.next) = (None, self.files.len());
        }
        step.transpose()
    }
}

fn folder_files(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let read = |source| ImportError::Read { path: folder.to_owned(), source };
    let (mut mcap, mut other) = (Vec::new(), None);
    for entry in std::fs::read_dir(folder).map_err(read)? {
        let path = entry.map_err(read)?.path();
        match path.extension().map(|e| e.to_string_lossy().to_lowercase()).as_deref() {
            Some("mcap") => mcap.push(path),
            Some("db3" | "zstd" | "bag") => other = Some(path),
            _ => {}
        }
    }
    mcap.sort();
    let reason = match other {
        _ if !mcap.is_empty() => return Ok(mcap),
        Some(path) => format!(
            "{} is not MCAP; convert it with `ros2 bag convert` (storage_id: mcap, no file compression) or the program `mcap`",
            path.file_name().unwrap_or_default().to_string_lossy()
        ),
        None => "the folder holds no .mcap file".to_owned(),
    };
    Err(ImportError::Folder { path: folder.to_owned(), reason })
}

impl Source {
    fn open(path: &Path) -> Result<Self, ImportError> {
        let read = |source| ImportError::Read { path: path.to_owned(), source };
        let file = File::open(path).map_err(read)?;
        let length = file.metadata().map_err(read)?.len();
        let mut source = Self {
            path: path.to_owned(),
            reader: BufReader::with_capacity(1 << 20, file),
            length,
            at: 0,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            pending: Vec::new(),
            ended: false,
        };
        let mut magic = [0; 8];
        if length < 8 || source.fill(&mut magic).is_err() || magic != MAGIC {
            let hint = if magic.starts_with(b"SQLite f") {
                "it is an SQLite bag; convert it with `ros2 bag convert`"
            } else {
                "it does not begin like one"
            };
            return Err(source.malformed(hint));
        }
        Ok(source)
    }

    fn malformed(&self, reason: impl Into<String>) -> ImportError {
        ImportError::Malformed { path: self.path.clone(), format: "MCAP file", reason: reason.into() }
    }

    fn fill(&mut self, buffer: &mut [u8]) -> std::io::Result<()> {
        self.reader.read_exact(buffer)?;
        self.at += buffer.len() as u64;
        Ok(())
    }

    fn step(&mut self, messages: usize) -> Result<Option<Message>, ImportError> {
        loop {
            if let Some(message) = self.pending.pop() {
                return Ok(Some(message));
            }
            if self.ended {
                return Ok(None);
            }
            let truncated = |at: u64, path: &Path| ImportError::Truncated { path: path.to_owned(), messages, at };
            let left = self.length - self.at;
            if left < 9 {
                return Err(truncated(self.length, &self.path));
            }
            let mut head = [0; 9];
            let read = |source, path: &Path| ImportError::Read { path: path.to_owned(), source };
            self.fill(&mut head).map_err(|e| read(e, &self.path.clone()))?;
            let size = u64::from_le_bytes(head[1..].try_into().unwrap_or_default());
            if size > self.length - self.at {
                return Err(truncated(self.length, &self.path));
            }
            let mut content = vec![0; size as usize];
            self.fill(&mut content).map_err(|e| read(e, &self.path.clone()))?;
            match head[0] {
                // Data end, or footer of a file without it: the index that follows repeats what was read.
                0x0f | 0x02 => self.ended = true,
                0x06 => self.chunk(&content)?,
                kind => {
                    if let Some(message) = self.record(kind, &content)? {
                        return Ok(Some(message));
                    }
                }
            }
        }
    }

    /// A schema or channel is kept, a message returned, everything else passed over.
    fn record(&mut self, kind: u8, content: &[u8]) -> Result<Option<Message>, ImportError> {
        let mut fields = Fields(content);
        let parsed = match kind {
            0x03 => fields.schema().map(|(id, name)| {
                self.schemas.insert(id, name);
                None
            }),
            0x04 => fields.channel().map(|(id, channel)| {
                self.channels.insert(id, channel);
                None
            }),
            0x05 => fields.message().map(Some),
            _ => Some(None),
        };
        let message = parsed.ok_or_else(|| self.malformed(format!("a record of kind {kind:#04x} is cut short")))?;
        let Some((id, log_time, data)) = message else { return Ok(None) };
        let channel =
            self.channels.get(&id).ok_or_else(|| self.malformed(format!("a message of the unknown channel {id}")))?;
        Ok(Some(Message {
            topic: channel.topic.clone(),
            kind: self.schemas.get(&channel.schema).cloned().unwrap_or_default(),
            encoding: channel.encoding.clone(),
            log_time,
            data: data.to_vec(),
        }))
    }

    fn chunk(&mut self, content: &[u8]) -> Result<(), ImportError> {
        let Some((size, compression, packed)) = Fields(content).chunk() else {
            return Err(self.malformed("a chunk is cut short"));
        };
        if size > CHUNK_LIMIT {
            return Err(
                self.malformed(format!("a chunk claims to unpack to {size} bytes; at most {CHUNK_LIMIT} are read"))
            );
        }
        let unpacked = match compression {
            "" => packed.to_vec(),
            "zstd" => {
                let decoder = ruzstd::decoding::StreamingDecoder::new(packed);
                let decoder = decoder.map_err(|e| self.malformed(format!("a zstd chunk cannot be unpacked: {e}")))?;
                self.unpack(decoder, size)?
            }
            "lz4" => self.unpack(lz4_flex::frame::FrameDecoder::new(packed), size)?,
            other => {
                return Err(self.malformed(format!("chunks are compressed by '{other}'; zstd, lz4 or none is needed")));
            }
        };
        let (mut rest, mut messages) = (&unpacked[..], Vec::new());
        while !rest.is_empty() {
            let record = rest.split_at_checked(9).and_then(|(head, after)| {
                let size = u64::from_le_bytes(head[1..].try_into().ok()?);
                Some((head[0], after.split_at_checked(usize::try_from(size).ok()?)?))
            });
            let Some((kind, (record, after))) = record else {
                return Err(self.malformed("a chunk's record is cut short"));
            };
            messages.extend(self.record(kind, record)?);
            rest = after;
        }
        messages.reverse();
        self.pending = messages;
        Ok(())
    }

    fn unpack(&self, decoder: impl Read, size: u64) -> Result<Vec<u8>, ImportError> {
        let mut unpacked = Vec::new();
        // One byte more than claimed tells that there is more.
        let read = decoder.take(size + 1).read_to_end(&mut unpacked);
        match read {
            Ok(_) if unpacked.len() as u64 == size => Ok(unpacked),
            Ok(_) => Err(self.malformed(format!("a chunk of {size} bytes unpacks to another size"))),
            Err(error) => Err(self.malformed(format!("a chunk cannot be unpacked: {error}"))),
        }
    }
}

/// The fields of a record, little endian, texts and arrays with their length first. `None` where it is cut short.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn u16(&mut self) -> Option<u16> {
        Some(u16::from_le_bytes(self.take(2)?.try_into().ok()?))
    }

    fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.take(4)?.try_into().ok()?))
    }

    fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(self.take(8)?.try_into().ok()?))
    }

    fn text(&mut self) -> Option<&'a str> {
        let length = self.u32()? as usize;
        std::str::from_utf8(self.take(length)?).ok()
    }

    fn schema(&mut self) -> Option<(u16, String)> {
        Some((self.u16()?, self.text()?.to_owned()))
    }

    fn channel(&mut self) -> Option<(u16, Channel)> {
        let (id, schema) = (self.u16()?, self.u16()?);
        Some((id, Channel { schema, topic: self.text()?.to_owned(), encoding: self.text()?.to_owned() }))
    }

    fn message(&mut self) -> Option<(u16, u64, &'a [u8])> {
        let id = self.u16()?;
        let (_sequence, log_time, _publish_time) = (self.u32()?, self.u64()?, self.u64()?);
        Some((id, log_time, self.0))
    }

    fn chunk(&mut self) -> Option<(u64, &'a str, &'a [u8])> {
        let (_start, _end, size, _crc) = (self.u64()?, self.u64()?, self.u64()?, self.u32()?);
        let compression = self.text()?;
        let length = self.u64()?;
        Some((size, compression, self.take(usize::try_from(length).ok()?)?))
    }
}
