//! Frequency of a lamp's ripple: bands of a rolling shutter fade with the exposure as sinc(f T), and a few
//! frames show them with a large error. It gives a search its starts.

/// Frames of a flat under one exposure.
#[derive(Debug, Clone, Copy)]
pub struct Banded {
    /// Exposure, s.
    pub exposure_s: f64,
    /// Signal, DN.
    pub signal_dn: f64,
    /// Variance of the row means beyond what pixels and darks have, DN^2, and its error by their noise.
    pub row_var_dn2: (f64, f64),
    /// Number of frames.
    pub frames: f64,
}

/// Step between frequencies, in turns within the longest exposure, at first and about the best.
const STEPS: [f64; 2] = [0.02, 5e-4];
/// Slowest and fastest ripple, in turns within the longest exposure. A PWM lamp turns some twenty times
/// within it.
const TURNS: (f64, f64) = (0.1, 21.0);
/// Minima that are looked at closely.
const CLOSELY: usize = 8;
/// Frequencies that are given.
pub const GIVEN: usize = 3;
/// Twice the logarithm of the likelihood by which others may fall short of the best (a chance of e^-10).
const FAR: f64 = 20.0;
/// Rounds of the weights, which depend on the amplitude.
const ROUNDS: usize = 6;

/// Frequencies of a ripple, Hz, the likeliest first: of each the amplitude is the best. None without
/// exposures that differ by half.
pub fn frequencies(all: &[Banded]) -> Vec<f64> {
    let exposures = || all.iter().map(|b| b.exposure_s);
    let (shortest_s, longest_s) = exposures().fold((f64::INFINITY, 0.0f64), |(a, b), t| (a.min(t), b.max(t)));
    if all.len() < 4 || shortest_s > 0.67 * longest_s || longest_s <= 0.0 {
        return Vec::new();
    }
    let at = |turns: f64| score(all, turns / longest_s);
    let count = ((TURNS.1 - TURNS.0) / STEPS[0]) as usize;
    let coarse: Vec<f64> = (0..count).map(|i| at(TURNS.0 + STEPS[0] * i as f64)).collect();
    let mut minima: Vec<usize> =
        (1..count - 1).filter(|&i| coarse[i] <= coarse[i - 1] && coarse[i] < coarse[i + 1]).collect();
    minima.sort_by(|&a, &b| coarse[a].total_cmp(&coarse[b]));
    let per_step = (STEPS[0] / STEPS[1]) as i32;
    let closely = |&i: &usize| {
        let middle = TURNS.0 + STEPS[0] * i as f64;
        let near = (-per_step..=per_step).map(|k| middle + STEPS[1] * f64::from(k));
        near.map(|turns| (at(turns), turns / longest_s)).min_by(|a, b| a.0.total_cmp(&b.0))
    };
    let mut best: Vec<(f64, f64)> = minima.iter().take(CLOSELY).filter_map(closely).collect();
    best.sort_by(|a, b| a.0.total_cmp(&b.0));
    let first = best.first().map_or(0.0, |b| b.0);
    best.into_iter().take(GIVEN).filter(|b| b.0 < first + FAR).map(|b| b.1).collect()
}

/// Minus twice the logarithm of the likelihood of a ripple of this frequency with the best amplitude. Of n
/// frames with independent phases the mean product of two of different frames scatters by 1 / n (n - 1).
fn score(all: &[Banded], ripple_hz: f64) -> f64 {
    // Share of the signal's square that the ripple would have at amplitude 1.
    let shape = |b: &Banded| {
        let x = std::f64::consts::PI * ripple_hz * b.exposure_s;
        let left = if x < 1e-9 { 1.0 } else { libm::sin(x) / x };
        0.5 * (b.signal_dn * left).powi(2)
    };
    let shapes: Vec<f64> = all.iter().map(shape).collect();
    let variance = |b: &Banded, expected: f64| {
        expected * expected / (b.frames * (b.frames - 1.0)).max(1.0) + b.row_var_dn2.1.powi(2)
    };
    // Square of the amplitude.
    let mut square = 0.0;
    for round in 0..ROUNDS {
        let (mut product, mut weight) = (0.0, 0.0);
        for (b, shape) in all.iter().zip(&shapes) {
            let expected = if round == 0 { b.row_var_dn2.0 } else { square * shape };
            let v = variance(b, expected);
            product += shape * b.row_var_dn2.0 / v;
            weight += shape * shape / v;
        }
        square = (product / weight.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    }
    all.iter().zip(&shapes).fold(0.0, |sum, (b, shape)| {
        let v = variance(b, square * shape);
        sum + (b.row_var_dn2.0 - square * shape).powi(2) / v + v.ln()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Lamps of 100 to 900 Hz under exposures of 0.4 to 20 ms, three or four frames each: in 38 of 40
    /// campaigns one of the frequencies is the lamp's within 3 %, or within a tenth of a turn where that is
    /// more.
    #[test]
    fn a_ripple_has_its_frequency() {
        let mut found = 0;
        for run in 0..40u64 {
            let mut random = PixelRng::new(12, Stream::Effect, run, 0, 0);
            let hz = 100.0 * 9f64.powf(random.uniform());
            let rel = 0.02 * 10f64.powf(random.uniform());
            let exposures = [0.0004, 0.001, 0.0028, 0.0075, 0.005, 0.0101, 0.0125, 0.015, 0.0176, 0.02];
            let sets: Vec<Banded> = exposures
                .into_iter()
                .flat_map(|t| [(t, 3), (t, 4)])
                .map(|(exposure_s, frames)| {
                    let signal_dn = 1.7e5 * exposure_s;
                    let x = std::f64::consts::PI * hz * exposure_s;
                    let phases: Vec<f64> =
                        (0..frames).map(|_| std::f64::consts::TAU * random.uniform()).collect();
                    let n = f64::from(frames);
                    let of = |f: fn(f64) -> f64| phases.iter().map(|p| f(*p)).sum::<f64>() / n;
                    let apart = 1.0 - of(f64::cos).powi(2) - of(f64::sin).powi(2);
                    let ripple = 0.5 * (rel * signal_dn * x.sin() / x).powi(2) * apart * n / (n - 1.0);
                    let error = 0.4 * signal_dn / 96.0 * 0.09;
                    Banded {
                        exposure_s,
                        signal_dn,
                        row_var_dn2: (ripple + error * random.normal(), error),
                        frames: n,
                    }
                })
                .collect();
            let near = |f: &f64| (f - hz).abs() < (0.03 * hz).max(0.1 / 0.02);
            found += usize::from(frequencies(&sets).iter().any(near));
        }
        assert!(found >= 38, "{found} of 40");
    }

    #[test]
    fn one_exposure_tells_no_frequency() {
        let set = Banded { exposure_s: 0.01, signal_dn: 1000.0, row_var_dn2: (100.0, 1.0), frames: 4.0 };
        assert!(frequencies(&[set; 8]).is_empty() && frequencies(&[]).is_empty());
    }
}
