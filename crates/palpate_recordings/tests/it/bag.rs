//! Recordings with a fault in them, which no proper writer would write: MCAP and CDR by hand.

use std::path::Path;

/// CDR, little endian unless turned.
pub(crate) struct Cdr {
    data: Vec<u8>,
    big: bool,
}

impl Cdr {
    /// A message that begins with a header.
    pub(crate) fn new(big: bool, nanoseconds: u32, frame: &str) -> Self {
        Self { data: Vec::new(), big }.u32(100).u32(nanoseconds).text(frame)
    }

    /// A message that begins with a sequence of one.
    pub(crate) fn sequence_of_one() -> Self {
        Self { data: Vec::new(), big: false }.u32(1)
    }

    fn aligned(mut self, little: &[u8]) -> Self {
        self.data.resize(self.data.len().next_multiple_of(little.len()), 0);
        if self.big {
            self.data.extend(little.iter().rev());
        } else {
            self.data.extend(little);
        }
        self
    }

    pub(crate) fn u8(self, value: u8) -> Self {
        self.aligned(&[value])
    }

    pub(crate) fn u32(self, value: u32) -> Self {
        self.aligned(&value.to_le_bytes())
    }

    pub(crate) fn f64(self, value: f64) -> Self {
        self.aligned(&value.to_le_bytes())
    }

    pub(crate) fn text(self, text: &str) -> Self {
        let mut after = self.u32(text.len() as u32 + 1);
        after.data.extend(text.as_bytes());
        after.data.push(0);
        after
    }

    pub(crate) fn bytes(self, bytes: &[u8]) -> Self {
        let mut after = self.u32(bytes.len() as u32);
        after.data.extend(bytes);
        after
    }

    pub(crate) fn done(self) -> Vec<u8> {
        [&[0, u8::from(!self.big), 0, 0][..], &self.data].concat()
    }
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

/// MCAP without chunks: topic, type, encoding and bytes of each message.
pub(crate) fn write(path: &Path, messages: &[(&str, &str, &str, Vec<u8>)]) {
    const MAGIC: &[u8] = b"\x89MCAP0\r\n";
    let mut file = MAGIC.to_vec();
    let mut record = |kind: u8, content: &[u8]| {
        file.push(kind);
        file.extend((content.len() as u64).to_le_bytes());
        file.extend(content);
    };
    record(1, &[text("ros2"), text("by hand")].concat());
    for (i, (topic, kind, encoding, data)) in messages.iter().enumerate() {
        let id = (i as u16 + 1).to_le_bytes();
        record(3, &[&id[..], &text(kind), &text("ros2msg"), &text("")].concat());
        record(4, &[&id[..], &id, &text(topic), &text(encoding), &0u32.to_le_bytes()].concat());
        let time = (100_000_000_000 + i as u64).to_le_bytes();
        record(5, &[&id[..], &(i as u32).to_le_bytes(), &time, &time, data].concat());
    }
    record(0x0f, &[0; 4]);
    record(2, &[0; 20]);
    file.extend(MAGIC);
    std::fs::write(path, file).expect("written");
}
