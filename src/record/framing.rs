//! Records of an MCAP file one after the other, also those after a damaged place.
//!
//! - in: the bytes of a file
//! - out: each record that is in no chunk; each place that is no record; the end of the file
//! - source: the MCAP specification, version 0
//!
//! A record is an opcode, a length and a body. A wrong length hides the beginning of the next
//! record, so it is checked twice: the lengths within the body must fit, or the next record must
//! begin where this one ends. After a place where neither holds the reader searches for the next
//! record whose lengths confirm each other:
//!
//! | opcode | confirmed by |
//! |---|---|
//! | chunk | its name of a compression; the length of its data fits the length of the record |
//! | message index | its list fits and is a multiple of 16 bytes |
//! | attachment, metadata | all their texts fit |
//! | end of the data | its length of 4, and a record of the summary after it |
//! | schema, channel, message | two records that follow it; only in a file without chunks |

use super::chunk;
use mcap::records::op;
use std::io::Read;

/// Largest length of a record, and of a chunk before and after compression (bytes).
pub(super) const LONGEST: usize = 64 << 20;
/// Size of opcode and length of a record (bytes).
pub(super) const HEAD: usize = 9;
/// Number of bytes that the search for a record reads at once.
const WINDOW: usize = 1 << 16;
/// Largest length of a record that is confirmed only by the records after it (bytes).
const LINKED: usize = 1 << 20;
/// Largest number of pairs of texts in a record: in memory a map takes ten times its size in the
/// file.
pub(super) const PAIRS: usize = 1 << 16;
/// Largest number of pairs of texts in a record that the search accepts. At every few bytes a
/// hostile file may have a head that looks like that of a long map; the search would take too long.
const FOUND_PAIRS: usize = 1 << 9;
/// Least number of zeros at the end of a file that count as never written (bytes). A record may end
/// with some zeros, too.
pub(super) const BLANK: usize = 16;

/// Item of a file outside its chunks.
#[derive(Debug)]
pub(super) enum Found {
    /// Record with this opcode, whose body is [`Records::body`]. `flaw` tells why its head is
    /// damaged although its body may be sound.
    Record { opcode: u8, flaw: Option<&'static str> },
    /// Place that is no record, with the reason. The next item begins behind this place.
    Damage(&'static str),
    /// End of the file in the middle of the record with this opcode, whose body so far is
    /// [`Records::body`].
    Cut(u8, String),
    /// Position from which on the file is zeros up to its end: it was never written.
    Blank(u64),
    /// Magic at the end of the file.
    Magic,
    /// End of the file behind a damaged place.
    End,
}

/// Reader of the records of a file.
pub(super) struct Records<R> {
    from: R,
    buffer: Vec<u8>,
    /// Index in `buffer` of the first byte that has not been passed.
    begin: usize,
    /// Position in the file of the first byte that has not been passed.
    at: u64,
    /// Length of the current item with its head (bytes).
    current: usize,
    /// Whether the file has no more bytes.
    ended: bool,
    /// Error of the device that ended the reading.
    failure: Option<std::io::Error>,
    /// Whether the file had a chunk so far.
    chunked: bool,
    /// Checksum of the bytes passed since the beginning or since [`Self::sum_from_next`].
    sum: crc32fast::Hasher,
}

impl<R: Read> Records<R> {
    /// Begins to read a file.
    pub(super) fn new(from: R) -> Self {
        Self {
            from,
            buffer: Vec::new(),
            begin: 0,
            at: 0,
            current: 0,
            ended: false,
            failure: None,
            chunked: false,
            sum: crc32fast::Hasher::new(),
        }
    }

    /// Passes the magic at the beginning of the file. Returns `None` if it is there, otherwise the
    /// damage or the cut.
    pub(super) fn begin(&mut self) -> Option<Found> {
        if self.fill(mcap::MAGIC.len()) && self.rest().starts_with(mcap::MAGIC) {
            self.pass(mcap::MAGIC.len());
            return None;
        }
        if mcap::MAGIC.starts_with(self.rest()) {
            return Some(self.cut(0, 0));
        }
        // A record behind another magic shows that only the magic is damaged.
        if self.fill(mcap::MAGIC.len() + HEAD) && self.is_plausible(mcap::MAGIC.len()) {
            self.pass(mcap::MAGIC.len());
            return Some(Found::Damage("the file does not begin as an MCAP file"));
        }
        Some(self.search("the file does not begin as an MCAP file"))
    }

    /// Returns the position of the current item in the file.
    pub(super) fn at(&self) -> u64 {
        self.at
    }

    /// Returns the body of the current record.
    pub(super) fn body(&self) -> &[u8] {
        let item = &self.rest()[..self.current.min(self.rest().len())];
        item.get(HEAD..).unwrap_or_default()
    }

    /// Returns the length of the current record with its head (bytes).
    pub(super) fn length(&self) -> usize {
        self.current
    }

    /// Returns the checksum of all bytes before the current record and of its first `more` bytes.
    /// After [`Self::sum_from_next`] the checksum begins there.
    pub(super) fn sum(&self, more: usize) -> u32 {
        let mut sum = self.sum.clone();
        sum.update(self.rest().get(..more).unwrap_or_default());
        sum.finalize()
    }

    /// Begins a new checksum behind the current record.
    pub(super) fn sum_from_next(&mut self) {
        self.pass(self.current);
        self.current = 0;
        self.sum = crc32fast::Hasher::new();
    }

    /// Passes all bytes behind the current item, and returns their number.
    pub(super) fn count_rest(&mut self) -> u64 {
        self.pass(self.current);
        self.current = 0;
        let begin = self.at;
        while self.fill(1) {
            self.pass(self.rest().len());
        }
        self.at - begin
    }

    /// Returns the next item of the file. After [`Found::Cut`], [`Found::Blank`] and
    /// [`Found::End`] there is none.
    pub(super) fn next(&mut self) -> Found {
        self.pass(self.current);
        self.current = 0;
        self.fill(HEAD);
        let rest = self.rest();
        if rest.starts_with(mcap::MAGIC) {
            self.current = mcap::MAGIC.len();
            return Found::Magic;
        }
        if rest.is_empty() && self.failure.is_none() {
            return Found::End;
        }
        let Some((opcode, length)) = head(rest) else { return self.cut(0, rest.len()) };
        if length > LONGEST as u64 {
            let chunk = opcode == op::CHUNK;
            return self.search(if chunk { "a chunk that is too long" } else { "no record" });
        }
        let whole = HEAD + length as usize;
        if opcode == op::CHUNK { self.chunk(whole) } else { self.record(opcode, whole) }
    }

    /// Returns the record at the current position, or the damage there. Its head gives `opcode` and
    /// a length of `whole` bytes with the head.
    fn record(&mut self, opcode: u8, whole: usize) -> Found {
        if opcode == 0 {
            return self.search("no record");
        }
        if !self.fill(whole) {
            // Either the file ends in this record, or its length is wrong: then another record
            // begins within it.
            let within = 1..self.rest().len();
            return match within.into_iter().find(|at| self.is_confirmed(*at, false)) {
                Some(_) => self.search("a record whose length is wrong"),
                None => self.cut(opcode, self.rest().len()),
            };
        }
        let body = &self.rest()[HEAD..whole];
        let extent = extent(opcode, body);
        // A body that is exactly a chunk's belongs to a chunk whose opcode is damaged.
        let is_chunk = chunk::length(body) == Some(body.len());
        if extent != Some(body.len()) && is_chunk {
            self.current = whole;
            self.chunked = true;
            return Found::Record { opcode: op::CHUNK, flaw: Some("its type is damaged") };
        }
        let fits = extent == Some(body.len());
        // A record that begins where the fields end shows that the length is wrong: a longer one
        // would take records behind it along.
        let by_fields = extent.map(|fields| HEAD + fields).filter(|end| *end < whole);
        if let Some(end) = by_fields
            && self.is_confirmed(end, true)
        {
            self.current = end;
            return Found::Damage("a record whose length is wrong");
        }
        if !fits && !self.is_plausible(whole) {
            return self.search("a record whose lengths do not fit");
        }
        self.current = whole;
        // A later version of the format may add fields to a record, but not to these two, which
        // separate data, summary and end of the file.
        let parts = matches!(opcode, op::FOOTER | op::DATA_END);
        match extent {
            Some(_) if fits || !parts => Found::Record { opcode, flaw: None },
            _ => Found::Damage("a record whose lengths do not fit"),
        }
    }

    /// Returns the chunk at the current position, or the damage there. Its head gives a length of
    /// `whole` bytes with the head.
    fn chunk(&mut self, whole: usize) -> Found {
        self.fill(HEAD + chunk::HEAD);
        let inner = chunk::length(&self.rest()[HEAD..]).map(|length| HEAD + length);
        if inner == Some(whole) {
            self.chunked = true;
            if !self.fill(whole) {
                return self.cut(op::CHUNK, self.rest().len());
            }
            self.current = whole;
            return Found::Record { opcode: op::CHUNK, flaw: None };
        }
        if self.rest().len() < HEAD + chunk::HEAD && !self.fill(whole) {
            return self.cut(0, self.rest().len());
        }
        // One of the two lengths is wrong. The right one is that behind which a record begins.
        for length in [Some(whole), inner].into_iter().flatten() {
            if length <= LONGEST && self.fill(length) && self.is_plausible(length) {
                (self.current, self.chunked) = (length, true);
                let flaw = Some("its lengths do not fit");
                return Found::Record { opcode: op::CHUNK, flaw };
            }
        }
        self.search("a chunk whose lengths do not fit")
    }

    /// Searches for the next record whose lengths confirm each other. Returns the damage for the
    /// reason `why`, or [`Found::Blank`] if no record follows and the file ends with zeros.
    fn search(&mut self, why: &'static str) -> Found {
        // The search begins behind the first byte of the damaged record. `zeros` counts the zeros
        // directly before the position.
        let mut zeros = u64::from(self.rest().first() == Some(&0));
        self.pass(1);
        loop {
            self.fill(WINDOW);
            if self.rest().is_empty() {
                break;
            }
            // First bytes of the records that can be confirmed, and of the magic.
            let may_begin =
                |byte: &u8| matches!(byte, 3..=7 | &op::ATTACHMENT | &op::METADATA | 0x0f | 0x89);
            let step = self.rest().iter().position(may_begin).unwrap_or(self.rest().len());
            let behind = self.rest()[..step].iter().rev().take_while(|byte| **byte == 0).count();
            zeros = if behind == step { zeros + step as u64 } else { behind as u64 };
            self.pass(step);
            if self.rest().is_empty() {
                continue;
            }
            if self.is_confirmed(0, true) {
                return Found::Damage(why);
            }
            zeros = 0;
            self.pass(1);
        }
        if zeros >= BLANK as u64 {
            return Found::Blank(self.at - zeros);
        }
        Found::Damage(why)
    }

    /// Returns that the file ends in the record with this opcode, after `length` bytes of it.
    fn cut(&mut self, opcode: u8, length: usize) -> Found {
        self.current = length;
        let why = self.failure.take().map_or_else(
            || "the file ends in the middle of a record".to_owned(),
            |failure| failure.to_string(),
        );
        Found::Cut(opcode, why)
    }

    /// Checks whether a record whose lengths confirm each other begins `at` bytes from here. With
    /// `reads`, it reads an attachment or metadata from the file to check it. Without `reads`, it
    /// confirms them only if they are in memory already.
    fn is_confirmed(&mut self, at: usize, reads: bool) -> bool {
        if reads {
            self.fill(at + HEAD + chunk::HEAD);
        }
        let rest = &self.rest()[at..];
        let Some((opcode, length)) = head(rest).filter(|(_, length)| *length <= LONGEST as u64)
        else {
            return rest == mcap::MAGIC;
        };
        let (length, body) = (length as usize, &rest[HEAD..]);
        let is_summary = |opcode: u8| (op::FOOTER..=op::METADATA_INDEX).contains(&opcode);
        match opcode {
            op::CHUNK => chunk::length(body) == Some(length),
            op::MESSAGE_INDEX => {
                let list = body.get(2..).and_then(|list| list.first_chunk());
                let list = list.map_or(0, |list| u32::from_le_bytes(*list) as usize);
                list > 0 && list % 16 == 0 && 2 + 4 + list == length
            }
            op::ATTACHMENT | op::METADATA => {
                let whole = at + HEAD + length;
                let there = if reads { self.fill(whole) } else { self.rest().len() >= whole };
                let body = || &self.rest()[at + HEAD..whole];
                there && extent_within(FOUND_PAIRS, opcode, body()) == Some(length)
            }
            op::DATA_END => {
                let next = body.get(4..).and_then(|next| next.first().copied());
                length == 4 && next.is_some_and(is_summary) && self.is_plausible(at + HEAD + 4)
            }
            op::SCHEMA | op::CHANNEL | op::MESSAGE if !self.chunked => self.is_linked(at),
            _ => false,
        }
    }

    /// Checks whether three records follow each other from the place `at` bytes from here.
    fn is_linked(&mut self, mut at: usize) -> bool {
        for _ in 0..3 {
            self.fill(at + HEAD);
            let Some((opcode, length)) = self.rest().get(at..).and_then(head) else { return false };
            let whole = at.saturating_add(HEAD).saturating_add(length as usize);
            if length > LINKED as u64 || !self.fill(whole) {
                return false;
            }
            let body = &self.rest()[at + HEAD..whole];
            if extent_within(FOUND_PAIRS, opcode, body).is_none() {
                return false;
            }
            at = whole;
        }
        true
    }

    /// Checks whether a record may begin `at` bytes from here, or the file ends there.
    fn is_plausible(&mut self, at: usize) -> bool {
        self.fill(at + HEAD);
        let rest = self.rest().get(at..).unwrap_or_default();
        let Some((opcode, length)) = head(rest) else { return true };
        if rest.starts_with(mcap::MAGIC) {
            return true;
        }
        let known = (1..=op::DATA_END).contains(&opcode);
        if !known || length < shortest(opcode) || length > LONGEST as u64 {
            return false;
        }
        // If the whole record is there, its fields must fit, too.
        let (begin, length) = (at + HEAD, length as usize);
        self.fill(begin + length.min(LINKED));
        self.rest().get(begin..begin + length).is_none_or(|body| match opcode {
            op::CHUNK => chunk::length(body) == Some(length),
            _ => extent(opcode, body).is_some(),
        })
    }

    /// Reads until `count` bytes are in memory. Returns `false` if the file has fewer.
    fn fill(&mut self, count: usize) -> bool {
        while self.buffer.len() - self.begin < count && !self.ended {
            // The passed bytes are removed once they are more than half of the buffer, so each
            // byte moves only a few times.
            if self.begin > self.buffer.len() / 2 {
                self.buffer.drain(..self.begin);
                self.begin = 0;
            }
            // A length in the file may be wrong, so memory grows only with the bytes that were
            // read.
            let there = self.buffer.len();
            self.buffer.reserve_exact(WINDOW.max(there / 4));
            self.buffer.resize(there + WINDOW, 0);
            let read = loop {
                match self.from.read(&mut self.buffer[there..]) {
                    Err(why) if why.kind() == std::io::ErrorKind::Interrupted => {}
                    read => break read,
                }
            };
            let count = read.unwrap_or_else(|why| {
                self.failure = Some(why);
                0
            });
            self.ended = count == 0;
            self.buffer.truncate(there + count);
        }
        self.buffer.len() - self.begin >= count
    }

    /// Returns the bytes that were read and are not passed yet.
    fn rest(&self) -> &[u8] {
        &self.buffer[self.begin..]
    }

    /// Moves the position by `count` bytes, but not beyond the bytes that were read.
    fn pass(&mut self, count: usize) {
        let count = count.min(self.rest().len());
        self.sum.update(&self.buffer[self.begin..self.begin + count]);
        self.begin += count;
        self.at += count as u64;
    }
}

/// Returns opcode and length of the record that begins with these bytes; `None` if they are too
/// few.
pub(super) fn head(bytes: &[u8]) -> Option<(u8, u64)> {
    let (opcode, rest) = bytes.split_first()?;
    Some((*opcode, u64::from_le_bytes(*rest.first_chunk()?)))
}

/// Fields of a record in their order, as far as they decide how long its body is.
struct Layout {
    /// Number of bytes before the texts.
    before: usize,
    /// Number of texts and maps; a length of 4 bytes precedes each.
    texts: usize,
    /// Number of bytes after these texts.
    between: usize,
    /// Number of further texts after these bytes.
    more: usize,
    /// Whether the last of the first `texts` is a map of texts.
    has_map: bool,
    /// Whether data follow, which a length of 8 bytes precedes.
    has_data: bool,
    /// Number of bytes after all of these.
    behind: usize,
}

/// Returns the layout of the records with this opcode; `None` for an unknown opcode.
fn layout(opcode: u8) -> Option<Layout> {
    let plain = |before, texts, behind| Layout {
        before,
        texts,
        between: 0,
        more: 0,
        has_map: false,
        has_data: false,
        behind,
    };
    Some(match opcode {
        op::HEADER => plain(0, 2, 0),
        op::FOOTER => plain(20, 0, 0),
        op::SCHEMA => plain(2, 3, 0),
        op::CHANNEL => Layout { has_map: true, ..plain(4, 3, 0) },
        op::MESSAGE => plain(22, 0, 0),
        op::MESSAGE_INDEX => plain(2, 1, 0),
        op::CHUNK_INDEX => Layout { between: 8, more: 1, ..plain(32, 1, 16) },
        op::ATTACHMENT => Layout { has_data: true, ..plain(16, 2, 4) },
        op::ATTACHMENT_INDEX => plain(40, 2, 0),
        op::STATISTICS => plain(42, 1, 0),
        op::METADATA => Layout { has_map: true, ..plain(0, 2, 0) },
        op::METADATA_INDEX => plain(16, 1, 0),
        op::SUMMARY_OFFSET => plain(17, 0, 0),
        op::DATA_END => plain(4, 0, 0),
        _ => return None,
    })
}

/// Returns the least length of the body of a record with this opcode (bytes), with empty texts.
fn shortest(opcode: u8) -> u64 {
    let least = |l: Layout| {
        l.before + 4 * l.texts + l.between + 4 * l.more + 8 * usize::from(l.has_data) + l.behind
    };
    layout(opcode).map_or(0, least) as u64
}

/// Returns how many bytes the fields of a record take; 0 for an unknown opcode, `None` if they do
/// not fit into `body` or if a map has more than [`PAIRS`] pairs. The data of a message have no
/// length of their own and are not counted. The check comes before the MCAP library, which trusts
/// these lengths when it reserves memory, and panics if an attachment ends before its checksum.
pub(super) fn extent(opcode: u8, body: &[u8]) -> Option<usize> {
    extent_within(PAIRS, opcode, body)
}

/// Returns the same as [`extent`], but accepts at most `pairs` pairs in a map.
fn extent_within(pairs: usize, opcode: u8, body: &[u8]) -> Option<usize> {
    let Some(layout) = layout(opcode) else { return Some(0) };
    let mut rest = body.get(layout.before..)?;
    let mut last = None;
    for _ in 0..layout.texts {
        last = Some(text(&mut rest)?);
    }
    if let (true, Some(mut map)) = (layout.has_map, last) {
        let mut count = 0;
        while !map.is_empty() {
            text(&mut map)?;
            text(&mut map)?;
            count += 1;
            if count > pairs {
                return None;
            }
        }
    }
    rest = rest.get(layout.between..)?;
    for _ in 0..layout.more {
        text(&mut rest)?;
    }
    if layout.has_data {
        let (length, behind) = rest.split_first_chunk()?;
        rest = behind.get(usize::try_from(u64::from_le_bytes(*length)).ok()?..)?;
    }
    rest = rest.get(layout.behind..)?;
    Some(body.len() - rest.len())
}

/// Splits a text off the front of `rest`, by the length of 4 bytes that precedes it. Returns `None`
/// if the text does not end within `rest`.
pub(super) fn text<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let (length, behind) = rest.split_first_chunk::<4>()?;
    let (text, behind) = behind.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    *rest = behind;
    Some(text)
}
