//! Operations on sixteen bytes at once, by vector instructions where the processor has them.
//!
//! The search is written once, for any [`Lanes`]. `Vector` requires a processor with AVX2 and BMI2,
//! and a caller that is compiled for these, into which everything here is inlined.

#![allow(
    clippy::inline_always,
    reason = "the search is compiled once with vector instructions, and only callees that are \
              inlined into it can use them"
)]

/// Sixteen bytes that are looked up, added and compared at once.
pub(super) trait Lanes: Copy {
    /// Loads sixteen bytes.
    fn load(bytes: &[u8; 16]) -> Self;
    /// Stores the sixteen bytes.
    fn store(self) -> [u8; 16];
    /// Looks up bytes: byte `i` of the result is `self[index[i] & 15]`; indices are below 128.
    fn look_up(self, index: Self) -> Self;
    /// Computes the conjunction, bit by bit.
    fn and(self, other: Self) -> Self;
    /// Computes the exclusive or, bit by bit.
    fn xor(self, other: Self) -> Self;
    /// Adds byte by byte, modulo 256.
    fn add(self, other: Self) -> Self;
    /// Returns byte by byte the smaller of `self` and `self - modulus` (modulo 256), which reduces
    /// a sum of two residues.
    fn wrap(self, modulus: Self) -> Self;
    /// Collects bit `7 - LEFT` of each of the sixteen bytes: bit `i` of the result is from byte
    /// `i`.
    fn bits<const LEFT: i32>(self) -> u32;
    /// Returns the number whose seven base-3 digits are bits 4 and 5 of the first seven bytes, byte
    /// 0 as the lowest digit.
    fn ternary(self) -> u32;
    /// Collects the bits of `value` where `mask` has ones into the lowest bits, in their order.
    fn gathered(value: u32, mask: u32) -> u32;
    /// Prefetches the cache line of `table[at]`, which will be read later.
    fn prefetch(table: &[u8], at: usize);
}

/// Lanes for any processor.
#[derive(Clone, Copy)]
pub(super) struct Plain([u8; 16]);

impl Lanes for Plain {
    #[inline(always)]
    fn load(bytes: &[u8; 16]) -> Self {
        Self(*bytes)
    }

    #[inline(always)]
    fn store(self) -> [u8; 16] {
        self.0
    }

    #[inline(always)]
    fn look_up(self, index: Self) -> Self {
        Self(index.0.map(|i| self.0[usize::from(i & 15)]))
    }

    #[inline(always)]
    fn and(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] & other.0[i]))
    }

    #[inline(always)]
    fn xor(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] ^ other.0[i]))
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].wrapping_add(other.0[i])))
    }

    #[inline(always)]
    fn wrap(self, modulus: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].min(self.0[i].wrapping_sub(modulus.0[i]))))
    }

    #[inline(always)]
    fn bits<const LEFT: i32>(self) -> u32 {
        self.0.iter().enumerate().fold(0, |n, (i, b)| n | u32::from(b >> (7 - LEFT) & 1) << i)
    }

    #[inline(always)]
    fn ternary(self) -> u32 {
        self.0[..7].iter().rev().fold(0, |n, b| n * 3 + u32::from(b >> 4 & 3))
    }

    /// Moves the bits one by one, from the lowest one of the mask on.
    #[inline(always)]
    fn gathered(value: u32, mask: u32) -> u32 {
        let (mut bits, mut found, mut left) = (0, 0, mask);
        while left != 0 {
            bits |= (value >> left.trailing_zeros() & 1) << found;
            found += 1;
            left &= left - 1;
        }
        bits
    }

    #[inline(always)]
    fn prefetch(_: &[u8], _: usize) {}
}

#[cfg(target_arch = "x86_64")]
pub(super) use x86::Vector;

#[cfg(target_arch = "x86_64")]
mod x86 {
    #![allow(
        unsafe_code,
        reason = "vector instructions are unsafe to call; `Vector` is used only where a check has \
                  found AVX2 and BMI2"
    )]

    use super::Lanes;
    use std::arch::x86_64::{
        __m128i, _MM_HINT_NTA, _mm_add_epi8, _mm_and_si128, _mm_cvtsi128_si64, _mm_loadu_si128,
        _mm_madd_epi16, _mm_maddubs_epi16, _mm_min_epu8, _mm_movemask_epi8, _mm_prefetch,
        _mm_set1_epi8, _mm_setr_epi8, _mm_setr_epi16, _mm_shuffle_epi8, _mm_slli_epi16,
        _mm_storeu_si128, _mm_sub_epi8, _mm_xor_si128, _pext_u32,
    };

    /// Lanes for x86-64 with AVX2 and BMI2.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Vector(__m128i);

    impl Lanes for Vector {
        #[inline(always)]
        fn load(bytes: &[u8; 16]) -> Self {
            Self(unsafe { _mm_loadu_si128(bytes.as_ptr().cast()) })
        }

        #[inline(always)]
        fn store(self) -> [u8; 16] {
            let mut bytes = [0; 16];
            unsafe { _mm_storeu_si128(bytes.as_mut_ptr().cast(), self.0) };
            bytes
        }

        #[inline(always)]
        fn look_up(self, index: Self) -> Self {
            Self(unsafe { _mm_shuffle_epi8(self.0, index.0) })
        }

        #[inline(always)]
        fn and(self, other: Self) -> Self {
            Self(unsafe { _mm_and_si128(self.0, other.0) })
        }

        #[inline(always)]
        fn xor(self, other: Self) -> Self {
            Self(unsafe { _mm_xor_si128(self.0, other.0) })
        }

        #[inline(always)]
        fn add(self, other: Self) -> Self {
            Self(unsafe { _mm_add_epi8(self.0, other.0) })
        }

        #[inline(always)]
        fn wrap(self, modulus: Self) -> Self {
            Self(unsafe { _mm_min_epu8(self.0, _mm_sub_epi8(self.0, modulus.0)) })
        }

        #[inline(always)]
        fn bits<const LEFT: i32>(self) -> u32 {
            // `movemask` collects the top bits of all bytes. The shift is of 16-bit words, since
            // there is none of bytes; bits that cross into the upper byte stay below its top bit.
            unsafe { _mm_movemask_epi8(_mm_slli_epi16::<LEFT>(self.0)) as u32 }
        }

        #[inline(always)]
        fn ternary(self) -> u32 {
            // Two digits, then four, then all: a tree of multiplications instead of seven steps.
            // The digits stay shifted by 4 bits until the end.
            unsafe {
                let digits = _mm_and_si128(self.0, _mm_set1_epi8(0x30));
                let pairs = _mm_maddubs_epi16(
                    digits,
                    _mm_setr_epi8(1, 3, 1, 3, 1, 3, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0),
                );
                let fours = _mm_madd_epi16(pairs, _mm_setr_epi16(1, 9, 81, 729, 0, 0, 0, 0));
                let both = _mm_cvtsi128_si64(fours) as u64;
                ((both >> 32) as u32 + both as u32) >> 4
            }
        }

        #[inline(always)]
        fn gathered(value: u32, mask: u32) -> u32 {
            unsafe { _pext_u32(value, mask) }
        }

        #[inline(always)]
        fn prefetch(table: &[u8], at: usize) {
            // Non-temporal: a line of a table of 1 GB is hardly ever read twice.
            unsafe { _mm_prefetch::<_MM_HINT_NTA>(table.as_ptr().wrapping_add(at).cast()) };
        }
    }
}
