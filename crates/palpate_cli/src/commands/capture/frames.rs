//! Where frames come from: a folder, a video, or a device through ffmpeg that may vanish and come back.

use crate::commands::calibrate::images_of;
use crate::video::{self, Frames};
use anyhow::{Context as _, bail};
use palpate::geometry::Raster;
use palpate::io::read_color;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Time between attempts to open a device that is gone.
const RETRY: Duration = Duration::from_millis(500);

/// What a source gives.
pub(super) enum Frame {
    Image(Raster<[u8; 3]>),
    /// The device was unplugged.
    Gone(String),
    /// It is not back yet.
    Waiting,
    /// A file cannot be read.
    Failed(anyhow::Error),
    /// There is no more.
    End,
}

pub(super) enum FrameSource {
    Files(std::vec::IntoIter<PathBuf>),
    Video(Frames),
    Device { path: PathBuf, options: Vec<String>, frames: Option<Frames> },
}

impl FrameSource {
    pub(super) fn open(
        device: Option<&Path>,
        files: Option<&Path>,
        size: Option<&str>,
        rate: Option<u32>,
    ) -> anyhow::Result<Self> {
        if let Some(path) = files {
            let is_video = path
                .extension()
                .is_some_and(|e| video::EXTENSIONS.contains(&e.to_string_lossy().to_lowercase().as_str()));
            if is_video {
                return Ok(Self::Video(Frames::open(path)?));
            }
            if !path.is_dir() {
                bail!("--frames {}: a folder of images or a video is needed", path.display());
            }
            return Ok(Self::Files(images_of(path)?.into_iter()));
        }
        let path = device.context("--device or --frames is needed")?.to_owned();
        let mut options = Vec::new();
        if let Some(size) = size {
            options.extend(["-video_size".to_owned(), size.to_owned()]);
        }
        if let Some(rate) = rate {
            options.extend(["-framerate".to_owned(), rate.to_string()]);
        }
        if !path.exists() {
            bail!(
                "--device {}: there is no such device; `ls /dev/video*` lists those that are plugged in",
                path.display()
            );
        }
        let frames = Frames::open_device(&path, &options)?;
        Ok(Self::Device { path, options, frames: Some(frames) })
    }

    pub(super) fn next(&mut self) -> Frame {
        match self {
            Self::Files(paths) => match paths.next() {
                None => Frame::End,
                Some(path) => read_color(path).map_or_else(|e| Frame::Failed(e.into()), Frame::Image),
            },
            Self::Video(frames) => match frames.next() {
                None => Frame::End,
                Some(frame) => frame.map_or_else(Frame::Failed, Frame::Image),
            },
            Self::Device { path, options, frames } => {
                let Some(open) = frames else {
                    std::thread::sleep(RETRY);
                    if path.exists() {
                        *frames = Frames::open_device(path, options).ok();
                    }
                    return Frame::Waiting;
                };
                match open.next() {
                    Some(Ok(image)) => Frame::Image(image),
                    other => {
                        *frames = None;
                        let reason = other.and_then(Result::err).map_or("it ended".to_owned(), |e| format!("{e:#}"));
                        Frame::Gone(format!("the device {} is gone ({reason})", path.display()))
                    }
                }
            }
        }
    }
}
