//! Still scene with a bright patch at two exposures: charge that leaks out of the patch, by direction.
//!
//! The short exposure is scaled up and the long one subtracted: a camera that adds nothing of its own leaves
//! nothing, for any scene and lens. Edges and blur are light and grow with the exposure. Smear and blooming
//! do not, nor do trails whose share depends on the charge.

use super::read::SceneMean;
use crate::dataset::{FrameRow, Kind};
use crate::statistics::jackknife::Value;
use crate::statistics::layout::Layout;
use ndarray::Array2;
use radcam_sim::predict::Prediction;
use std::ops::Range;

/// Pixels beside the patch that are searched for leaks, counted from its edge. The first is excluded: it has
/// part of the edge.
const NEAR: Range<usize> = 1..12;

/// Share of the charge spilled beyond the next pixels that may be lost or spread otherwise: barriers differ.
const LOST: f64 = 0.7;

/// Direction from the patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Towards row 0.
    Up,
    /// Away from row 0.
    Down,
    /// Towards column 0.
    Left,
    /// Away from column 0.
    Right,
    /// Along the columns, farther than [`Direction::Up`] and [`Direction::Down`] look.
    Columns,
    /// Pixels next to the patch along the columns, which spilled charge reaches first.
    Next,
}

impl Direction {
    /// All directions.
    pub const ALL: [Self; 6] = [Self::Up, Self::Down, Self::Left, Self::Right, Self::Columns, Self::Next];

    /// Returns the direction in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Up => "above",
            Self::Down => "below",
            Self::Left => "left of",
            Self::Right => "right of",
            Self::Columns => "far above and below",
            Self::Next => "next to",
        }
    }
}

/// A still scene at two exposures.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenePair {
    /// Short exposure scaled up minus the long one, beside the patch relative to the background away from it,
    /// DN.
    pub leaks: Vec<(Direction, Value)>,
    /// Light of the columns through the patch minus that of the others (means of whole columns), DN per
    /// second at the long exposure.
    column_light_dn_per_s: f64,
    /// Ratio of long to short exposure.
    ratio: f64,
    /// Patch in the short exposure, scaled to the long one, and background; DN above zero.
    patch_dn: f64,
    background_dn: f64,
    /// Numbers of rows of the patch, above it and below it.
    rows: [usize; 3],
    /// True if the zero of every pixel is known.
    zero_by_pixel: bool,
}

/// Returns the mean of the values and the variance of that mean from their scatter. The variance is enlarged
/// for few values, so that the mean over its error has the variance 1 (Student's t of n - 1 degrees has
/// (n - 1) / (n - 3)). `None` for fewer than four values.
fn mean(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let all: Vec<f64> = values.collect();
    let n = all.len() as f64;
    let mean = all.iter().sum::<f64>() / n;
    let var = all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 3.0);
    (n >= 4.0).then_some((mean, var / n))
}

impl ScenePair {
    /// Creates the pair from the mean images of scenes: the longest exposure and the shortest of equal light.
    /// `zero`: level of the darks, DN.
    pub fn of(means: &[&SceneMean], settings: &[FrameRow], zero: f64, layout: &Layout) -> Option<Self> {
        let scenes: Vec<_> = means.iter().filter(|s| settings[s.set].kind == Kind::Scene).collect();
        let by = |s: &SceneMean| settings[s.set].exposure_s;
        let long = scenes.iter().max_by(|a, b| by(a).total_cmp(&by(b)))?;
        let same = |s: &&&&SceneMean| settings[s.set].illumination == settings[long.set].illumination;
        let short = scenes.iter().filter(same).min_by(|a, b| by(a).total_cmp(&by(b)))?;
        let (t_long, t_short) = (by(long), by(short));
        let ratio = t_long / t_short;
        if ratio < 1.5 {
            return None;
        }
        let (rows, columns) = long.mean_dn.dim();
        let above_zero = |image: &Array2<f32>| {
            let dark = |i: usize| layout.zero.as_ref().map_or(zero, |z| f64::from(z[i]));
            Array2::from_shape_fn((rows, columns), |(y, x)| f64::from(image[(y, x)]) - dark(y * columns + x))
        };
        let image = above_zero(&long.mean_dn);
        let scaled = above_zero(&short.mean_dn) * ratio;
        // The patch is located in the short exposure: in the long one it may have spilled.
        let good = |y: usize, x: usize| layout.mask[y * columns + x] > 0.0;
        let sound = scaled.indexed_iter().filter(|((y, x), _)| good(*y, *x));
        let top = sound.map(|(_, v)| *v).fold(f64::MIN, f64::max);
        let bright =
            Array2::from_shape_fn((rows, columns), |(y, x)| good(y, x) && scaled[(y, x)] > 0.5 * top);
        let across: Vec<bool> = (0..columns).map(|x| bright.column(x).iter().any(|b| *b)).collect();
        let level: Vec<bool> = (0..rows).map(|y| bright.row(y).iter().any(|b| *b)).collect();
        let (left, right) = (across.iter().position(|b| *b)?, across.iter().rposition(|b| *b)?);
        let (first, last) = (level.iter().position(|b| *b)?, level.iter().rposition(|b| *b)?);
        let apart = &scaled - &image;
        // Lines are averaged first: the pixels of a line may have a pattern of their own.
        let by_column = |ys: &[usize], wanted: bool| {
            let xs = (0..columns).filter(|x| across[*x] == wanted);
            mean(xs.filter_map(|x| {
                let clear = ys.iter().filter(|y| good(**y, x)).map(|&y| apart[(y, x)]);
                let (sum, n) = clear.fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
                (n > 0.0).then(|| sum / n)
            }))
        };
        let by_row = |xs: &[usize]| {
            let ys = (0..rows).filter(|y| level[*y]);
            mean(ys.filter_map(|y| {
                let clear = xs.iter().filter(|x| good(y, **x)).map(|&x| apart[(y, x)]);
                let (sum, n) = clear.fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
                (n > 0.0).then(|| sum / n)
            }))
        };
        let before = |edge: usize| NEAR.filter_map(|d| edge.checked_sub(d + 1)).collect::<Vec<_>>();
        let behind =
            |edge: usize, end: usize| NEAR.map(|d| edge + d + 1).filter(|i| *i < end).collect::<Vec<_>>();
        let far: Vec<usize> = (0..rows).filter(|y| y + NEAR.end < first || *y > last + NEAR.end).collect();
        let clear: Vec<usize> = (0..rows).filter(|y| !level[*y]).collect();
        let rest = by_column(&clear, false)?;
        let rest_far = by_column(&far, false);
        let against = |here: Option<(f64, f64)>, rest: (f64, f64)| {
            here.map(|here| Value { value: here.0 - rest.0, std_err: (here.1 + rest.1).sqrt() })
        };
        let leak = |direction: Direction| match direction {
            Direction::Up => against(by_column(&before(first), true), rest),
            Direction::Down => against(by_column(&behind(last, rows), true), rest),
            Direction::Left => against(by_row(&before(left)), rest),
            Direction::Right => against(by_row(&behind(right, columns)), rest),
            Direction::Columns => rest_far.and_then(|rest| against(by_column(&far, true), rest)),
            Direction::Next => {
                let next: Vec<usize> =
                    first.checked_sub(1).into_iter().chain(Some(last + 1).filter(|y| *y < rows)).collect();
                against(by_column(&next, true), rest)
            }
        };
        let leaks: Vec<_> = Direction::ALL.into_iter().filter_map(|d| Some((d, leak(d)?))).collect();
        let light = |wanted: bool| {
            let xs = (0..columns).filter(|x| across[*x] == wanted);
            mean(xs.map(|x| image.column(x).sum() / rows as f64))
        };
        let inside = |wanted: bool, image: &Array2<f64>| {
            let all = image.iter().zip(&bright).filter(|(_, b)| **b == wanted).map(|(v, _)| *v);
            mean(all).map(|m| m.0)
        };
        Some(Self {
            leaks,
            column_light_dn_per_s: (light(true)?.0 - light(false)?.0) / t_long,
            ratio,
            patch_dn: inside(true, &scaled)?,
            background_dn: inside(false, &scaled)?,
            rows: [last + 1 - first, first, rows - 1 - last],
            zero_by_pixel: layout.zero.is_some(),
        })
    }

    /// Returns the predicted leak, DN.
    pub fn expected(&self, direction: Direction, p: &Prediction) -> f64 {
        let smear = p.smear_s * (self.ratio - 1.0) * self.column_light_dn_per_s;
        match direction {
            Direction::Left | Direction::Right => 0.0,
            Direction::Columns => {
                let far = self.rows[1..].iter().filter(|end| **end > NEAR.end);
                let (pixels, spilled) = far.fold((0.0, 0.0), |(pixels, spilled), end| {
                    let n = (end - NEAR.end) as f64;
                    (pixels + n, spilled + n * self.spilled(p, NEAR.end..*end))
                });
                smear - spilled / f64::max(pixels, 1.0)
            }
            Direction::Up => smear - self.spilled(p, NEAR.start..NEAR.end.min(self.rows[1])),
            Direction::Down => smear - self.spilled(p, NEAR.start..NEAR.end.min(self.rows[2])),
            Direction::Next => smear - self.spilled(p, 0..1),
        }
    }

    /// Returns the factor by which a pixel's own zero enters the leak. `clipped`: darks do not show the zero.
    pub fn zero_scaled(&self, clipped: bool) -> f64 {
        if self.zero_by_pixel && !clipped { 0.0 } else { self.ratio - 1.0 }
    }

    /// Returns the model error of the leak, DN. A part of the spilled charge may be lost on its way, and next
    /// to the patch the light of its edge has the same nonlinearity as the patch.
    pub fn unsure(&self, direction: Direction, p: &Prediction) -> f64 {
        let range = match direction {
            Direction::Left | Direction::Right => return 0.0,
            Direction::Next => {
                return 0.05 * (self.patch_dn - self.background_dn).abs() + 0.5 * self.spilled(p, 0..1);
            }
            Direction::Columns => NEAR.end..self.rows[1].max(self.rows[2]),
            Direction::Up => NEAR.start..NEAR.end.min(self.rows[1]),
            Direction::Down => NEAR.start..NEAR.end.min(self.rows[2]),
        };
        LOST * self.spilled(p, range)
    }

    /// Returns the mean charge that blooming leaves at these distances from the patch in the long exposure,
    /// DN.
    fn spilled(&self, p: &Prediction, range: Range<usize>) -> f64 {
        let well_dn = p.bloom_e * p.base.gain_dn_per_e;
        let room = well_dn - self.background_dn;
        let over = (self.patch_dn - well_dn).max(0.0) * self.rows[0] as f64;
        if over == 0.0 || room <= 0.0 || range.is_empty() {
            return 0.0;
        }
        // Half of the charge goes each way and fills pixel after pixel.
        let filled = 0.5 * over / room;
        room * (filled - range.start as f64).clamp(0.0, range.len() as f64) / range.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    const SIZE: usize = 64;

    /// A blurred patch on a slope, at two exposures, with `leak` added to the long one.
    fn pair(seed: u64, leak: impl Fn(usize, usize) -> f64) -> ScenePair {
        let profile =
            |i: usize| 0.5 * (libm::erf((i as f64 - 23.4) / 0.7) - libm::erf((i as f64 - 40.7) / 0.7));
        let light = |y: usize, x: usize| 300.0 + 0.5 * x as f64 + 2500.0 * profile(y) * profile(x);
        let image = |exposure: f64, set: usize, more: &dyn Fn(usize, usize) -> f64| SceneMean {
            frames: (0, 1),
            set,
            half: crate::observables::Half::First,
            mean_dn: Array2::from_shape_fn((SIZE, SIZE), |(y, x)| {
                let at = (y * SIZE + x) as u32;
                let noise = 0.5 * PixelRng::new(seed, Stream::Effect, set as u64, at, 0).normal();
                (100.0 + exposure * light(y, x) + more(y, x) + noise) as f32
            }),
        };
        let (long, short) = (image(1.0, 0, &leak), image(0.25, 1, &|_, _| 0.0));
        let row = |exposure_s: f64| FrameRow {
            file: String::new(),
            kind: Kind::Scene,
            set: 0,
            index: 0,
            exposure_s,
            illumination: 1.0,
            configuration: 0,
            temperature_c: None,
            timestamp_s: None,
        };
        let layout = Layout::new(&Array2::from_elem((SIZE, SIZE), true), 4095);
        ScenePair::of(&[&long, &short], &[row(0.02), row(0.005)], 100.0, &layout).unwrap()
    }

    fn sigmas(pair: &ScenePair, direction: Direction) -> f64 {
        let (_, leak) = pair.leaks.iter().find(|l| l.0 == direction).unwrap();
        leak.value / leak.std_err
    }

    #[test]
    fn a_blurred_patch_on_a_slope_leaks_nothing() {
        let pair = pair(7, |_, _| 0.0);
        assert_eq!(pair.leaks.len(), Direction::ALL.len());
        for d in Direction::ALL {
            assert!(sigmas(&pair, d).abs() < 4.0, "{d:?}: {}", sigmas(&pair, d));
        }
    }

    #[test]
    fn a_trail_is_found_where_it_lies() {
        let pair = pair(7, |y, x| if (24..41).contains(&x) && (42..50).contains(&y) { 3.0 } else { 0.0 });
        for d in Direction::ALL {
            let found = sigmas(&pair, d);
            // The long exposure has more than the short one predicts.
            assert!(if d == Direction::Down { found < -10.0 } else { found.abs() < 4.0 }, "{d:?}: {found}");
        }
    }
    #[test]
    fn errors_cover_the_truth() {
        const SEEDS: u64 = 400;
        let mut squares = [0.0; Direction::ALL.len()];
        for seed in 0..SEEDS {
            let pair = pair(seed, |_, _| 0.0);
            squares.iter_mut().zip(Direction::ALL).for_each(|(s, d)| *s += sigmas(&pair, d).powi(2));
        }
        for (d, s) in Direction::ALL.into_iter().zip(squares) {
            // Squares of normal deviations have the variance 2: five deviations of their mean.
            let mean = s / SEEDS as f64;
            assert!((mean - 1.0).abs() < 5.0 * (2.0 / SEEDS as f64).sqrt(), "{d:?}: mean square {mean}");
        }
    }
}
