//! Common Data Representation (OMG, XCDR version 1): numbers aligned to their size, strings and sequences with their length first.

/// Reads a message. Every length is compared with what is left before anything is allocated.
#[derive(Debug, Clone)]
pub struct CdrReader<'a> {
    data: &'a [u8],
    at: usize,
    big_endian: bool,
}

/// Longest sequence of strings or structures that a message of ours holds.
const MOST_ITEMS: usize = 100_000;

impl<'a> CdrReader<'a> {
    /// Begins after the encapsulation header of four bytes, which tells the byte order.
    ///
    /// # Errors
    /// What is wrong with the header.
    pub fn new(message: &'a [u8]) -> Result<Self, String> {
        let Some((header, data)) = message.split_at_checked(4) else {
            return Err(format!("{} bytes are no CDR message; its header has 4", message.len()));
        };
        match header[..2] {
            [0, 0] => Ok(Self { data, at: 0, big_endian: true }),
            [0, 1] => Ok(Self { data, at: 0, big_endian: false }),
            _ => Err(format!("the encapsulation {:02x}{:02x} is not plain CDR (0000 or 0001)", header[0], header[1])),
        }
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let left = self.data.len() - self.at.min(self.data.len());
        if count > left {
            return Err(format!("{count} bytes are needed at byte {} of the message, {left} are left", self.at + 4));
        }
        let taken = &self.data[self.at..self.at + count];
        self.at += count;
        Ok(taken)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N], String> {
        self.at = self.at.next_multiple_of(N);
        let mut bytes: [u8; N] = self.take(N)?.try_into().map_err(|_| "impossible".to_owned())?;
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    /// A byte.
    ///
    /// # Errors
    /// The message ends before.
    pub fn u8(&mut self) -> Result<u8, String> {
        Ok(u8::from_le_bytes(self.number()?))
    }

    /// A 32-bit number.
    ///
    /// # Errors
    /// The message ends before.
    pub fn u32(&mut self) -> Result<u32, String> {
        Ok(u32::from_le_bytes(self.number()?))
    }

    /// A 32-bit number with a sign.
    ///
    /// # Errors
    /// The message ends before.
    pub fn i32(&mut self) -> Result<i32, String> {
        Ok(i32::from_le_bytes(self.number()?))
    }

    /// A 64-bit float.
    ///
    /// # Errors
    /// The message ends before.
    pub fn f64(&mut self) -> Result<f64, String> {
        Ok(f64::from_le_bytes(self.number()?))
    }

    /// So many floats.
    ///
    /// # Errors
    /// The message ends before.
    pub fn floats<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let mut all = [0.0; N];
        for value in &mut all {
            *value = self.f64()?;
        }
        Ok(all)
    }

    /// A text.
    ///
    /// # Errors
    /// The message ends before, or the text is not UTF-8.
    pub fn string(&mut self) -> Result<String, String> {
        let length = self.u32()? as usize;
        let bytes = self.take(length)?;
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        String::from_utf8(bytes.to_vec()).map_err(|_| "a text is not UTF-8".to_owned())
    }

    /// A sequence of bytes.
    ///
    /// # Errors
    /// The message ends before.
    pub fn bytes(&mut self) -> Result<&'a [u8], String> {
        let length = self.u32()? as usize;
        self.take(length)
    }

    /// A sequence of anything.
    ///
    /// # Errors
    /// The message ends before, or the sequence is absurdly long.
    pub fn sequence<T>(&mut self, item: impl Fn(&mut Self) -> Result<T, String>) -> Result<Vec<T>, String> {
        let count = self.u32()? as usize;
        if count > MOST_ITEMS.min(self.data.len()) {
            return Err(format!("a sequence of {count} items does not fit a message of {} bytes", self.data.len()));
        }
        (0..count).map(|_| item(self)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_aligned_to_their_size_in_both_byte_orders() {
        let little = [0, 1, 0, 0, 7, 0, 0, 0, 1, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f, 9];
        let mut reader = CdrReader::new(&little).expect("a header");
        assert_eq!((reader.u8(), reader.u32(), reader.f64()), (Ok(7), Ok(513), Ok(1.0)));
        assert_eq!(
            reader.u32().expect_err("one byte is left"),
            "4 bytes are needed at byte 20 of the message, 1 are left"
        );
        let big = [0, 0, 0, 0, 0, 0, 2, 1, 0, 0, 0, 3, b'a', b'b', 0];
        let mut reader = CdrReader::new(&big).expect("a header");
        assert_eq!((reader.u32(), reader.string()), (Ok(513), Ok("ab".to_owned())));
    }

    #[test]
    fn lengths_beyond_the_message_are_errors() {
        assert!(CdrReader::new(&[0, 1]).is_err());
        assert!(CdrReader::new(&[0, 3, 0, 0]).is_err(), "a parameter list");
        let huge = [0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff, 1, 2];
        for read in [
            |r: &mut CdrReader| r.string().map(|_| ()),
            |r: &mut CdrReader| r.bytes().map(|_| ()),
            |r: &mut CdrReader| r.sequence(CdrReader::u8).map(|_| ()),
        ] {
            assert!(read(&mut CdrReader::new(&huge).expect("a header")).is_err());
        }
    }
}
