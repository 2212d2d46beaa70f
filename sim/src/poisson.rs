//! Exact Poisson numbers for every mean.
//!
//! Mean of 10 or more: the modified normal method PD (Ahrens and Dieter, "Computer generation of Poisson
//! deviates from modified normal distributions", ACM TOMS 8(2), 1982). A discretised normal number is
//! accepted at once if its probability does not exceed Poisson's. It exceeds it only below the mean; there
//! the number is accepted with probability p_k / f_k, and a rejected one is drawn again from the difference
//! p_k - f_k. Nothing is approximated: the paper fits a polynomial to f_k, here it is the difference of two
//! normal integrals. At a mean of 5000 one draw in 500 takes the slow path.
//!
//! Below 10: inversion of the distribution function.

#![allow(clippy::needless_range_loop)] // lanes are indexed: the shape that vectorises

use crate::rng::{LANES, NoiseLanes, PixelRng, Stream, exp_minus, floor};

/// Minimum mean of the modified normal method.
const NORMAL_FROM: f64 = 10.0;
const TWO_32: f64 = 4_294_967_296.0;

/// Reciprocals 1 / k. Beyond 128 a mean below 10 has no probability in double precision.
const RECIPROCALS: [f64; 128] = {
    let mut table = [0.0; 128];
    let mut k = 1;
    while k < 128 {
        table[k] = 1.0 / k as f64;
        k += 1;
    }
    table
};

/// Source of a pixel's further random numbers.
#[derive(Debug, Clone, Copy)]
pub struct Site {
    /// Seed of the camera.
    pub seed: u64,
    /// Number of the frame.
    pub frame: u64,
    /// First of the consecutive pixels, counted over the whole sensor.
    pub first_pixel: u32,
}

impl Site {
    fn pixel(self, i: usize) -> Self {
        Self { first_pixel: self.first_pixel.wrapping_add(i as u32), ..self }
    }
}

/// Draws Poisson numbers of `mean` electrons for [`LANES`] consecutive pixels.
///
/// A mean that is not above zero, or is NaN, gives zero.
#[inline(always)]
pub fn poisson_lanes(mean: &[f64; LANES], noise: &NoiseLanes, site: Site) -> [f64; LANES] {
    // Both paths give a pixel the same number, so that testing the first pixel is enough to guess the path.
    if mean[0] < NORMAL_FROM && mean.iter().all(|&m| m < NORMAL_FROM) {
        return invert_lanes(mean, &noise.bits, site);
    }
    let mut k = [0.0; LANES];
    for i in 0..LANES {
        // mu + sqrt(mu) T with T = sqrt(square) cos: one root for both.
        k[i] = floor(mean[i] + (mean[i] * noise.square[i]).sqrt() * noise.cos[i]);
    }
    // One test for the whole block: the branch is then almost always the same.
    let mut all = true;
    for i in 0..LANES {
        all &= accepted(mean[i], k[i], noise.bits[i]);
    }
    if !all {
        for i in 0..LANES {
            if !accepted(mean[i], k[i], noise.bits[i]) {
                k[i] = slow_draw(mean[i], k[i], noise.bits[i], site.pixel(i));
            }
        }
    }
    k
}

/// Draws a Poisson number of `mean` for one pixel, from the proposal `k` of its normal number and its 32
/// bits.
#[inline(never)]
fn slow_draw(mean: f64, k: f64, bits: f64, site: Site) -> f64 {
    // Far beyond any well the codes are clipped in any case, and double precision has no such integers.
    if mean > 1e14 {
        return mean;
    }
    if mean >= NORMAL_FROM {
        modified_normal(mean, k, bits, &mut more(site))
    } else if mean > 0.0 {
        invert(mean, bits, &mut more(site))
    } else {
        0.0
    }
}

/// Returns the stream of further random numbers of a pixel.
fn more(site: Site) -> PixelRng {
    PixelRng::new(site.seed, Stream::Frame, site.frame, site.first_pixel, 1)
}

/// Tests steps I and S of the method: k is at least floor(mu - 1.1484), or passes the cubic squeeze.
///
/// A k below zero never passes: then mu - k > mu >= 10, and the squeeze asks for a u above mu / 6.
#[inline(always)]
fn accepted(mu: f64, k: f64, bits: f64) -> bool {
    let below = mu - k;
    let squeezed = (6.0 / TWO_32) * mu * mu * bits >= below * below * below;
    (mu >= NORMAL_FROM) & ((below < 2.1484) | squeezed)
}

/// Runs [`invert`] for every lane at once. Further bits of u are drawn if its 32 bits do not decide, about
/// once in 2^32 / k draws.
#[inline(always)]
fn invert_lanes(mean: &[f64; LANES], bits: &[f64; LANES], site: Site) -> [f64; LANES] {
    let (mut mu, mut u) = ([0.0; LANES], [0.0; LANES]);
    let (mut p, mut below, mut k) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    let mut unclear = [false; LANES];
    for i in 0..LANES {
        mu[i] = if mean[i] > 0.0 { mean[i] } else { 0.0 };
        u[i] = bits[i] / TWO_32;
        p[i] = exp_minus(mu[i]);
        below[i] = p[i];
    }
    for reciprocal in &RECIPROCALS[1..] {
        let mut open = false;
        for i in 0..LANES {
            let above = u[i] >= below[i];
            unclear[i] |= !above & (u[i] + 2.0 / TWO_32 > below[i]);
            k[i] += if above { 1.0 } else { 0.0 };
            p[i] *= mu[i] * reciprocal;
            below[i] += p[i];
            open |= above;
        }
        if !open {
            break;
        }
    }
    for i in 0..LANES {
        if unclear[i] && mu[i] > 0.0 {
            k[i] = invert(mu[i], bits[i], &mut more(site.pixel(i)));
        }
    }
    k
}

/// Inverts the distribution function: returns the smallest k with P(K <= k) > u.
///
/// `bits` are the first 32 binary digits of u; further ones are drawn.
fn invert(mean: f64, bits: f64, more: &mut PixelRng) -> f64 {
    let u = (bits + more.uniform()) / TWO_32;
    let mut p = libm::exp(-mean);
    let (mut below, mut k) = (p, 0);
    while u >= below && k < RECIPROCALS.len() - 1 {
        k += 1;
        p *= mean * RECIPROCALS[k];
        below += p;
    }
    k as f64
}

/// Returns the upper tail probability of the normal distribution.
fn upper_tail(x: f64) -> f64 {
    0.5 * libm::erfc(x * std::f64::consts::FRAC_1_SQRT_2)
}

/// Returns the probability of k under the discretised normal: that mu + s T falls in [k, k + 1).
fn discrete_normal(mean: f64, root: f64, k: f64) -> f64 {
    let (a, b) = ((k - mean) / root, (k + 1.0 - mean) / root);
    // The tail on the side of the interval is used: its differences keep their digits.
    if a > 0.0 { upper_tail(a) - upper_tail(b) } else { upper_tail(-b) - upper_tail(-a) }
}

/// Returns the Poisson probability of k by Loader's saddle-point form (2000), without differences of large
/// logarithms.
fn probability(mean: f64, k: f64) -> f64 {
    if k < 0.0 {
        return 0.0;
    }
    if k == 0.0 {
        return libm::exp(-mean);
    }
    let stirling = if k < 16.0 {
        libm::lgamma(k + 1.0) - ((k + 0.5) * libm::log(k) - k + 0.918_938_533_204_672_7)
    } else {
        let z = 1.0 / (k * k);
        (1.0 / 12.0 - (1.0 / 360.0 - (1.0 / 1260.0 - z / 1680.0) * z) * z) / k
    };
    // k ln(k / mean) + mean - k = mean h(v), v = (k - mean) / mean, h(v) = (1 + v) ln(1 + v) - v.
    let v = (k - mean) / mean;
    let h = if v.abs() < 0.02 {
        let mut series = 0.0;
        for j in (2..=12).rev() {
            let term = if j % 2 == 0 { 1.0 } else { -1.0 } / f64::from(j * (j - 1));
            series = series * v + term;
        }
        series * v * v
    } else {
        (1.0 + v) * libm::log1p(v) - v
    };
    libm::exp(-stirling - mean * h) / (std::f64::consts::TAU * k).sqrt()
}

/// Runs steps Q to H of method PD, after the immediate acceptances have failed.
fn modified_normal(mean: f64, k: f64, bits: f64, more: &mut PixelRng) -> f64 {
    let root = mean.sqrt();
    if k >= 0.0 {
        // Accepted if u >= 1 - p_k / f_k; the further digits of u come from the next draw.
        let u = (bits + more.uniform()) / TWO_32;
        let f = discrete_normal(mean, root, k);
        if f * (1.0 - u) <= probability(mean, k) {
            return k;
        }
    }
    // Draws from the difference p_k - f_k, under the double exponential hat of the paper's step E.
    let hat = 0.1069 / mean;
    loop {
        let e = more.exponential();
        let u = 2.0 * more.uniform() - 1.0;
        let t = 1.8 + e.copysign(u);
        if t <= -0.6744 {
            continue;
        }
        let k = (mean + root * t).floor();
        let excess = probability(mean, k) - discrete_normal(mean, root, k);
        if hat * u.abs() <= excess * libm::exp(e) {
            return k;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Keys, noise_lanes};
    use statrs::distribution::{ChiSquared, ContinuousCDF, Discrete, Poisson};

    fn sample(mean: f64, seed: u64, blocks: u32) -> Vec<u64> {
        let mut counts = Vec::new();
        for block in 0..blocks {
            let site = Site { seed, frame: 3, first_pixel: block * LANES as u32 };
            let noise = noise_lanes(&Keys::new(seed), site.frame, site.first_pixel);
            for k in poisson_lanes(&[mean; LANES], &noise, site) {
                let k = k as usize;
                if counts.len() <= k {
                    counts.resize(k + 1, 0);
                }
                counts[k] += 1;
            }
        }
        counts
    }

    /// Chi-square p-value of drawn counts against exact probabilities; bins are merged until each expects at
    /// least 50.
    fn chi_square_p(mean: f64, counts: &[u64]) -> f64 {
        let total: u64 = counts.iter().sum();
        let exact = Poisson::new(mean).unwrap();
        let (mut chi2, mut bins) = (0.0, 0);
        let (mut seen, mut expected, mut left) = (0.0, 0.0, 1.0);
        for (k, &count) in counts.iter().enumerate() {
            let p = exact.pmf(k as u64);
            left -= p;
            seen += count as f64;
            expected += p * total as f64;
            if expected >= 50.0 && left * total as f64 >= 50.0 {
                chi2 += (seen - expected).powi(2) / expected;
                bins += 1;
                (seen, expected) = (0.0, 0.0);
            }
        }
        expected += left * total as f64;
        chi2 += (seen - expected).powi(2) / expected;
        1.0 - ChiSquared::new(f64::from(bins)).unwrap().cdf(chi2)
    }

    /// Ten means from 0.01 to 1e5, four million draws each. The smallest of ten valid p-values lies below
    /// 1e-4 once in a thousand sets of seeds; the seed here is fixed.
    #[test]
    fn counts_follow_the_poisson_distribution() {
        for (i, mean) in [0.01, 0.3, 1.0, 4.0, 9.99, 10.0, 31.6, 300.0, 5000.0, 1e5].into_iter().enumerate() {
            let p = chi_square_p(mean, &sample(mean, 100 + i as u64, 125_000));
            assert!(p > 1e-4, "mean {mean}: p = {p}");
        }
    }

    /// The method rests on three inequalities; they are checked here with exact probabilities, since the
    /// paper proves them for its own forms of p_k and f_k.
    #[test]
    fn the_inequalities_of_the_method_hold() {
        for mean in [10.0, 10.37, 12.9, 20.5, 77.7, 500.0, 5000.3, 1e5] {
            let root = f64::sqrt(mean);
            let low = (mean - 12.0 * root).floor().max(0.0);
            let mut k = low;
            while k < mean + 12.0 * root {
                let (p, f) = (probability(mean, k), discrete_normal(mean, root, k));
                let below = mean - k;
                if below < 2.1484 {
                    assert!(p >= f * (1.0 - 1e-9), "step I at mean {mean}, k {k}: {p} < {f}");
                } else {
                    let refused = 1.0 - p / f;
                    assert!(
                        refused <= below.powi(3) / (6.0 * mean * mean) + 1e-9,
                        "step S at mean {mean}, k {k}"
                    );
                }
                if p > f {
                    // Smallest value of the hat over the t that give this k.
                    let far = ((k - mean) / root - 1.8).abs().max(((k + 1.0 - mean) / root - 1.8).abs());
                    assert!(
                        p - f <= 0.1069 / mean * (-far).exp() * (1.0 + 1e-9),
                        "step H at mean {mean}, k {k}"
                    );
                    assert!((k + 1.0 - mean) / root > -0.6744, "step E at mean {mean}, k {k}");
                }
                k += 1.0;
            }
        }
    }

    #[test]
    fn probabilities_agree_with_a_library() {
        for mean in [10.0, 57.3, 5000.0, 1e5] {
            let exact = Poisson::new(mean).unwrap();
            for z in [-4.0, -1.0, -0.1, 0.0, 0.1, 1.0, 4.0] {
                let k = (mean + z * f64::sqrt(mean)).floor().max(0.0);
                let (ours, theirs) = (probability(mean, k), exact.pmf(k as u64));
                assert!((ours / theirs - 1.0).abs() < 1e-8, "mean {mean}, k {k}: {ours} {theirs}");
            }
        }
    }

    /// The number of a dim pixel does not depend on the brightness of its neighbours.
    #[test]
    fn a_pixel_does_not_see_its_neighbours() {
        for block in 0..2000 {
            let site = Site { seed: 9, frame: 1, first_pixel: block * LANES as u32 };
            let noise = noise_lanes(&Keys::new(9), 1, site.first_pixel);
            let mut means: [f64; LANES] = std::array::from_fn(|i| 0.3 * i as f64);
            let dim = poisson_lanes(&means, &noise, site);
            for bright in [0, 17] {
                means[bright] = 5000.0;
                let mixed = poisson_lanes(&means, &noise, site);
                assert!((0..LANES).filter(|&i| means[i] < 10.0).all(|i| mixed[i] == dim[i]), "block {block}");
            }
        }
    }

    #[test]
    fn no_light_gives_no_charge() {
        let noise = noise_lanes(&Keys::new(1), 0, 0);
        let mut means = [0.0; LANES];
        means[1] = -5.0;
        means[2] = f64::NAN;
        means[3] = 1e-12;
        let flood =
            poisson_lanes(&[f64::INFINITY; LANES], &noise, Site { seed: 1, frame: 0, first_pixel: 0 });
        assert!(flood.iter().all(|&k| k == f64::INFINITY));
        let k = poisson_lanes(&means, &noise, Site { seed: 1, frame: 0, first_pixel: 0 });
        assert_eq!(k, [0.0; LANES]);
    }
}
