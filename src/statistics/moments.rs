//! Mean and variance of every pixel over the frames of a set.
//!
//! Sums are kept as integers, so any split of the frames and any order of merging gives the same bits. Frames
//! given together are read once, in tiles that stay in the cache: 2 bytes of traffic per pixel and frame.

use ndarray::Array2;
use rayon::prelude::*;

/// Pixels per tile; the sums of a tile take 32 KiB.
const TILE: usize = 4096;
/// Pixels per work item of a thread.
const CHUNK: usize = 16 * TILE;

/// Sums of a pixel's codes and of their squares, for every pixel.
#[derive(Debug, Clone)]
pub struct Moments {
    shape: (usize, usize),
    frames: u64,
    sum: Vec<u64>,
    square: Vec<u64>,
    bit_depth: u8,
}

/// Error: frames differ in size.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("a frame of {found} pixels, where {expected} were expected")]
pub struct SizeMismatch {
    /// Pixels of the first frame.
    pub expected: usize,
    /// Pixels of the frame with another size.
    pub found: usize,
}

impl Moments {
    /// Creates an accumulator for frames of (rows, columns) with codes of at most `bit_depth` bits. Larger
    /// codes give wrong sums.
    pub fn new(shape: (usize, usize), bit_depth: u8) -> Self {
        let pixels = shape.0 * shape.1;
        let bit_depth = bit_depth.clamp(1, 16);
        Self { shape, frames: 0, sum: vec![0; pixels], square: vec![0; pixels], bit_depth }
    }

    /// Adds frames, each (rows * columns) codes in DN, row by row.
    ///
    /// ```
    /// use radcam::statistics::moments::Moments;
    /// let mut moments = Moments::new((1, 2), 12);
    /// moments.add(&[&[10, 20], &[14, 20]])?;
    /// assert_eq!(moments.variance_dn2(), ndarray::array![[8.0, 0.0]]); // n - 1 in the denominator
    /// # Ok::<(), radcam::statistics::moments::SizeMismatch>(())
    /// ```
    ///
    /// # Errors
    ///
    /// If the frames differ in size.
    pub fn add(&mut self, frames: &[&[u16]]) -> Result<(), SizeMismatch> {
        let expected = self.sum.len();
        if let Some(wrong) = frames.iter().find(|f| f.len() != expected) {
            return Err(SizeMismatch { expected, found: wrong.len() });
        }
        let (bit_depth, first) = (self.bit_depth, self.frames == 0);
        let arch = pulp::Arch::new();
        self.sum.par_chunks_mut(CHUNK).zip(self.square.par_chunks_mut(CHUNK)).enumerate().for_each(
            |(chunk, (sum, square))| {
                arch.dispatch(Chunk { frames, from: chunk * CHUNK, sum, square, bit_depth, first });
            },
        );
        self.frames += frames.len() as u64;
        Ok(())
    }

    /// Merges another accumulator.
    ///
    /// # Errors
    ///
    /// If the frames differ in size.
    pub fn merge(&mut self, other: &Self) -> Result<(), SizeMismatch> {
        if self.sum.len() != other.sum.len() {
            return Err(SizeMismatch { expected: self.sum.len(), found: other.sum.len() });
        }
        for (a, b) in [(&mut self.sum, &other.sum), (&mut self.square, &other.square)] {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        }
        self.frames += other.frames;
        self.bit_depth = self.bit_depth.max(other.bit_depth);
        Ok(())
    }

    /// Number of frames added.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Sum of each pixel's codes, DN.
    pub fn sums(&self) -> &[u64] {
        &self.sum
    }

    /// Discards all frames but keeps the memory for the next set.
    pub fn reset(&mut self) {
        self.frames = 0;
        self.sum.fill(0);
        self.square.fill(0);
    }

    /// Mean of each pixel, (rows, columns), DN; NaN before the first frame.
    pub fn mean_dn(&self) -> Array2<f64> {
        let n = self.frames as f64;
        let mut out = Array2::zeros(self.shape);
        self.map_into(&mut out, |s, _| s as f64 / n);
        out
    }

    /// Variance of each pixel over the frames with n - 1 in the denominator, (rows, columns), DN^2; NaN with
    /// fewer than two frames.
    pub fn variance_dn2(&self) -> Array2<f64> {
        let mut out = Array2::zeros(self.shape);
        self.variance_into(&mut out);
        out
    }

    /// Writes [`variance_dn2`](Self::variance_dn2) into `out`, which is reallocated if its shape differs.
    pub fn variance_into(&self, out: &mut Array2<f64>) {
        let n = self.frames as f64;
        let scale = 1.0 / (n * (n - 1.0));
        match u32::try_from(self.frames) {
            Ok(0 | 1) => self.map_into(out, |_, _| f64::NAN),
            // n sum x^2 < n^2 2^32 fits into 64 bits.
            Ok(frames) if frames < 1 << 16 => {
                let n = u64::from(frames);
                self.map_into(out, move |s, q| (n * q - s * s) as f64 * scale);
            }
            _ => self.map_into(out, |s, q| self.spread(s, q) * scale),
        }
    }

    /// n times the sum of squared deviations from each pixel's mean, summed over all pixels, DN^2: exact
    /// except for the final rounding.
    pub fn total_spread_dn2(&self) -> f64 {
        self.sum.iter().zip(&self.square).map(|(&s, &q)| self.spread(s, q)).sum()
    }

    /// n times the sum of squared deviations of one pixel from its mean, DN^2.
    pub fn spread_dn2(&self, pixel: usize) -> f64 {
        self.spread(self.sum[pixel], self.square[pixel])
    }

    /// Computes n sum x^2 - (sum x)^2 in 128 bits, since its terms can exceed 64 bits.
    fn spread(&self, s: u64, q: u64) -> f64 {
        (u128::from(self.frames) * u128::from(q)).saturating_sub(u128::from(s) * u128::from(s)) as f64
    }

    fn map_into(&self, out: &mut Array2<f64>, value: impl Fn(u64, u64) -> f64 + Sync) {
        if out.dim() != self.shape || !out.is_standard_layout() {
            *out = Array2::zeros(self.shape);
        }
        if let Some(out) = out.as_slice_mut() {
            let sums = self.sum.par_chunks(CHUNK).zip(self.square.par_chunks(CHUNK));
            out.par_chunks_mut(CHUNK).zip(sums).for_each(|(out, (sum, square))| {
                for ((o, &s), &q) in out.iter_mut().zip(sum).zip(square) {
                    *o = value(s, q);
                }
            });
        }
    }
}

/// Range of pixels of all frames: work item of one thread.
struct Chunk<'a> {
    frames: &'a [&'a [u16]],
    from: usize,
    sum: &'a mut [u64],
    square: &'a mut [u64],
    bit_depth: u8,
    /// True if the sums are still empty. New memory is written without being read: reading it first would
    /// make the system hand out every page twice.
    first: bool,
}

/// Frames summed in 32 bits between two additions to the 64-bit sums.
const BATCH: usize = 64;

impl pulp::NullaryFnOnce for Chunk<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { frames, from, sum, square, bit_depth, first } = self;
        // Sums, squares and, if the squares of a batch could exceed 32 bits, their upper halves separately.
        let (mut sums, mut squares, mut uppers) = ([0u32; TILE], [0u32; TILE], [0u32; TILE]);
        let wide = (BATCH as u64) << (2 * bit_depth) > 1 << 32;
        for (tile, (sum, square)) in sum.chunks_mut(TILE).zip(square.chunks_mut(TILE)).enumerate() {
            let from = from + tile * TILE;
            let n = sum.len();
            let (sums, squares, uppers) = (&mut sums[..n], &mut squares[..n], &mut uppers[..n]);
            for (number, batch) in frames.chunks(BATCH).enumerate() {
                sums.fill(0);
                squares.fill(0);
                // Four frames at once need a quarter of the accesses to the sums. Missing frames are zero.
                for four in batch.chunks(4) {
                    let [a, b, c, d] = std::array::from_fn(|i| match four.get(i) {
                        Some(frame) => &frame[from..from + n],
                        None => &ZEROS[..n],
                    });
                    if wide {
                        add_wide(sums, squares, uppers, [a, b, c, d]);
                    } else {
                        add_narrow(sums, squares, [a, b, c, d]);
                    }
                }
                if first && number == 0 {
                    for i in 0..n {
                        sum[i] = u64::from(sums[i]);
                        square[i] = u64::from(squares[i]);
                    }
                } else {
                    for i in 0..n {
                        sum[i] += u64::from(sums[i]);
                        square[i] += u64::from(squares[i]);
                    }
                }
                if wide {
                    for i in 0..n {
                        square[i] += u64::from(uppers[i]) << 16;
                    }
                    uppers.fill(0);
                }
            }
        }
    }
}

static ZEROS: [u16; TILE] = [0; TILE];

/// Adds frames of up to 13 bits: the squares of 64 frames fit into 32 bits.
#[inline(always)]
fn add_narrow(sums: &mut [u32], squares: &mut [u32], [a, b, c, d]: [&[u16]; 4]) {
    let pixels = a.iter().zip(b).zip(c.iter().zip(d));
    for ((s, q), ((&a, &b), (&c, &d))) in sums.iter_mut().zip(squares).zip(pixels) {
        let [a, b, c, d] = [a, b, c, d].map(u32::from);
        *s += a + b + c + d;
        *q += a * a + b * b + (c * c + d * d);
    }
}

/// Adds frames of any depth: both halves of each square are summed separately.
#[inline(always)]
fn add_wide(sums: &mut [u32], squares: &mut [u32], uppers: &mut [u32], [a, b, c, d]: [&[u16]; 4]) {
    let pixels = a.iter().zip(b).zip(c.iter().zip(d));
    for (((s, q), u), ((&a, &b), (&c, &d))) in sums.iter_mut().zip(squares).zip(uppers).zip(pixels) {
        let [a, b, c, d] = [a, b, c, d].map(u32::from);
        *s += a + b + c + d;
        let [a, b, c, d] = [a, b, c, d].map(|x| x * x);
        *q += (a & 0xFFFF) + (b & 0xFFFF) + (c & 0xFFFF) + (d & 0xFFFF);
        *u += (a >> 16) + (b >> 16) + (c >> 16) + (d >> 16);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn filled(frames: &[Vec<u16>], shape: (usize, usize), bits: u8) -> Moments {
        let mut m = Moments::new(shape, bits);
        m.add(&frames.iter().map(|f| &f[..]).collect::<Vec<_>>()).unwrap();
        m
    }

    #[test]
    fn full_scale_does_not_overflow() {
        for bits in [8u8, 10, 12, 14, 15, 16] {
            let full = ((1u32 << bits) - 1) as u16;
            let mut frames = vec![vec![full; 5]; 300];
            frames[7][2] = 0;
            let m = filled(&frames, (1, 5), bits);
            let (f, n) = (f64::from(full), 300.0);
            let expected = f * f * (n - 1.0) / n / (n - 1.0);
            assert_eq!(m.variance_dn2()[(0, 0)], 0.0, "{bits} bits");
            assert!((m.variance_dn2()[(0, 2)] / expected - 1.0).abs() < 1e-12, "{bits} bits");
        }
    }

    proptest! {
        /// Any split gives the same bits; the two-pass formula gives the same value to rounding.
        #[test]
        fn any_split_gives_the_same(
            frames in prop::collection::vec(prop::collection::vec(any::<u16>(), 12), 2..12),
            at in 0usize..12, bits in 8u8..=16,
        ) {
            let mask = ((1u32 << bits) - 1) as u16;
            let frames: Vec<Vec<u16>> =
                frames.into_iter().map(|f| f.into_iter().map(|x| x & mask).collect()).collect();
            let whole = filled(&frames, (3, 4), bits);
            let (a, b) = frames.split_at(at.min(frames.len()));
            let mut parts = filled(b, (3, 4), bits);
            parts.merge(&filled(a, (3, 4), bits)).unwrap();
            prop_assert_eq!(whole.mean_dn(), parts.mean_dn());
            prop_assert_eq!(whole.variance_dn2(), parts.variance_dn2());
            for p in 0..12 {
                let x: Vec<f64> = frames.iter().map(|f| f64::from(f[p])).collect();
                let n = x.len() as f64;
                let mean = x.iter().sum::<f64>() / n;
                let var = x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
                let got = whole.variance_dn2()[(p / 4, p % 4)];
                prop_assert!((got - var).abs() <= 1e-9 * (1.0 + var), "{} {}", got, var);
            }
            prop_assert!(Moments::new((2, 2), 8).merge(&whole).is_err());
        }
    }
}
