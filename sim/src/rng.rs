//! Counter-based random numbers: every draw is a function of (seed, stream, frame, pixel, draw) alone.
//!
//! The generator is Philox 4x32-10 (Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy
//! as 1, 2, 3", SC 2011, section 3.3). There is no state to carry, so a pixel's noise is the same on one
//! thread or sixteen, in any order, and in any region of interest.
//!
//! The frame noise is drawn [`LANES`] pixels at a time by plain loops over arrays, which the compiler
//! turns into whatever vector instructions the machine has (see `draw.rs`). No fused multiply-add
//! and no system mathematics library is used, so a seed gives the same pixels on every machine.
#![allow(clippy::needless_range_loop)] // lanes are indexed: the shape that vectorises

/// Pixels drawn together: four AVX-512 registers of `f64`, enough independent work to hide the latency of
/// divisions and roots.
pub const LANES: usize = 32;

/// Purpose of a random number. Numbers of different streams are independent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u16)]
pub enum Stream {
    /// Shot and read noise of a frame.
    Frame = 0,
    /// The map of K, the fixed-pattern nonuniformity.
    Uniformity = 1,
    /// The map of dark current.
    DarkCurrent = 2,
    /// Choice and strength of hot pixels.
    HotPixels = 3,
    /// The fixed pattern of the black level.
    Offset = 4,
    /// Grain of the card and of painted squares.
    Card = 5,
    /// Spots on card and painted squares.
    Spots = 6,
    /// Numbers drawn by effects.
    Effect = 7,
    /// Map of the pixels' read noise.
    ReadNoise = 8,
    /// Pixels that are dead.
    DeadPixels = 9,
}

const M0: u64 = 0xD251_1F53;
const M1: u64 = 0xCD9E_8D57;
const W0: u32 = 0x9E37_79B9;
const W1: u32 = 0xBB67_AE85;
const ROUNDS: usize = 10;

/// The 128-bit counter of one draw: pixel, frame (48 bits), stream and draw number.
#[inline(always)]
fn counter(stream: Stream, frame: u64, pixel: u32, draw: u32) -> [u32; 4] {
    [pixel, frame as u32, ((frame >> 32) as u32 & 0xFFFF) | ((stream as u32) << 16), draw]
}

/// One block of Philox 4x32-10: 128 random bits for a 128-bit counter and a 64-bit key.
#[inline]
pub fn philox(key: u64, counter: [u32; 4]) -> [u32; 4] {
    let [mut c0, mut c1, mut c2, mut c3] = counter;
    let (mut k0, mut k1) = (key as u32, (key >> 32) as u32);
    for _ in 0..ROUNDS {
        let p0 = M0 * u64::from(c0);
        let p1 = M1 * u64::from(c2);
        (c0, c1, c2, c3) = ((p1 >> 32) as u32 ^ c1 ^ k0, p1 as u32, (p0 >> 32) as u32 ^ c3 ^ k1, p0 as u32);
        k0 = k0.wrapping_add(W0);
        k1 = k1.wrapping_add(W1);
    }
    [c0, c1, c2, c3]
}

/// Round keys of a seed, computed once for many blocks.
#[derive(Debug, Clone, Copy)]
pub struct Keys([[u64; 2]; ROUNDS]);

impl Keys {
    /// Computes the key schedule of Philox for `seed`.
    pub fn new(seed: u64) -> Self {
        let (mut k0, mut k1) = (seed as u32, (seed >> 32) as u32);
        Self(std::array::from_fn(|_| {
            let keys = [u64::from(k0), u64::from(k1)];
            k0 = k0.wrapping_add(W0);
            k1 = k1.wrapping_add(W1);
            keys
        }))
    }
}

/// Computes [`philox`] for [`LANES`] consecutive pixels, draw 0. The upper halves of the lanes hold garbage.
#[inline(always)]
fn philox_lanes(keys: &Keys, frame: u64, first_pixel: u32) -> [[u64; LANES]; 4] {
    let start = counter(Stream::Frame, frame, first_pixel, 0).map(u64::from);
    let mut c0: [u64; LANES] = std::array::from_fn(|i| start[0] + i as u64);
    let mut c1 = [start[1]; LANES];
    let mut c2 = [start[2]; LANES];
    let mut c3 = [start[3]; LANES];
    for [k0, k1] in keys.0 {
        for i in 0..LANES {
            let p0 = M0 * (c0[i] & LOW32);
            let p1 = M1 * (c2[i] & LOW32);
            c0[i] = (p1 >> 32) ^ c1[i] ^ k0;
            c1[i] = p1;
            c2[i] = (p0 >> 32) ^ c3[i] ^ k1;
            c3[i] = p0;
        }
    }
    [c0, c1, c2, c3]
}

const ONE_BITS: u64 = 0x3FF0_0000_0000_0000;
const MANTISSA: u64 = 0x000F_FFFF_FFFF_FFFF;
const LOW32: u64 = 0xFFFF_FFFF;

/// 2^52: an integer below it, written to the mantissa of this number, is added to it.
const TWO_52: f64 = 4_503_599_627_370_496.0;
/// Converts an integer below 2^52 to `f64`; vectorises on machines without such a conversion.
#[inline(always)]
fn from_integer_bits(bits: u64) -> f64 {
    f64::from_bits(TWO_52.to_bits() | bits) - TWO_52
}

/// Converts an integral `f64` from 0 to 2^52 to bits: the inverse of `from_integer_bits`; bits above the 52nd
/// are garbage.
#[inline(always)]
pub(crate) fn integer_bits(x: f64) -> u64 {
    (x + TWO_52).to_bits()
}

/// Returns the largest integer not above `x`, for |x| < 2^51, without a call on machines without such an
/// instruction.
#[inline(always)]
pub(crate) fn floor(x: f64) -> f64 {
    const ROUND: f64 = 1.5 * TWO_52;
    let r = (x + ROUND) - ROUND;
    if r > x { r - 1.0 } else { r }
}

/// Converts 52 random bits to a number in [0, 1).
#[inline(always)]
fn unit(bits: u64) -> f64 {
    f64::from_bits(ONE_BITS | (bits & MANTISSA)) - 1.0
}

/// -2 ln x of a normal number in (0, 1], to 1e-12, in vectorisable steps.
///
/// ln(m 2^e) = e ln 2 + 2 artanh((m - 1) / (m + 1)), with m in [sqrt(1/2), sqrt 2).
#[inline(always)]
fn minus_two_ln(x: f64) -> f64 {
    const ROOT_HALF_BITS: u64 = std::f64::consts::FRAC_1_SQRT_2.to_bits();
    // Moves the boundary between two exponents from 1 to sqrt(1/2).
    let moved = x.to_bits() + (ONE_BITS - ROOT_HALF_BITS);
    let e = f64::from_bits(TWO_52.to_bits() | (moved >> 52)) - (TWO_52 + 1023.0);
    let m = f64::from_bits((moved & MANTISSA) + ROOT_HALF_BITS);
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    let mut p = -4.0 / 13.0;
    p = p * z - 4.0 / 11.0;
    p = p * z - 4.0 / 9.0;
    p = p * z - 4.0 / 7.0;
    p = p * z - 4.0 / 5.0;
    p = p * z - 4.0 / 3.0;
    p = p * z - 4.0;
    e * (-2.0 * std::f64::consts::LN_2) + s * p
}

/// exp(-x) for 0 <= x < 700, to 1e-15, in vectorisable steps: 2^n times the Taylor series of exp over |r| <=
/// ln 2 / 2.
#[inline(always)]
pub(crate) fn exp_minus(x: f64) -> f64 {
    let n = floor(0.5 - x * std::f64::consts::LOG2_E);
    // ln 2 in two parts, so that n ln 2 is exact to the last digit of x.
    let r = (-x - n * 6.931_471_803_691_238e-1) - n * 1.908_214_929_270_587_7e-10;
    let mut e = 1.0;
    for inverse in INVERSES {
        e = e * r * inverse + 1.0;
    }
    e * f64::from_bits(integer_bits(n + 1023.0) << 52)
}

/// 1/13 to 1/1: exp(r) = 1 + r/1 (1 + r/2 (1 + ...)).
const INVERSES: [f64; 13] = {
    let mut table = [0.0; 13];
    let mut i = 0;
    while i < 13 {
        table[i] = 1.0 / (13 - i) as f64;
        i += 1;
    }
    table
};

/// (cos, sin) of pi/2 `f` for |f| <= 1/2, to 1e-11, in vectorisable steps: Taylor series.
#[inline(always)]
fn cos_sin_quarter(f: f64) -> (f64, f64) {
    const fn term(power: u32, factorial: f64) -> f64 {
        let (mut x, mut i) = (1.0, 0);
        while i < power {
            x *= std::f64::consts::FRAC_PI_2;
            i += 1;
        }
        x / factorial
    }
    const S: [f64; 6] = [
        term(1, 1.0),
        term(3, -6.0),
        term(5, 120.0),
        term(7, -5_040.0),
        term(9, 362_880.0),
        term(11, -39_916_800.0),
    ];
    const C: [f64; 6] = [
        term(2, -2.0),
        term(4, 24.0),
        term(6, -720.0),
        term(8, 40_320.0),
        term(10, -3_628_800.0),
        term(12, 479_001_600.0),
    ];
    let z = f * f;
    let (mut s, mut c) = (S[5], C[5]);
    for i in (0..5).rev() {
        s = s * z + S[i];
        c = c * z + C[i];
    }
    (c * z + 1.0, s * f)
}

/// Converts 96 random bits to a point of the two-dimensional normal distribution (Box and Muller 1958): the
/// square of its distance from the origin, -2 ln U, and its direction (cos, sin).
#[inline(always)]
fn normal_polar(w0: u64, w1: u64, w2: u64) -> (f64, f64, f64) {
    // 52 bits for the distance, U in (0, 1].
    let u = 2.0 - f64::from_bits(ONE_BITS | (w0 & LOW32) | ((w1 & 0xF_FFFF) << 32));
    let square = minus_two_ln(u);
    // 44 bits for the direction: 42 for the angle within a quarter turn about the x axis, one that turns it
    // to the other side of the origin, one that swaps the axes.
    let f = f64::from_bits(ONE_BITS | ((w2 & LOW32) << 20) | ((w1 & LOW32) >> 22)) - 1.5;
    let (c, s) = cos_sin_quarter(f);
    let c = f64::from_bits(c.to_bits() ^ ((w1 << 43) & (1 << 63)));
    if w1 & (1 << 21) != 0 { (square, s, c) } else { (square, c, s) }
}

/// Random numbers of the pixels in one frame. Each pixel has a point of the two-dimensional normal
/// distribution, one coordinate for the charge and one for the amplifier, and 32 uniform bits that decide the
/// Poisson draw.
#[derive(Debug, Clone, Copy)]
pub struct NoiseLanes {
    /// Squared distance of the point from the origin.
    pub square: [f64; LANES],
    /// Cosine of its direction: the standard normal number of the charge is `sqrt(square) * cos`.
    pub cos: [f64; LANES],
    /// Standard normal number of the amplifier, `sqrt(square) * sin`, to single precision.
    pub read: [f64; LANES],
    /// Uniform integer below 2^32, held as `f64`.
    pub bits: [f64; LANES],
}

/// Returns the frame noise of [`LANES`] consecutive pixels, starting at `first_pixel` of the whole sensor.
#[inline(always)]
pub fn noise_lanes(keys: &Keys, frame: u64, first_pixel: u32) -> NoiseLanes {
    let [w0, w1, w2, w3] = philox_lanes(keys, frame, first_pixel);
    let zero = [0.0; LANES];
    let mut noise = NoiseLanes { square: zero, cos: zero, read: zero, bits: zero };
    for i in 0..LANES {
        let (square, cos, sin) = normal_polar(w0[i], w1[i], w2[i]);
        noise.square[i] = square;
        noise.cos[i] = cos;
        // Single precision is ample for noise of an amplifier's voltage, and takes a third of the time.
        noise.read[i] = f64::from((square as f32).sqrt()) * sin;
        noise.bits[i] = from_integer_bits(w3[i] & LOW32);
    }
    noise
}

/// Random numbers of one pixel for the rare cases that need more than [`NoiseLanes`] holds, and for maps.
#[derive(Debug, Clone)]
pub struct PixelRng {
    key: u64,
    counter: [u32; 4],
}

impl PixelRng {
    /// Creates the random stream of `pixel` of `frame` in `stream`, beginning with draw `draw`.
    pub fn new(seed: u64, stream: Stream, frame: u64, pixel: u32, draw: u32) -> Self {
        Self { key: seed, counter: counter(stream, frame, pixel, draw) }
    }

    fn block(&mut self) -> [u32; 4] {
        let out = philox(self.key, self.counter);
        self.counter[3] = self.counter[3].wrapping_add(1);
        out
    }

    /// Draws a uniform number in [0, 1) with 52 bits.
    pub fn uniform(&mut self) -> f64 {
        let [a, b, ..] = self.block();
        unit(u64::from(a) | (u64::from(b) << 32))
    }

    /// Draws two independent standard normal numbers.
    pub fn normal_pair(&mut self) -> (f64, f64) {
        let [a, b, c, _] = self.block();
        let (square, cos, sin) = normal_polar(a.into(), b.into(), c.into());
        let r = square.sqrt();
        (r * cos, r * sin)
    }

    /// Draws a standard normal number.
    pub fn normal(&mut self) -> f64 {
        self.normal_pair().0
    }

    /// Draws a number of the exponential distribution with mean 1.
    pub fn exponential(&mut self) -> f64 {
        -libm::log(1.0 - self.uniform())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers of the Random123 distribution (file kat_vectors, philox4x32 10).
    #[test]
    fn philox_gives_the_published_known_answers() {
        assert_eq!(philox(0, [0; 4]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(philox(u64::MAX, [u32::MAX; 4]), [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]);
        let key = 0x299f_31d0_a409_3822;
        let counter = [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344];
        assert_eq!(philox(key, counter), [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]);
    }

    #[test]
    fn lanes_equal_the_scalar_generator() {
        let (seed, frame) = (0x1234_5678_9abc_def0, 0x1_0000_0007);
        let lanes = philox_lanes(&Keys::new(seed), frame, 1000);
        for i in 0..LANES {
            let scalar = philox(seed, counter(Stream::Frame, frame, 1000 + i as u32, 0));
            assert_eq!(scalar, [0, 1, 2, 3].map(|w| lanes[w][i] as u32));
        }
    }

    #[test]
    fn elementary_functions_are_accurate() {
        let mut worst = (0.0_f64, 0.0_f64);
        for i in 0..100_000 {
            let u = (f64::from(i) + 0.5) / 100_000.0;
            worst.0 = worst.0.max((minus_two_ln(u) / -2.0 - libm::log(u)).abs() / (1.0 + libm::log(u).abs()));
            let tiny = u * 2f64.powi(-50);
            worst.0 =
                worst.0.max((minus_two_ln(tiny) / -2.0 - libm::log(tiny)).abs() / libm::log(tiny).abs());
            let (c, s) = cos_sin_quarter(u - 0.5);
            let angle = std::f64::consts::FRAC_PI_2 * (u - 0.5);
            worst.1 = worst.1.max((c - libm::cos(angle)).abs()).max((s - libm::sin(angle)).abs());
        }
        for i in 0..10_000 {
            let x = f64::from(i) * 1e-3;
            assert!((exp_minus(x) / libm::exp(-x) - 1.0).abs() < 2e-15, "exp(-{x})");
        }
        assert!(worst.0 < 1e-12 && worst.1 < 1e-11, "{worst:?}");
    }

    /// Moments of 2^20 pairs, each within 5 of its own standard errors.
    #[test]
    fn normals_have_normal_moments() {
        let n = 1 << 20;
        let mut sums = [0.0; 6];
        for pixel in 0..n {
            let (a, b) = PixelRng::new(7, Stream::Offset, 0, pixel, 0).normal_pair();
            for (sum, x) in sums.iter_mut().zip([a, a * a, b, b * b, a * b, a.powi(4)]) {
                *sum += x;
            }
        }
        let n = f64::from(n);
        let expected = [(0.0, 1.0), (1.0, 2.0), (0.0, 1.0), (1.0, 2.0), (0.0, 1.0), (3.0, 96.0)];
        for (sum, (mean, variance)) in sums.iter().zip(expected) {
            let z = (sum / n - mean) / (variance / n).sqrt();
            assert!(z.abs() < 5.0, "{z} for expected {mean}");
        }
    }
}
