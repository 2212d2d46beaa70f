//! Kurtosis of the row means about their own: large if a few rows scatter at a time, instead of all alike.

use super::{ChunkView, Expected, Observable, Put, Statistic, View};
use crate::statistics::layout::Layout;
use crate::statistics::lines::Lines;
use radcam_sim::predict::Ripple;

/// Kurtosis of the row means; 3 for normal rows.
#[derive(Debug)]
pub struct RowTails;

/// Minimum numbers of rows and frames for a meaningful value.
const ROWS: usize = 32;
const FRAMES: usize = 3;

impl Statistic for RowTails {
    fn id(&self) -> &'static str {
        "kurtosis of row means"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "rows that scatter in bursts"
    }

    fn sums(&self, layout: &Layout) -> usize {
        usize::from(layout.shape.0 >= ROWS)
    }

    fn add(&self, _: &[f32], lines: &Lines, _: &Layout, sums: &mut [f64]) {
        let rows = lines.row_means();
        sums[0] += rows.iter().map(|m| f64::from(*m).powi(4)).sum::<f64>() / rows.len() as f64;
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        let r = chunk.summary();
        let square = r.line_var_dn2[0].powi(2);
        if let (Some(fourth), true) = (chunk.sums().first(), r.frames >= FRAMES && square > 0.0) {
            // The deviation of each frame from those before it is scaled to the variance of a frame, so all
            // are independent.
            put.put(0, fourth / square, 0.0);
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 3.0, 1.0) };
        let (rows, columns) = view.all.campaign.shape;
        let (shot, read) = view.of_rows(0);
        let (ripple, white) = (s.ripple(0.0), (shot + read) / columns as f64 + s.row.lag(0));
        // Lines of interference are sines down the rows.
        let stripes = view.stripes(true, 0, 0.0).variance;
        let fields = s.fields.of_rows();
        let all = (ripple + white + stripes + fields).max(1e-12);
        let wander = |(v, r): &(f64, Ripple)| match r {
            Ripple::Wander(next) => (*v, *next),
            Ripple::Sine(_) => (0.0, 0.0),
        };
        let (light, next) =
            s.ripples.iter().map(wander).fold((0.0, 0.0f64), |(v, a), (w, b)| (v + w, a.max(b)));
        let n = rows as f64 * view.dof / alike(light / all, next, fields / all, rows as f64);
        // The kurtosis of a sine is 1.5, and that of the difference of two sines 2.25. A frame minus the mean
        // of those before it lies between.
        let of_light = s.ripples.iter().map(|(v, r)| if let Ripple::Sine(_) = r { *v } else { 0.0 });
        let sine = (of_light.sum::<f64>() + stripes) / all;
        // Rows of unequal pixels scatter unequally.
        let noisy = s.unequal.max(0.0) / (view.noise * view.noise).max(1e-12);
        let unequal = 3.0 * noisy / columns as f64;
        // Unknown tails of the pixels' noise remain, reduced by the number of pixels in each row's mean.
        let tails =
            (3.0 * s.unsure + s.unsure_fourth) / (view.noise * view.noise).max(1e-12) / columns as f64;
        // Common noise of whole frames moves rows by their shading.
        let shading = (view.all.largest_spread.powi(2) * (s.common + view.moved))
            .max(view.with_light * view.all.field.rows)
            / all;
        let lines: f64 = s.lines.iter().map(|l| l.0).sum::<f64>() / columns as f64 / all;
        // Common noise of rows is noise in one camera and hum in another, with the kurtosis of a sine. Only
        // bursts rule out row noise.
        let rows_share = (s.row.lag(0) + ripple) / all;
        let hum = if o.measured.value < 3.0 { 1.5 * rows_share * rows_share } else { 0.0 };
        // Pixels noisier than the rest may lie in the same rows, as beside the edge of a clipped region: few
        // rows then have the noise.
        let unsure = hum
            + noisy
            + tails
            + 0.4 * sine * sine
            + 3.0 * shading
            + 3.0 * lines
            + 1.5 * (fields / all).powi(2)
            + 0.02;
        kurtosis(o.measured.value, n.max(16.0), unequal - 1.1 * sine * sine, unsure)
    }
}

/// Returns the number of rows that count as one. Under normal noise whose rows k apart have the correlation
/// r_k, the variance of the kurtosis is as much larger as the sum of r_k^4 over all k (Lomnicki 1961, Metrika
/// 4, 37). `wander`: part of the variance whose correlation falls by `next` from row to row; `common`: part
/// that all rows share.
fn alike(wander: f64, next: f64, common: f64, rows: f64) -> f64 {
    let of_power = |(j, times): (i32, f64)| {
        let a = next.powi(j);
        // A geometric series that ends with the frame.
        times * wander.powi(j) * common.powi(4 - j) * (a / (1.0 - a).max(1e-12)).min(rows - 1.0)
    };
    1.0 + 2.0 * (0..).zip([1.0, 4.0, 6.0, 4.0, 1.0]).map(of_power).sum::<f64>()
}

/// Distance kept from the pole of the transformation at some short tails; the pole is beyond six standard
/// errors.
const END: f64 = 0.2;

/// Returns the expected kurtosis of n normal numbers plus `more`, in the space in which it is normal
/// (Anscombe and Glynn 1983, Biometrika 70, 227).
fn kurtosis(measured: f64, n: f64, more: f64, unsure: f64) -> Expected {
    let expected = 3.0 * (n - 1.0) / (n + 1.0);
    let variance = 24.0 * n * (n - 2.0) * (n - 3.0) / ((n + 1.0).powi(2) * (n + 3.0) * (n + 5.0));
    let skewness = 6.0 * (n * n - 5.0 * n + 2.0) / ((n + 7.0) * (n + 9.0))
        * (6.0 * (n + 3.0) * (n + 5.0) / (n * (n - 2.0) * (n - 3.0))).sqrt();
    let a = 6.0 + 8.0 / skewness * (2.0 / skewness + (1.0 + 4.0 / (skewness * skewness)).sqrt());
    let x = (measured - more - expected) / variance.sqrt();
    let root = ((1.0 - 2.0 / a) / (1.0 + x * (2.0 / (a - 4.0)).sqrt()).max(END)).cbrt();
    let z = (1.0 - 2.0 / (9.0 * a) - root) / (2.0 / (9.0 * a)).sqrt();
    Expected {
        value: expected + more,
        std_err: variance.sqrt().hypot(unsure),
        common: 0.0,
        // In units of the kurtosis: the likelihood of a model with fewer independent rows counts its larger
        // errors.
        normal: (z * variance.sqrt(), 0.0, variance.sqrt().hypot(unsure)),
        heavy: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    fn kurtosis_of(numbers: &[f64]) -> f64 {
        let n = numbers.len() as f64;
        let moment = |k: i32| numbers.iter().map(|v| v.powi(k)).sum::<f64>() / n;
        moment(4) / moment(2).powi(2)
    }

    /// The example in the documentation of scipy.stats.kurtosistest: the numbers 0 to 19.
    #[test]
    fn the_transformation_is_that_of_scipy() {
        let numbers: Vec<f64> = (0..20).map(|i| f64::from(i) - 9.5).collect();
        let z = kurtosis(kurtosis_of(&numbers), 20.0, 0.0, 0.0).z();
        assert!((z + 1.705_810_415_212_206_2).abs() < 1e-9, "{z}");
    }

    /// For 2000 lists of 192 normal numbers the mean and variance of z agree within five standard errors, and
    /// three standard errors cover 99 to 100 %.
    #[test]
    fn errors_cover_normal_rows() {
        let of = |list: u32| {
            let mut rng = PixelRng::new(11, Stream::Effect, 0, list, 0);
            let numbers: Vec<f64> = (0..192).map(|_| rng.normal()).collect();
            kurtosis(kurtosis_of(&numbers), 192.0, 0.0, 0.0).z()
        };
        let all: Vec<f64> = (0..2000).map(of).collect();
        let mean = all.iter().sum::<f64>() / 2000.0;
        let variance = all.iter().map(|z| z * z).sum::<f64>() / 2000.0;
        assert!(mean.abs() < 5.0 / 2000f64.sqrt(), "{mean}");
        assert!((variance - 1.0).abs() < 5.0 * (2.0 / 2000f64).sqrt(), "{variance}");
        assert!(all.iter().filter(|z| z.abs() > 3.0).count() <= 20);
    }

    /// Over 2000 lists of 1000 rows that wander or share a number, beside independent noise, the variance of
    /// z is 1 within a tenth and five standard errors.
    #[test]
    fn errors_cover_rows_that_are_alike() {
        for (wander, next, common) in [(1.0f64, 0.9f64, 0.0f64), (0.5, 0.97, 0.0), (0.3, 0.9, 0.1)] {
            let of = |list: u32| {
                let mut rng = PixelRng::new(13, Stream::Effect, 0, list, 0);
                let (mut level, all) = (rng.normal(), common.sqrt() * rng.normal());
                let mut row = || {
                    level = next * level + (1.0 - next * next).sqrt() * rng.normal();
                    wander.sqrt() * level + all + (1.0 - wander - common).sqrt() * rng.normal()
                };
                let mut numbers = Vec::new();
                for _ in 0..1000 {
                    numbers.push(row());
                }
                kurtosis(kurtosis_of(&numbers), 1000.0 / alike(wander, next, common, 1000.0), 0.0, 0.0).z()
            };
            let variance = (0..2000).map(|list| of(list).powi(2)).sum::<f64>() / 2000.0;
            let within = 0.1 + 5.0 * (2.0 / 2000f64).sqrt();
            assert!((variance - 1.0).abs() < within, "{wander} {next} {common}: {variance}");
        }
    }

    /// A model with a tenth of the independent rows is less likely for kurtosis of so many rows, though its
    /// errors are three times as large: the mean of -2 ln p of 2000 lists is larger by that of normal numbers
    /// whose error is stated too large by root 10, ln 10 + 1 / 10 - 1, within five standard errors.
    #[test]
    fn larger_errors_cost_likelihood() {
        let cost = |list: u32| {
            let mut rng = PixelRng::new(12, Stream::Effect, 0, list, 0);
            let numbers: Vec<f64> = (0..640).map(|_| rng.normal()).collect();
            let measured = kurtosis_of(&numbers);
            let of = |n: f64| {
                let e = kurtosis(measured, n, 0.0, 0.0);
                e.z().powi(2) + 2.0 * e.normal.2.ln()
            };
            of(64.0) - of(640.0)
        };
        let all: Vec<f64> = (0..2000).map(cost).collect();
        let mean = all.iter().sum::<f64>() / 2000.0;
        let error = (all.iter().map(|c| (c - mean).powi(2)).sum::<f64>() / 2000.0 / 2000.0).sqrt();
        let expected = 10f64.ln() + 0.1 - 1.0;
        assert!((mean - expected).abs() < 5.0 * error + 0.2, "{mean} +- {error} for {expected}");
    }

    /// The shortest possible tails give a finite value.
    #[test]
    fn the_shortest_tails_are_finite() {
        let z = kurtosis(1.0, 64.0, 0.0, 0.0).z();
        assert!((-9.0..-3.0).contains(&z), "{z}");
    }
}
