//! Steps in the mean image between parts of the sensor that may be read through different amplifiers: between
//! the middle lines, and between odd and even lines; in proportion to the signal and constant. Errors come
//! from the scatter of all other lines.

use super::jackknife::Value;
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

/// Lines averaged on each side of a step.
const REACH: usize = 4;
/// Distance of the farthest of a dozen normal numbers, in standard deviations: a hundred lines have about a
/// dozen places of eight lines.
const FARTHEST: f64 = 2.5;
/// Minimum number of lines for a search.
const FEWEST: usize = 64;

/// Fits a quantity of every profile by least squares: slope with the signal, and value at zero signal.
fn line(profiles: &[(f64, &[f64])], of: impl Fn(&[f64]) -> f64) -> (f64, f64) {
    let n = profiles.len() as f64;
    let points = || profiles.iter().map(|(m, p)| (*m, of(p)));
    let (sx, sy) = points().fold((0.0, 0.0), |(a, b), (m, s)| (a + m, b + s));
    let (mx, my) = (sx / n, sy / n);
    let (xx, xy) =
        points().fold((0.0, 0.0), |(a, b), (m, s)| (a + (m - mx).powi(2), b + (m - mx) * (s - my)));
    let slope = if xx > 0.0 { xy / xx } else { 0.0 };
    (slope, my - slope * mx)
}

/// Estimates the step between the middle lines, relative and in DN, from profiles (line means, DN) with their
/// signals, DN. `kept`: places of the lines that have pixels, ascending. `None` for fewer than 64 of them, or
/// if the lines in the middle have no pixels.
pub fn middle(profiles: &[(f64, &[f64])], kept: &[usize]) -> Option<[Value; 2]> {
    let all = profiles.first()?.1.len();
    let (lines, middle) = (kept.len(), kept.iter().filter(|x| **x < all / 2).count());
    if lines < FEWEST || !(2 * REACH..=lines - 2 * REACH).contains(&middle) {
        return None;
    }
    // Shading hides a step across a gap as wide as the averaged lines.
    if kept[middle] - kept[middle - 1] > REACH {
        return None;
    }
    // Slope and bend of the shading are subtracted.
    let step = |profile: &[f64], x: usize| {
        let part =
            |from: usize| kept[from..from + REACH].iter().map(|x| profile[*x]).sum::<f64>() / REACH as f64;
        let (l2, l1, r1, r2) = (part(x - 2 * REACH), part(x - REACH), part(x), part(x + REACH));
        (r1 - l1) - 0.5 * ((r2 - r1) + (l1 - l2))
    };
    let at = |x: usize| line(profiles, |p| step(p, x));
    let others: Vec<(f64, f64)> =
        (2 * REACH..=lines - 2 * REACH).filter(|x| x.abs_diff(middle) > 2 * REACH).map(at).collect();
    let here = at(middle);
    let rms = |of: &dyn Fn(&(f64, f64)) -> f64| {
        let square = others.iter().map(|o| of(o).powi(2)).sum::<f64>() / others.len() as f64;
        // Dust and edges of shading are rare and large: one may lie in the middle without being a step.
        let largest = others.iter().map(|o| of(o).abs()).fold(0.0, f64::max);
        square.sqrt().max(largest / FARTHEST).max(1e-9) * of_few(lines)
    };
    Some([Value { value: here.0, std_err: rms(&|o| o.0) }, Value { value: here.1, std_err: rms(&|o| o.1) }])
}

/// Probability at which an error from few places has the coverage of a normal one (a named choice).
const COVERED: f64 = 0.01;

/// Computes the factor of an error from few places: steps beyond 2.6 of the errors are then as rare by chance
/// as for normal numbers, one in a hundred. Places two reaches or more apart share no lines (Student 1908).
fn of_few(lines: usize) -> f64 {
    let places = lines.saturating_sub(4 * REACH) as f64 / (2 * REACH) as f64;
    let of_places = StudentsT::new(0.0, 1.0, places.max(1.0)).map(|t| t.inverse_cdf(0.5 * COVERED));
    of_places.map_or(1.0, |t| t / Normal::standard().inverse_cdf(0.5 * COVERED))
}

/// Estimates odd lines minus even lines, relative and in DN, as [`middle`].
pub fn odd(profiles: &[(f64, &[f64])], kept: &[usize]) -> Option<[Value; 2]> {
    let beside = kept.windows(3).filter(|w| w[1] % 2 == 1 && w[2] - w[0] == 2);
    let all: Vec<(f64, f64)> =
        beside.map(|w| line(profiles, |p| p[w[1]] - 0.5 * (p[w[0]] + p[w[2]]))).collect();
    if 2 * all.len() + 2 < FEWEST {
        return None;
    }
    let n = all.len() as f64;
    let of = |pick: &dyn Fn(&(f64, f64)) -> f64| {
        let mean = all.iter().map(pick).sum::<f64>() / n;
        let var = all.iter().map(|a| (pick(a) - mean).powi(2)).sum::<f64>() / (n - 1.0);
        // Each has a variance of 3/2; neighbours share an even line, which adds 1/2 to the variance of the
        // mean.
        Value { value: mean, std_err: (var * (4.0 / 3.0) / n).sqrt().max(1e-9) }
    };
    Some([of(&|a| a.0), of(&|a| a.1)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Many draws of lines with a fixed pattern: no step is found if there is none; a step of 1 % and 2 DN is
    /// found.
    #[test]
    fn errors_cover_and_steps_are_found() {
        let mut random = PixelRng::new(11, Stream::Effect, 0, 0, 0);
        let mut noise = || random.normal();
        let (mut squares, trials) = ([0.0; 4], 300);
        for _ in 0..trials {
            let pattern: Vec<(f64, f64)> = (0..128).map(|_| (0.002 * noise(), 0.5 * noise())).collect();
            let profile = |signal: f64, more: &dyn Fn(usize) -> f64| -> Vec<f64> {
                let of = |(x, (k, o)): (usize, &(f64, f64))| {
                    100.0 + signal * (1.0 + k - 1e-6 * (x as f64 - 60.0).powi(2)) + o + more(x)
                };
                pattern.iter().enumerate().map(of).collect()
            };
            let signals = [0.0, 300.0, 1000.0, 2500.0];
            let clean: Vec<Vec<f64>> = signals.iter().map(|s| profile(*s, &|_| 0.0)).collect();
            let view: Vec<(f64, &[f64])> =
                signals.iter().zip(&clean).map(|(s, p)| (*s, p.as_slice())).collect();
            let kept: Vec<usize> = (0..128).collect();
            let found = [middle(&view, &kept).unwrap(), odd(&view, &kept).unwrap()].concat();
            squares.iter_mut().zip(&found).for_each(|(s, v)| *s += (v.value / v.std_err).powi(2));
            let wrong: Vec<Vec<f64>> = signals
                .iter()
                .map(|s| profile(*s, &|x| if x % 2 == 1 { 0.01 * s + 2.0 } else { 0.0 }))
                .collect();
            let view: Vec<(f64, &[f64])> =
                signals.iter().zip(&wrong).map(|(s, p)| (*s, p.as_slice())).collect();
            let odd = odd(&view, &kept).unwrap();
            for (found, truth) in odd.iter().zip([0.01, 2.0]) {
                assert!((found.value - truth).abs() < 5.5 * found.std_err, "{found:?} {truth}");
            }
        }
        // 300 squares of unit mean have a deviation of 0.08. The errors are estimates themselves, for which
        // those of the middle are larger by a quarter.
        for (k, s) in squares.iter().enumerate() {
            let expected = if k < 2 { of_few(128).powi(-2) } else { 1.0 };
            assert!((s / f64::from(trials) - expected).abs() < 0.35, "{squares:?}");
        }
    }

    /// A hundred lines without a step, 4000 times: steps beyond 2.6 standard errors are no more frequent than
    /// by chance plus three standard deviations of their number (1 in 100: 40 +- 6.3).
    #[test]
    fn few_lines_make_no_steps() {
        let mut random = PixelRng::new(13, Stream::Effect, 0, 0, 0);
        let far = (0..4000).filter(|_| {
            let pattern: Vec<f64> = (0..100).map(|_| 0.002 * random.normal()).collect();
            let profiles: Vec<(f64, Vec<f64>)> = [300.0, 1000.0, 2500.0]
                .map(|signal| (signal, pattern.iter().map(|k| signal * (1.0 + k)).collect()))
                .to_vec();
            let view: Vec<(f64, &[f64])> = profiles.iter().map(|(s, p)| (*s, p.as_slice())).collect();
            let [step, _] = middle(&view, &(0..100).collect::<Vec<_>>()).unwrap();
            step.value.abs() > 2.576 * step.std_err
        });
        let far = far.count();
        assert!(far <= 59, "{far} of 4000");
    }
}
