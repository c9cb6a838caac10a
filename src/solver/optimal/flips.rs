//! Sets of flips as bits, and the image of a whole set under a turn or symmetry.
//!
//! - in: an affine map of the numbers of flips, over the integers modulo 2
//! - out: a short list of exchanges of words, and of bits within words, that carries a set to its
//!   image
//!
//! A set has one bit for each of the 2048 numbers of flips: number `64 w + b` is bit `b` of word
//! `w`. A turn permutes the flips and inverts some of them. If all eleven independent flips count,
//! the twelfth is the sum of the others. The map of the numbers therefore permutes their bits,
//! except that one bit may be the sum of all. A few hundred instructions move 2048 states at once,
//! which makes the tables cheap to build.

#![allow(
    clippy::inline_always,
    reason = "the build is compiled once with vector instructions, and only callees that are \
              inlined into it can use them"
)]

/// Number of bits of the number of a state of all flips.
pub(super) const BITS: usize = 11;

/// Masks of the positions within a word whose bit `p` is 0.
const LOW: [u64; 6] = [
    0x5555_5555_5555_5555,
    0x3333_3333_3333_3333,
    0x0f0f_0f0f_0f0f_0f0f,
    0x00ff_00ff_00ff_00ff,
    0x0000_ffff_0000_ffff,
    0x0000_0000_ffff_ffff,
];

/// One step of a map of sets, `new[i] = old[e(i)]`: its change `e` of the number `i`.
#[derive(Debug, Clone, Copy)]
enum Step {
    /// Exchanges bits `p` and `q` of the number, `p < q`.
    Swap(u8, u8),
    /// Adds to bit `p`, the first value, the sum of the other bits in a mask, the second value.
    Add(u8, u16),
}

/// Map of sets, `image[i] = set[matrix * i + offset]`, as a list of steps.
#[derive(Debug, Clone)]
pub(super) struct Carrier {
    steps: Vec<Step>,
}

impl Carrier {
    /// Makes the map from the columns of its matrix, modulo 2: `columns[k]` is the image of bit `k`
    /// of an index. At most one row of the matrix may have more than a single 1.
    pub(super) fn new(columns: &[u16; BITS]) -> Self {
        // rows[p]: the bits of the argument that sum up to bit p of the image.
        let mut rows: [u16; BITS] =
            std::array::from_fn(|p| (0..BITS).fold(0, |row, k| row | (columns[k] >> p & 1) << k));
        let mut steps = Vec::new();
        // matrix = steps[0] * steps[1] * ...; each step is removed from the left by its inverse,
        // which is the step itself. First the row with several bits is reduced to the one bit that
        // no other row has; its other bits are a sum of other rows.
        if let Some(p) = rows.iter().position(|r| r.count_ones() > 1) {
            let single = (0..BITS).find(|&k| rows.iter().all(|r| *r != 1 << k)).unwrap_or(0);
            let others = rows[p] & !(1 << single);
            let sum = (0..BITS)
                .filter(|&q| q != p && rows[q] & others != 0)
                .fold(0, |sum, q| sum | 1 << q);
            rows[p] = 1 << single;
            steps.push(Step::Add(p as u8, sum));
        }
        // The remaining permutation, sorted by exchanges.
        for p in 0..BITS {
            let q = rows.iter().position(|r| *r == 1 << p).unwrap_or(p);
            if q != p {
                rows.swap(p, q);
                steps.push(Step::Swap(p.min(q) as u8, p.max(q) as u8));
            }
        }
        Self { steps }
    }

    /// Returns the image of a set under the map, followed by an exclusive or of each index with
    /// `offset`: `image[i] = set[matrix * i + offset]`, modulo 2.
    #[inline(always)]
    pub(super) fn carry<const WORDS: usize>(
        &self,
        set: &[u64; WORDS],
        offset: u16,
    ) -> [u64; WORDS] {
        // The offset inverts bits of the number. Bits from 6 on exchange whole words, lower ones
        // exchange neighbouring groups of bits in each word.
        let high = usize::from(offset >> 6);
        let mut words: [u64; WORDS] = std::array::from_fn(|w| set[w ^ high]);
        for (p, low) in LOW.iter().enumerate() {
            if offset >> p & 1 == 1 {
                let shift = 1 << p;
                for word in &mut words {
                    *word = *word >> shift & low | (*word & low) << shift;
                }
            }
        }
        for step in &self.steps {
            match *step {
                Step::Swap(p, q) => swap(&mut words, p, q),
                Step::Add(p, sum) => add(&mut words, p, sum),
            }
        }
        words
    }
}

/// Exchanges the bits `p < q` in the index of every element of a set: elements whose index has only
/// `p` set change places with those whose index has only `q` set.
#[inline(always)]
fn swap<const WORDS: usize>(words: &mut [u64; WORDS], p: u8, q: u8) {
    if q < 6 {
        // Both within a word: the exchange is a masked shift.
        let mask = !LOW[usize::from(p)] & LOW[usize::from(q)];
        let shift = (1_u32 << q) - (1 << p);
        for word in words {
            let change = (*word ^ *word >> shift) & mask;
            *word ^= change ^ change << shift;
        }
    } else if p < 6 {
        // One bit selects the word, the other the half of each group: pairs of words exchange
        // halves.
        let (apart, mask, shift) = (1 << (q - 6), LOW[usize::from(p)], 1_u32 << p);
        for w in 0..WORDS {
            if w & apart == 0 {
                let (a, b) = (words[w], words[w | apart]);
                let change = (a >> shift ^ b) & mask;
                words[w] = a ^ change << shift;
                words[w | apart] = b ^ change;
            }
        }
    } else {
        // Both select the word: whole words change places.
        let (p, q) = (p - 6, q - 6);
        for w in 0..WORDS {
            if w >> p & 1 == 1 && w >> q & 1 == 0 {
                words.swap(w, w ^ 1 << p ^ 1 << q);
            }
        }
    }
}

/// Adds to bit `p` of the index of every element of a set the sum, modulo 2, of the index's bits in
/// the mask `sum`, which excludes `p`: `new[i] = old[i + sum(i) * 2^p]`.
#[inline(always)]
fn add<const WORDS: usize>(words: &mut [u64; WORDS], p: u8, sum: u16) {
    // One part of the sum depends on the position within the word: a mask. The other part depends
    // on the number of the word and inverts that mask.
    let within = (0..64_u64)
        .fold(0, |mask, b| mask | u64::from((b as u16 & sum & 63).count_ones() & 1) << b);
    let between = sum >> 6;
    let odd = |w: usize| (w as u16 & between).count_ones() & 1 == 1;
    if p < 6 {
        let (low, shift) = (LOW[usize::from(p)], 1_u32 << p);
        for (w, word) in words.iter_mut().enumerate() {
            let mask = if odd(w) { !within } else { within } & low;
            let change = (*word ^ *word >> shift) & mask;
            *word ^= change ^ change << shift;
        }
    } else {
        let apart = 1 << (p - 6);
        for w in 0..WORDS {
            if w & apart == 0 {
                let mask = if odd(w) { !within } else { within };
                let change = (words[w] ^ words[w | apart]) & mask;
                words[w] ^= change;
                words[w | apart] ^= change;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks [`Carrier::carry`] at each index against a product of matrix and index that is
    /// computed bit by bit.
    fn check<const WORDS: usize>(columns: [u16; BITS], offset: u16) {
        let carrier = Carrier::new(&columns);
        let set: [u64; WORDS] = std::array::from_fn(|w| {
            (w as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(w as u32)
        });

        let image = carrier.carry(&set, offset);

        let at = |set: &[u64; WORDS], i: u16| set[usize::from(i >> 6)] >> (i & 63) & 1;
        for i in 0..WORDS as u16 * 64 {
            let product = (0..BITS).filter(|k| i >> k & 1 == 1).fold(0, |sum, k| sum ^ columns[k]);
            assert_eq!(at(&image, i), at(&set, product ^ offset));
        }
    }

    #[test]
    fn set_image_matches_bitwise_product_for_permuting_matrix() {
        check::<32>(std::array::from_fn(|k| 1 << k), 0b101_0010_1101);
        check::<32>(std::array::from_fn(|k| 1 << (k * 7 % 11)), 0b110_0110_0011);
        check::<32>(std::array::from_fn(|k| 1 << (10 - k)), 1);
        check::<4>(std::array::from_fn(|k| if k < 8 { 1 << (7 - k) } else { 1 << k }), 0b1011_0110);
    }

    /// The bit that moves to the place of the twelfth flip occurs in the sum only.
    #[test]
    fn set_image_matches_bitwise_product_for_summing_matrix() {
        for sum in [0, 3, 6, 10] {
            let columns = std::array::from_fn(|k| {
                let alone = match (k, (k + 6) % 11) {
                    (4, _) => 0,
                    (_, place) if place == sum => 1 << 10,
                    (_, place) => 1 << place,
                };
                alone | 1 << sum
            });
            check::<32>(columns, 0b001_0111_0100);
        }
    }
}
