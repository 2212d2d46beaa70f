//! Fixed-pattern nonuniformity K (Section V.B, eq. 44 to 50) from flats of several configurations.
//!
//! The paper's procedure, made robust. Its initial slope is the mean over the configurations, which two spots
//! of the card at one site can shift so far that every good point is rejected. Here the search starts at the
//! median ([`Start::Median`]); the mean remains an option ([`Start::Mean`]).

use super::joint::mean_of;
pub use super::robust::Start;
use super::robust::{self, Light, Location};
use super::window;
use crate::statistics::median::median_of;
use ndarray::{Array2, Zip};

/// Options of the estimate of K.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Side m of the window, pixels.
    pub window: usize,
    /// Maximum distance p of the points kept from the start, in pooled deviations (eq. 49).
    pub p: f64,
    /// Start of the search.
    pub start: Start,
}

impl Default for Options {
    /// The paper's 9 x 9 and 1.5, from the median.
    fn default() -> Self {
        Self { window: 9, p: 1.5, start: Start::Median }
    }
}

/// K with its error.
#[derive(Debug, Clone)]
pub struct FixedPattern {
    /// K(a,b), (rows, columns), mean 1.
    pub k: Array2<f32>,
    /// Standard error of K at each pixel, from the scatter over the configurations. The error of the dark
    /// reference, which they share, is added by [`super::file::Calibration::new`].
    pub std_err: Array2<f32>,
    /// Number n1' of the configurations kept at each pixel.
    pub kept: Array2<u16>,
    /// Pooled deviation s of the slopes over the configurations.
    pub pooled_sd: f64,
    /// Mean of K before it was scaled to 1.
    pub mean_before: f64,
    /// Mean of the configurations above the dark reference, DN.
    pub level_dn: f64,
}

/// Mean of all configurations over the sound pixels, DN.
pub(super) fn level_of(configurations: &[Array2<f32>], sound: &Array2<bool>) -> f64 {
    configurations.iter().map(|e| mean_of(e, sound)).sum::<f64>() / configurations.len() as f64
}

/// Error: no K.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PatternError {
    /// One configuration cannot tell K from the card.
    #[error(
        "K needs three configurations or more, and there are {0}: with fewer it contains the card and the lamp; \
         --estimator smooth makes such a K, and takes off what of the light is smooth"
    )]
    TooFew(usize),
    /// Images of different sizes.
    #[error("configuration {index} is {found:?} px (rows, columns), the first {expected:?}")]
    Size {
        /// Place of the configuration in the list.
        index: usize,
        /// Size of the configuration.
        found: (usize, usize),
        /// Size of the first.
        expected: (usize, usize),
    },
    /// No sound pixel is left.
    #[error("no pixel gets light in all flats: nothing to calibrate")]
    NoPixels,
    /// No light.
    #[error("configuration {0} has no light: its mean is not above its dark reference")]
    Dark(usize),
}

/// Refuses input that no estimator of K can use.
pub(super) fn check(configurations: &[Array2<f32>]) -> Result<(), PatternError> {
    if configurations.len() < 3 {
        return Err(PatternError::TooFew(configurations.len()));
    }
    check_images(configurations)
}

/// Refuses images of different sizes and images without light.
pub(super) fn check_images(configurations: &[Array2<f32>]) -> Result<(), PatternError> {
    let expected = configurations[0].dim();
    for (index, image) in configurations.iter().enumerate() {
        if image.dim() != expected {
            return Err(PatternError::Size { index, found: image.dim(), expected });
        }
        let sum: f64 = image.iter().map(|&x| f64::from(x)).sum();
        if sum.is_nan() || sum <= 0.0 {
            return Err(PatternError::Dark(index));
        }
    }
    Ok(())
}

/// Estimates K by eq. (47) to (50). `configurations` are the e_i of eq. (46): averages of n2 frames, dark
/// reference subtracted, DN, each (rows, columns).
///
/// The standard error contains the scatter over the configurations and sigma_K / m, the error from K's own
/// mean over the window, which no averaging removes.
///
/// # Errors
///
/// If there are too few configurations, or they differ in size.
pub fn paper(configurations: &[Array2<f32>], options: Options) -> Result<FixedPattern, PatternError> {
    check(configurations)?;
    paper_of(configurations, options, &Array2::from_elem(configurations[0].dim(), true))
}

/// As `paper`, from the sound pixels only, with the others filled in; K of the others is meaningless.
pub(super) fn paper_of(
    configurations: &[Array2<f32>],
    options: Options,
    sound: &Array2<bool>,
) -> Result<FixedPattern, PatternError> {
    check(configurations)?;
    let n1 = configurations.len();
    let shape = configurations[0].dim();
    let light = Windows { images: configurations, side: options.window };
    let slopes = |at: (usize, usize), m: &mut Vec<f64>| {
        m.clear();
        m.extend(
            configurations
                .iter()
                .map(|e| f64::from(e[at]) / window::at(e.view(), options.window, at).max(1e-6)),
        );
    };
    let pooled_sd = pooled_deviation(sound, n1, slopes);
    let location = |scale: f64| Location::Kept { reach: (options.p * scale) as f32, start: options.start };
    let mut k = Array2::<f32>::zeros(shape);
    let kept = robust::estimate(configurations, &light, location(pooled_sd), &mut k);
    let mean = mean_of(&k, sound);
    k.mapv_inplace(|k| (f64::from(k) / mean) as f32);
    let spread = mean_of(&k.mapv(|k| (k - 1.0).powi(2)), sound);
    // Variance of the procedure itself for normal slopes, in units of s^2, and the number of points it keeps
    // of n1.
    let (variance, usual) = robust::efficiency(n1, location(1.0));
    let scatter = pooled_sd * pooled_sd * variance;
    let sigma_k2 = (spread - scatter).max(0.0);
    let std_err = Zip::indexed(&kept).map_collect(|at, &kept: &u16| {
        let share = if kept > 0 { usual / f64::from(kept) } else { usual };
        let of_window = sigma_k2 * window::variance(at, shape, options.window);
        (scatter * share + of_window).sqrt() as f32
    });
    let level_dn = level_of(configurations, sound);
    Ok(FixedPattern { k, std_err, kept, pooled_sd, mean_before: mean, level_dn })
}

/// Light as the means over windows.
struct Windows<'a> {
    images: &'a [Array2<f32>],
    side: usize,
}

impl Light for Windows<'_> {
    fn sweep(&self, first_row: usize) -> impl FnMut(&mut [f32]) {
        let mut all: Vec<_> =
            self.images.iter().map(|e| window::Sweep::new(e.view(), self.side, first_row)).collect();
        move |lights| {
            let columns = lights.len() / all.len().max(1);
            all.iter_mut().zip(lights.chunks_mut(columns)).for_each(|(sweep, row)| sweep.next(row));
        }
    }
}

/// Estimates the deviation of the slopes over the configurations, pooled over about ten thousand sites. Spots
/// are excluded: the paper averages sample deviations, here only points within four deviations of their
/// site's median count, about their own mean. The search starts at the median absolute deviation.
pub(super) fn pooled_deviation(
    sound: &Array2<bool>,
    n1: usize,
    slopes: impl Fn((usize, usize), &mut Vec<f64>),
) -> f64 {
    let (rows, columns) = sound.dim();
    let step = (rows * columns / 10_000).max(1);
    let (mut m, mut sorted) = (Vec::with_capacity(n1), Vec::with_capacity(n1));
    let mut sites = Vec::new();
    for i in (0..rows * columns).step_by(step).filter(|i| sound[(i / columns, i % columns)]) {
        slopes((i / columns, i % columns), &mut m);
        let middle = median_of(&m, &mut sorted);
        sites.extend(m.iter().map(|x| x - middle));
    }
    let sizes: Vec<f64> = sites.iter().map(|d| d.abs()).collect();
    let mut s = median_of(&sizes, &mut sorted) / 0.6745;
    for _ in 0..3 {
        let (mut square, mut dof) = (0.0, 0.0);
        for site in sites.chunks(n1) {
            let near = || site.iter().filter(|d| d.abs() <= 4.0 * s);
            let n = near().count() as f64;
            if n >= 2.0 {
                let mean = near().sum::<f64>() / n;
                square += near().map(|d| (d - mean).powi(2)).sum::<f64>();
                dof += n - 1.0;
            }
        }
        if dof <= 0.0 {
            break;
        }
        s = (square / dof).sqrt();
    }
    s
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    const SIGMA_K: f64 = 5e-3;
    pub const GRAIN: f64 = 4e-3;

    fn normal(stream: Stream, frame: u64, pixel: usize) -> f64 {
        PixelRng::new(3, stream, frame, pixel as u32, 0).normal()
    }

    /// Simulates a card of grain and spots under a lamp whose slope turns; returns the true K as well.
    pub fn bench(
        n1: u64,
        spots: f64,
        gradient: f64,
        (rows, columns): (usize, usize),
    ) -> (Vec<Array2<f32>>, Array2<f64>) {
        let truth = Array2::from_shape_fn((rows, columns), |(y, x)| {
            1.0 + SIGMA_K * normal(Stream::Uniformity, 0, y * columns + x)
        });
        let images = (0..n1)
            .map(|i| {
                let (sin, cos) = (2.4 * i as f64).sin_cos();
                Array2::from_shape_fn((rows, columns), |(y, x)| {
                    let pixel = y * columns + x;
                    let (u, v) = (x as f64 / columns as f64 - 0.5, y as f64 / rows as f64 - 0.5);
                    let spot = PixelRng::new(4, Stream::HotPixels, i, pixel as u32, 0).uniform() < spots;
                    let card = (1.0 + GRAIN * normal(Stream::Frame, i, pixel)) * if spot { 0.8 } else { 1.0 };
                    (1000.0 * (1.0 + gradient * (u * cos + v * sin)) * card * truth[(y, x)]) as f32
                })
            })
            .collect();
        (images, truth)
    }

    /// Computes the mean square of (K - truth) / stated error over pixels.
    pub fn chi2(found: &FixedPattern, truth: &Array2<f64>) -> f64 {
        let z2 = Zip::from(&found.k)
            .and(&found.std_err)
            .and(truth)
            .map_collect(|&k, &e, &t| ((f64::from(k) - t) / f64::from(e)).powi(2));
        z2.mean().unwrap()
    }

    #[test]
    fn k_is_found_within_its_stated_error() {
        for options in [Options::default(), Options { start: Start::Mean, ..Default::default() }] {
            let (images, truth) = bench(20, 0.0, 0.02, (96, 120));
            let found = paper(&images, options).unwrap();
            // 11,520 pixels, correlated over windows of 81: 0.05 is about 4 sigma.
            let c = chi2(&found, &truth);
            assert!((c - 1.0).abs() < 0.05, "{options:?}: {c}");
            let mean = found.k.mapv(f64::from).mean().unwrap();
            assert!((mean - 1.0).abs() < 1e-6);
        }
    }

    /// Two spots at one site shift its mean so far that every good point is lost; the median keeps them.
    #[test]
    fn the_median_survives_two_spots_at_one_site() {
        let (mut images, truth) = bench(12, 0.0, 0.0, (40, 40));
        for image in &mut images[..2] {
            image[(20, 20)] *= 0.5;
        }
        let error = |start| {
            let found = paper(&images, Options { start, ..Default::default() }).unwrap();
            ((f64::from(found.k[(20, 20)]) - truth[(20, 20)]).abs(), found.kept[(20, 20)])
        };
        let (median, kept) = error(Start::Median);
        assert!(median < 5.0 * GRAIN / 10f64.sqrt() && kept >= 6, "{median}, kept {kept}");
        let (_, kept) = error(Start::Mean);
        assert_eq!(kept, 0);
    }

    /// The paper: "the estimate of K is not sensitive to the choice of p". Between p of 1.2 and 2.5 K moves
    /// by less than its standard error at p = 1.5, and none is biased: the slope of K on the true K is 1 to
    /// within 5 of its errors.
    #[test]
    fn k_does_not_depend_on_p() {
        let (images, truth) = bench(20, 0.02, 0.02, (80, 80));
        let of = |p| paper(&images, Options { p, ..Default::default() }).unwrap();
        let reference = of(1.5);
        let error = reference.std_err.mapv(f64::from).mean().unwrap();
        for p in [1.2, 1.5, 2.0, 2.5] {
            let found = of(p);
            let moved = Zip::from(&found.k).and(&reference.k).map_collect(|&a, &b| f64::from(a - b).powi(2));
            let moved = moved.mean().unwrap().sqrt();
            assert!(moved < error, "p = {p}: moved by {moved}, error {error}");
            let (mut xy, mut xx) = (0.0, 0.0);
            Zip::from(&found.k).and(&truth).for_each(|&k, &t| {
                xy += (f64::from(k) - 1.0) * (t - 1.0);
                xx += (t - 1.0).powi(2);
            });
            let slope_error = error / xx.sqrt();
            // The window removes 1/81 of K's own variation.
            assert!((xy / xx - (1.0 - 1.0 / 81.0)).abs() < 5.0 * slope_error, "p = {p}: slope {}", xy / xx);
        }
    }

    #[test]
    fn what_cannot_give_k_is_refused() {
        let flat = |value| Array2::from_elem((8, 8), value);
        assert_eq!(paper(&[flat(1.0)], Options::default()).unwrap_err(), PatternError::TooFew(1));
        let mixed = [flat(1.0), flat(1.0), Array2::from_elem((8, 9), 1.0)];
        assert!(matches!(paper(&mixed, Options::default()), Err(PatternError::Size { index: 2, .. })));
        let dark = [flat(1.0), flat(-1.0), flat(1.0)];
        assert_eq!(paper(&dark, Options::default()).unwrap_err(), PatternError::Dark(1));
    }
}
