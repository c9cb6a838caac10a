//! CDR, the bytes of ROS 2 messages: little-endian plain CDR (XCDR1) with its four bytes of
//! encapsulation.
//!
//! - in: the fields of a message in the order of its definition
//! - out: bytes; and back
//! - source: OMG CORBA 3.0, chapter 15 (alignment, strings, sequences); DDSI-RTPS 2.2, 10
//!   (encapsulation)
//!
//! Every primitive is aligned to its size, counted from behind the encapsulation.

/// Little-endian plain CDR.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Writes a message, field by field.
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
    /// Begins a message in a buffer, whose memory is used again.
    #[must_use]
    pub fn new(mut buffer: Vec<u8>) -> Self {
        buffer.clear();
        buffer.extend_from_slice(&ENCAPSULATION);
        Self { bytes: buffer }
    }

    /// The message.
    #[must_use]
    pub fn bytes(self) -> Vec<u8> {
        self.bytes
    }

    fn align(&mut self, size: usize) {
        let behind = (self.bytes.len() - ENCAPSULATION.len()) % size;
        if behind != 0 {
            self.bytes.resize(self.bytes.len() + size - behind, 0);
        }
    }

    /// `uint8`.
    pub fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    /// `bool`.
    pub fn bool(&mut self, value: bool) {
        self.u8(u8::from(value));
    }

    /// `int16`.
    pub fn i16(&mut self, value: i16) {
        self.align(2);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// `int32`.
    pub fn i32(&mut self, value: i32) {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// `uint32`.
    pub fn u32(&mut self, value: u32) {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// `int64`.
    pub fn i64(&mut self, value: i64) {
        self.align(8);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// `uint64`.
    pub fn u64(&mut self, value: u64) {
        self.align(8);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// `float64`, by its bits.
    pub fn f64(&mut self, value: f64) {
        self.u64(value.to_bits());
    }

    /// `float64[N]`.
    pub(crate) fn f64s(&mut self, values: &[f64]) {
        for value in values {
            self.f64(*value);
        }
    }

    /// `float64[]`.
    pub(crate) fn f64_sequence(&mut self, values: &[f64]) {
        self.u32(values.len() as u32);
        self.f64s(values);
    }

    /// `uint8[]`.
    pub(crate) fn u8_sequence(&mut self, values: &[u8]) {
        self.u32(values.len() as u32);
        self.bytes.extend_from_slice(values);
    }

    /// `string`.
    pub fn string(&mut self, value: &str) {
        self.u32(value.len() as u32 + 1);
        self.bytes.extend_from_slice(value.as_bytes());
        self.u8(0);
    }

    /// `string[]`.
    pub(crate) fn string_sequence<S: AsRef<str>>(&mut self, values: &[S]) {
        self.u32(values.len() as u32);
        for value in values {
            self.string(value.as_ref());
        }
    }

    /// `builtin_interfaces/Time`, from nanoseconds.
    pub fn time(&mut self, nanos: u64) {
        self.i32((nanos / 1_000_000_000) as i32);
        self.u32((nanos % 1_000_000_000) as u32);
    }

    /// `std_msgs/Header`.
    pub fn header(&mut self, nanos: u64, frame: &str) {
        self.time(nanos);
        self.string(frame);
    }
}

/// The bytes end before the message does, or are none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the message ends too early, or is not one of this type")]
pub struct Malformed;

/// Reads a message, field by field.
#[derive(Debug, Clone)]
pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    /// Of a message with its encapsulation.
    ///
    /// # Errors
    /// [`Malformed`] for anything but little-endian plain CDR.
    pub(crate) fn new(bytes: &'a [u8]) -> Result<Self, Malformed> {
        match bytes.split_at_checked(ENCAPSULATION.len()) {
            Some((head, bytes)) if head[..2] == ENCAPSULATION[..2] => Ok(Self { bytes, at: 0 }),
            _ => Err(Malformed),
        }
    }

    fn take(&mut self, count: usize, align: usize) -> Result<&'a [u8], Malformed> {
        let begin = self.at.next_multiple_of(align);
        let end = begin.checked_add(count).ok_or(Malformed)?;
        let taken = self.bytes.get(begin..end).ok_or(Malformed)?;
        self.at = end;
        Ok(taken)
    }

    fn primitive<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        self.take(N, N)?.try_into().map_err(|_| Malformed)
    }

    /// `uint8`.
    ///
    /// # Errors
    /// [`Malformed`], here and below.
    pub(crate) fn u8(&mut self) -> Result<u8, Malformed> {
        Ok(self.primitive::<1>()?[0])
    }

    /// `bool`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn bool(&mut self) -> Result<bool, Malformed> {
        Ok(self.u8()? != 0)
    }

    /// `int16`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn i16(&mut self) -> Result<i16, Malformed> {
        self.primitive().map(i16::from_le_bytes)
    }

    /// `int32`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn i32(&mut self) -> Result<i32, Malformed> {
        self.primitive().map(i32::from_le_bytes)
    }

    /// `uint32`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn u32(&mut self) -> Result<u32, Malformed> {
        self.primitive().map(u32::from_le_bytes)
    }

    /// `int64`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn i64(&mut self) -> Result<i64, Malformed> {
        self.primitive().map(i64::from_le_bytes)
    }

    /// `uint64`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn u64(&mut self) -> Result<u64, Malformed> {
        self.primitive().map(u64::from_le_bytes)
    }

    /// `float64`, by its bits.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn f64(&mut self) -> Result<f64, Malformed> {
        self.u64().map(f64::from_bits)
    }

    /// `float64[N]`.
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

    /// `float64[]`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn f64_sequence(&mut self) -> Result<Vec<f64>, Malformed> {
        let count = self.u32()? as usize;
        // What a broken length asks for is not reserved.
        let mut values = Vec::with_capacity(count.min(self.bytes.len() / 8));
        for _ in 0..count {
            values.push(self.f64()?);
        }
        Ok(values)
    }

    /// `uint8[]`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn u8_sequence(&mut self) -> Result<&'a [u8], Malformed> {
        let count = self.u32()? as usize;
        self.take(count, 1)
    }

    /// `string`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn string(&mut self) -> Result<&'a str, Malformed> {
        let with_end = self.u8_sequence()?;
        let text = with_end.strip_suffix(&[0]).ok_or(Malformed)?;
        std::str::from_utf8(text).map_err(|_| Malformed)
    }

    /// `string[]`.
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn string_sequence(&mut self) -> Result<Vec<&'a str>, Malformed> {
        let count = self.u32()? as usize;
        let mut values = Vec::with_capacity(count.min(self.bytes.len() / 5));
        for _ in 0..count {
            values.push(self.string()?);
        }
        Ok(values)
    }

    /// `builtin_interfaces/Time` (ns).
    ///
    /// # Errors
    /// [`Malformed`].
    pub(crate) fn time(&mut self) -> Result<u64, Malformed> {
        // No recording is older than 1970.
        let seconds = u64::try_from(self.i32()?).map_err(|_| Malformed)?;
        Ok(seconds * 1_000_000_000 + u64::from(self.u32()?))
    }

    /// `std_msgs/Header`: nanoseconds and frame.
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
    fn primitives_are_aligned_to_their_size_behind_the_encapsulation() {
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
    fn what_was_written_is_read_to_the_bit() {
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
    fn a_broken_length_is_an_error_and_no_allocation() {
        let mut writer = Writer::default();
        writer.u32(u32::MAX);
        let bytes = writer.bytes();

        assert!(Reader::new(&bytes).unwrap().f64_sequence().is_err());
        assert!(Reader::new(&bytes).unwrap().string().is_err());
        assert!(Reader::new(&[1, 2]).is_err());
    }
}
