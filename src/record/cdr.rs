//! Encoding of ROS 2 messages: little-endian plain CDR (XCDR1, common data representation) with its
//! four bytes of encapsulation.
//!
//! - in: the fields of a message in the order of its definition
//! - out: bytes; and back
//! - source: OMG CORBA 3.0, chapter 15 (alignment, strings, sequences); DDSI-RTPS 2.2, 10
//!   (encapsulation)
//!
//! Each primitive is aligned to a multiple of its size, counted from the end of the encapsulation.

/// Encapsulation of little-endian plain CDR, and two bytes of options that are 0.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Writer of a message, field by field.
#[derive(Debug, Clone)]
pub struct Writer {
    bytes: Vec<u8>,
}

impl Default for Writer {
    fn default() -> Self {
        Self::new(Vec::with_capacity(512))
    }
}

impl Writer {
    /// Begins a message in the memory of `buffer`, whose content is dropped.
    #[must_use]
    pub fn new(mut buffer: Vec<u8>) -> Self {
        buffer.clear();
        buffer.extend_from_slice(&ENCAPSULATION);
        Self { bytes: buffer }
    }

    /// Returns the bytes of the encoded message.
    #[must_use]
    pub fn bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// Appends zeros until the next byte is at a multiple of `size` (bytes).
    fn align(&mut self, size: usize) {
        let behind = (self.bytes.len() - ENCAPSULATION.len()) % size;
        if behind != 0 {
            self.bytes.resize(self.bytes.len() + size - behind, 0);
        }
    }

    /// Writes a `uint8`.
    pub fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    /// Writes a `bool`.
    pub fn bool(&mut self, value: bool) {
        self.u8(u8::from(value));
    }

    /// Writes an `int16`.
    pub fn i16(&mut self, value: i16) {
        self.align(2);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes an `int32`.
    pub fn i32(&mut self, value: i32) {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes a `uint32`.
    pub fn u32(&mut self, value: u32) {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes an `int64`.
    pub fn i64(&mut self, value: i64) {
        self.align(8);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes a `uint64`.
    pub fn u64(&mut self, value: u64) {
        self.align(8);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes a `float64` by its bits, so that a NaN keeps its payload.
    pub fn f64(&mut self, value: f64) {
        self.u64(value.to_bits());
    }

    /// Writes a `float64[N]`, an array without its length.
    pub(crate) fn f64s(&mut self, values: &[f64]) {
        for value in values {
            self.f64(*value);
        }
    }

    /// Writes a `float64[]`: its length, then its values.
    pub(crate) fn f64_sequence(&mut self, values: &[f64]) {
        self.u32(values.len() as u32);
        self.f64s(values);
    }

    /// Writes a `uint8[]`: its length, then its bytes.
    pub(crate) fn u8_sequence(&mut self, values: &[u8]) {
        self.u32(values.len() as u32);
        self.bytes.extend_from_slice(values);
    }

    /// Writes a `string`.
    pub fn string(&mut self, value: &str) {
        // The length counts the zero at the end.
        self.u32(value.len() as u32 + 1);
        self.bytes.extend_from_slice(value.as_bytes());
        self.u8(0);
    }

    /// Writes a `string[]`: its length, then its texts.
    pub(crate) fn string_sequence<S: AsRef<str>>(&mut self, values: &[S]) {
        self.u32(values.len() as u32);
        for value in values {
            self.string(value.as_ref());
        }
    }

    /// Writes a `builtin_interfaces/Time` (ns).
    pub fn time(&mut self, nanos: u64) {
        self.i32((nanos / 1_000_000_000) as i32);
        self.u32((nanos % 1_000_000_000) as u32);
    }

    /// Writes a `std_msgs/Header`: time (ns) and frame.
    pub fn header(&mut self, nanos: u64, frame: &str) {
        self.time(nanos);
        self.string(frame);
    }
}

/// Error of a message that ends too early or is of another type.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the message is too short, or its bytes do not fit the message type of its topic")]
pub struct Malformed;

/// Place of a time that is the first field of a message (bytes).
pub(crate) const FIRST: usize = ENCAPSULATION.len();

/// Replaces the time at this place of an encoded message (bytes) by `nanos` (ns).
///
/// # Errors
/// [`Malformed`] if the message ends before.
pub(crate) fn restamp(message: &mut [u8], at: usize, nanos: u64) -> Result<(), Malformed> {
    let mut time = Writer::default();
    time.time(nanos);
    let time = &time.bytes[FIRST..];
    message.get_mut(at..at + time.len()).ok_or(Malformed)?.copy_from_slice(time);
    Ok(())
}

/// Reader of a message, field by field.
#[derive(Debug, Clone)]
pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    /// Makes a reader of a message that begins with its four bytes of encapsulation.
    ///
    /// # Errors
    /// [`Malformed`] for anything but little-endian plain CDR.
    pub(crate) fn new(bytes: &'a [u8]) -> Result<Self, Malformed> {
        // Plain CDR does not use the two bytes of options, so they are not checked.
        match bytes.split_at_checked(ENCAPSULATION.len()) {
            Some((head, bytes)) if head[..2] == ENCAPSULATION[..2] => Ok(Self { bytes, at: 0 }),
            _ => Err(Malformed),
        }
    }

    /// Returns the place in the message of a time that is read next (bytes).
    pub(crate) fn place_of_time(&self) -> usize {
        ENCAPSULATION.len() + self.at.next_multiple_of(4)
    }

    /// Reads `count` bytes, beginning at the next position that is a multiple of `align`.
    fn take(&mut self, count: usize, align: usize) -> Result<&'a [u8], Malformed> {
        let begin = self.at.next_multiple_of(align);
        let end = begin.checked_add(count).ok_or(Malformed)?;
        let taken = self.bytes.get(begin..end).ok_or(Malformed)?;
        self.at = end;
        Ok(taken)
    }

    /// Reads a primitive of `N` bytes, which is aligned to a multiple of `N`.
    fn primitive<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        self.take(N, N)?.try_into().map_err(|_| Malformed)
    }

    /// Reads a `uint8`.
    ///
    /// # Errors
    /// [`Malformed`] if the message has no more bytes.
    pub(crate) fn u8(&mut self) -> Result<u8, Malformed> {
        Ok(self.primitive::<1>()?[0])
    }

    /// Reads a `bool`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn bool(&mut self) -> Result<bool, Malformed> {
        Ok(self.u8()? != 0)
    }

    /// Reads an `int16`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn i16(&mut self) -> Result<i16, Malformed> {
        self.primitive().map(i16::from_le_bytes)
    }

    /// Reads an `int32`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn i32(&mut self) -> Result<i32, Malformed> {
        self.primitive().map(i32::from_le_bytes)
    }

    /// Reads a `uint32`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn u32(&mut self) -> Result<u32, Malformed> {
        self.primitive().map(u32::from_le_bytes)
    }

    /// Reads an `int64`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn i64(&mut self) -> Result<i64, Malformed> {
        self.primitive().map(i64::from_le_bytes)
    }

    /// Reads a `uint64`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn u64(&mut self) -> Result<u64, Malformed> {
        self.primitive().map(u64::from_le_bytes)
    }

    /// Reads a `float64` by its bits, so that a NaN keeps its payload.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn f64(&mut self) -> Result<f64, Malformed> {
        self.u64().map(f64::from_bits)
    }

    /// Reads a `float64[N]`, an array without its length.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn f64s<const N: usize>(&mut self) -> Result<[f64; N], Malformed> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    /// Reads a `float64[]`: its length, then its values.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn f64_sequence(&mut self) -> Result<Vec<f64>, Malformed> {
        let count = self.u32()? as usize;
        // A broken length must not reserve more memory than the message can fill.
        let mut values = Vec::with_capacity(count.min(self.bytes.len() / 8));
        for _ in 0..count {
            values.push(self.f64()?);
        }
        Ok(values)
    }

    /// Reads a `uint8[]`: its length, then its bytes.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn u8_sequence(&mut self) -> Result<&'a [u8], Malformed> {
        let count = self.u32()? as usize;
        self.take(count, 1)
    }

    /// Reads a `string`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn string(&mut self) -> Result<&'a str, Malformed> {
        let with_end = self.u8_sequence()?;
        let text = with_end.strip_suffix(&[0]).ok_or(Malformed)?;
        std::str::from_utf8(text).map_err(|_| Malformed)
    }

    /// Reads a `string[]`: its length, then its texts.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn string_sequence(&mut self) -> Result<Vec<&'a str>, Malformed> {
        let count = self.u32()? as usize;
        // The shortest string takes 5 bytes: its length and the zero at its end.
        let mut values = Vec::with_capacity(count.min(self.bytes.len() / 5));
        for _ in 0..count {
            values.push(self.string()?);
        }
        Ok(values)
    }

    /// Reads a `builtin_interfaces/Time` (ns).
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn time(&mut self) -> Result<u64, Malformed> {
        // Seconds before 1970 are negative. No recording has them.
        let seconds = u64::try_from(self.i32()?).map_err(|_| Malformed)?;
        Ok(seconds * 1_000_000_000 + u64::from(self.u32()?))
    }

    /// Reads a `std_msgs/Header`: time (ns) and frame.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn header(&mut self) -> Result<(u64, &'a str), Malformed> {
        Ok((self.time()?, self.string()?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writer_aligns_primitives_to_their_size() {
        let mut writer = Writer::default();
        writer.u8(7);
        writer.f64(1.0);
        writer.string("ab");
        writer.i16(-2);

        let bytes = writer.bytes();

        let mut wanted = vec![0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0];
        wanted.extend(1.0_f64.to_le_bytes());
        wanted.extend([3, 0, 0, 0, b'a', b'b', 0, 0, 0xfe, 0xff]);
        assert_eq!(bytes, wanted);
    }

    #[test]
    fn reader_returns_written_values_to_the_bit() {
        let nan = f64::from_bits(0x7ff8_0000_0000_0123);
        let mut writer = Writer::default();
        writer.header(12_000_000_034, "tool");
        writer.bool(true);
        writer.f64_sequence(&[nan, -0.0]);
        writer.u8_sequence(&[1, 2, 3]);
        writer.string_sequence(&["", "ä"]);
        writer.i64(-5);
        let bytes = writer.bytes();

        let mut reader = Reader::new(&bytes).unwrap();

        assert_eq!(reader.header().unwrap(), (12_000_000_034, "tool"));
        assert!(reader.bool().unwrap());
        let floats = reader.f64_sequence().unwrap();
        assert_eq!(
            floats.iter().map(|f| f.to_bits()).collect::<Vec<_>>(),
            [nan.to_bits(), (-0.0_f64).to_bits()]
        );
        assert_eq!(reader.u8_sequence().unwrap(), [1, 2, 3]);
        assert_eq!(reader.string_sequence().unwrap(), ["", "ä"]);
        assert_eq!(reader.i64().unwrap(), -5);
        assert_eq!(reader.u8(), Err(Malformed));
    }

    #[test]
    fn reader_rejects_length_beyond_its_message() {
        let mut writer = Writer::default();
        writer.u32(u32::MAX);
        let bytes = writer.bytes();

        assert!(Reader::new(&bytes).unwrap().f64_sequence().is_err());
        assert!(Reader::new(&bytes).unwrap().string().is_err());
        assert!(Reader::new(&[1, 2]).is_err());
    }
}
