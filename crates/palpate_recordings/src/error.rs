use std::path::PathBuf;

/// Why something cannot be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// The file system said no.
    #[error("cannot read {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file of palpate's formats is wrong.
    #[error(transparent)]
    Io(#[from] palpate::io::IoError),
    /// The file is no recording.
    #[error("{}: not a readable {format}: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What it should be.
        format: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// The recording ends in the middle.
    #[error(
        "{}: the recording is cut short after {messages} messages (at byte {at}); --allow-truncated takes what is there",
        path.display()
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Complete messages before the end.
        messages: usize,
        /// Where it ends.
        at: u64,
    },
    /// A folder without a recording that can be read.
    #[error("{}: {reason}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What is missing.
        reason: String,
    },
    /// A topic that was asked for is not there.
    #[error("{}: there is no topic '{topic}'; there are: {known}", path.display())]
    NoTopic {
        /// The recording.
        path: PathBuf,
        /// The topic asked for.
        topic: String,
        /// The recorded topics with their types.
        known: String,
    },
    /// A topic is of another type.
    #[error("topic '{topic}' is of type '{found}'; {needed} is needed")]
    Type {
        /// The topic.
        topic: String,
        /// Its type.
        found: String,
        /// Types that would do.
        needed: &'static str,
    },
    /// A topic's messages are not CDR.
    #[error("topic '{topic}' is encoded as '{found}'; 'cdr' is needed")]
    MessageEncoding {
        /// The topic.
        topic: String,
        /// Its encoding.
        found: String,
    },
    /// A message cannot be understood.
    #[error("topic '{topic}', message at {stamp_ns} ns: {reason}")]
    Message {
        /// The topic.
        topic: String,
        /// Time at which it was logged.
        stamp_ns: u64,
        /// What is wrong.
        reason: String,
    },
    /// A topic has no usable message.
    #[error("topic '{topic}' has no {what}")]
    Nothing {
        /// The topic.
        topic: String,
        /// What is needed.
        what: String,
    },
    /// Two frames are not linked.
    #[error("no transform from '{source_frame}' to '{target}': {reason}; known frames: {known}")]
    Tf {
        /// Frame wanted.
        target: String,
        /// Frame that it starts from.
        source_frame: String,
        /// What is missing.
        reason: String,
        /// Every frame of the recording, or why there is none.
        known: String,
    },
    /// A value is out of range.
    #[error("{0}")]
    Value(String),
}

impl ImportError {
    pub(crate) fn message(topic: &str, stamp_ns: u64, reason: impl Into<String>) -> Self {
        Self::Message { topic: topic.to_owned(), stamp_ns, reason: reason.into() }
    }
}
