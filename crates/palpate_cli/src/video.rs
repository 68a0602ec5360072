//! Frames of a video, through the program `ffmpeg`.

use anyhow::{Context as _, bail};
use palpate::geometry::Raster;
use std::fs::File;
use std::io::{BufRead as _, BufReader, ErrorKind, Read as _, Seek as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

/// Extensions that are taken for videos.
pub(crate) const EXTENSIONS: [&str; 7] = ["mp4", "avi", "mkv", "mov", "webm", "m4v", "mpg"];
/// Largest side of a frame, pixels.
const SIDE_LIMIT: usize = 16384;

/// The frames of a video, in order, sRGB.
pub(crate) struct Frames {
    path: PathBuf,
    child: Child,
    stdout: BufReader<ChildStdout>,
    /// What ffmpeg complains about: a file, for a pipe that nobody reads would stop it once full.
    complaints: File,
    ended: bool,
}

impl Frames {
    /// Starts `ffmpeg` on the file; frames come as a stream of PPM images, which say their size.
    pub(crate) fn open(path: &Path) -> anyhow::Result<Self> {
        if !path.is_file() {
            bail!("cannot read {}: there is no such file", path.display());
        }
        Self::start(path, &[])
    }

    /// Starts `ffmpeg` on a V4L2 device.
    ///
    /// * `options` – of ffmpeg, before the input
    pub(crate) fn open_device(path: &Path, options: &[String]) -> anyhow::Result<Self> {
        let mut all = vec!["-f".to_owned(), "v4l2".to_owned()];
        all.extend_from_slice(options);
        Self::start(path, &all)
    }

    fn start(path: &Path, options: &[String]) -> anyhow::Result<Self> {
        // A path that begins with '-' would be taken for a flag.
        let input = if path.is_absolute() { path.to_owned() } else { Path::new(".").join(path) };
        let complaints = tempfile::tempfile().context("making a temporary file")?;
        let child = Command::new("ffmpeg")
            .args(["-v", "error", "-nostdin"])
            .args(options)
            .arg("-i")
            .arg(input)
            .args(["-an", "-f", "image2pipe", "-c:v", "ppm", "-"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(complaints.try_clone().context("making a temporary file")?)
            .spawn();
        let mut child = match child {
            Err(error) if error.kind() == ErrorKind::NotFound => bail!(
                "the program `ffmpeg`, which reads {}, is not on the PATH; install it, or give the frames of a video as images",
                path.display()
            ),
            other => other.context("starting ffmpeg")?,
        };
        let stdout = child.stdout.take().context("ffmpeg has no output")?;
        Ok(Self {
            path: path.to_owned(),
            child,
            stdout: BufReader::with_capacity(1 << 20, stdout),
            complaints,
            ended: false,
        })
    }

    /// The next frame, or `None` at the end.
    fn read(&mut self) -> anyhow::Result<Option<Raster<[u8; 3]>>> {
        if self.stdout.fill_buf()?.is_empty() {
            return self.finish().map(|()| None);
        }
        let header = [self.word()?, self.word()?, self.word()?, self.word()?];
        let number = |i: usize| header[i].parse().ok().filter(|n| (1..=SIDE_LIMIT).contains(n));
        let (Some(cols), Some(rows), "P6", "255") = (number(1), number(2), header[0].as_str(), header[3].as_str())
        else {
            bail!("ffmpeg gave a frame that begins with {header:?}; an 8-bit PPM image was expected");
        };
        let mut bytes = vec![0; 3 * rows * cols];
        self.stdout.read_exact(&mut bytes).context("the last frame is cut short")?;
        let pixels = bytes.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
        Ok(Raster::from_vec(rows, cols, pixels))
    }

    /// Bytes up to the next white space, which is taken.
    fn word(&mut self) -> anyhow::Result<String> {
        let mut word = String::new();
        let mut byte = [0];
        while word.len() < 32 {
            self.stdout.read_exact(&mut byte)?;
            if byte[0].is_ascii_whitespace() {
                break;
            }
            word.push(char::from(byte[0]));
        }
        Ok(word)
    }

    /// Waits for the end; what ffmpeg complained about is an error.
    fn finish(&mut self) -> anyhow::Result<()> {
        let status = self.child.wait()?;
        if !status.success() {
            let mut said = Vec::new();
            self.complaints.rewind()?;
            self.complaints.read_to_end(&mut said)?;
            let said = String::from_utf8_lossy(&said);
            let last = said.lines().last().unwrap_or("it gave no reason");
            bail!("ffmpeg cannot decode {}: {last}", self.path.display());
        }
        Ok(())
    }
}

impl Iterator for Frames {
    type Item = anyhow::Result<Raster<[u8; 3]>>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let frame = self.read();
        self.ended = !matches!(frame, Ok(Some(_)));
        frame.with_context(|| format!("video {}", self.path.display())).transpose()
    }
}

impl Drop for Frames {
    fn drop(&mut self) {
        // Fails if it has ended by itself, which is as well.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
