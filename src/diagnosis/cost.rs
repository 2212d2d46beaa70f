//! Cost of an unmodelled effect: error of the photon-transfer gain, of the read noise and of the linearity of
//! the same frames.
//!
//! The expected means and variances of all sets are put through the estimates that `radcam noise` and `radcam
//! emva` make: a weighted line of the variance over the mean (Healey and Kondepudy 1994, eq. 41), and the largest
//! relative deviation of the mean from a line over the light (EMVA 1288 release 4, section 7), once with the
//! effect and once without.

use crate::dataset::Kind;
use crate::inference::{Effects, Fitted};
use crate::number::finite;
use crate::observables::{Observations, expectations, mean, variance};
use radcam_sim::effects::{self, Effect};
use serde::{Deserialize, Serialize};

/// Relative errors of three results where an effect is left out of account; 0 where this campaign does not tell.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Cost {
    /// Error of the system gain by photon transfer.
    #[serde(with = "finite")]
    pub gain_rel: f64,
    /// Error of the read noise by photon transfer.
    #[serde(with = "finite")]
    pub read_noise_rel: f64,
    /// Largest deviation of the signal from a line over the light, beyond what is there without it.
    #[serde(with = "finite")]
    pub linearity_rel: f64,
}

/// Levels up to this share of full scale are used (EMVA 1288 takes 70 % of saturation for the gain; a named
/// choice).
const TOP: f64 = 0.9;
/// Levels from this share of the largest on tell the linearity (EMVA 1288 release 4, section 7: 5 to 95 % of
/// saturation).
const DIM: f64 = 0.05;

/// Estimates that ignore effects, from means and variances.
#[derive(Debug, Clone, Copy)]
struct Plain {
    gain_dn_per_e: f64,
    read_noise_e: f64,
    linearity: f64,
}

/// Weighted line y = a + b x: (a, b).
fn line(points: impl Iterator<Item = (f64, f64, f64)> + Clone) -> Option<(f64, f64)> {
    let sum = |of: &dyn Fn(f64, f64) -> f64| points.clone().map(|(x, y, w)| w * of(x, y)).sum::<f64>();
    let (n, sx, sy) = (sum(&|_, _| 1.0), sum(&|x, _| x), sum(&|_, y| y));
    let (xx, xy) = (sum(&|x, _| x * x), sum(&|x, y| x * y));
    let determinant = n * xx - sx * sx;
    (determinant > 1e-12 * n * xx)
        .then(|| ((xx * sy - sx * xy) / determinant, (n * xy - sx * sy) / determinant))
}

impl Plain {
    /// Built from a value for every observable.
    fn of(all: &Observations, values: impl Fn(usize) -> f64) -> Option<Self> {
        let sets = all.campaign.sets.len();
        let (mut means, mut variances) = (vec![(0.0, 0.0); sets], vec![(0.0, 0.0); sets]);
        for (i, o) in all.list.iter().enumerate() {
            let into = match () {
                () if o.is(&mean::Mean) => &mut means,
                () if o.is(&variance::Variance) => &mut variances,
                () => continue,
            };
            if let Some(set) = o.set {
                into[set] = (into[set].0 + values(i), into[set].1 + 1.0);
            }
        }
        let of = |(sum, n): (f64, f64)| sum / n;
        let level = |set: usize| of(means[set]);
        let darks: Vec<usize> =
            (0..sets).filter(|s| all.kinds[*s] == Kind::Dark && means[*s].1 > 0.0).collect();
        let exposure = |set: usize| all.campaign.sets[set].exposure_s;
        let dark = |points: &[usize]| line(points.iter().map(|&s| (exposure(s), level(s), 1.0)));
        let alone = darks.iter().map(|s| level(*s)).sum::<f64>() / darks.len().max(1) as f64;
        let (zero, per_s) = if all.is_table { (0.0, 0.0) } else { dark(&darks).unwrap_or((alone, 0.0)) };
        let top = TOP * all.campaign.full_scale_dn;
        let used: Vec<usize> = (0..sets)
            .filter(|s| variances[*s].1 > 0.0 && level(*s) < top && of(variances[*s]) > 0.0)
            .collect();
        let points = used.iter().map(|&s| {
            let var = of(variances[s]);
            (level(s) - zero, var, 1.0 / (var * var))
        });
        let (constant, gain_dn_per_e) = line(points)?;
        let read = (constant - 1.0 / 12.0).max(0.0).sqrt() / gain_dn_per_e;
        let lit: Vec<(f64, f64)> = used
            .iter()
            .filter(|s| all.kinds[**s] == Kind::Flat)
            .map(|&s| {
                let light = all.campaign.sets[s].illumination * exposure(s);
                (light, level(s) - zero - per_s * exposure(s))
            })
            .collect();
        let most = lit.iter().map(|p| p.1).fold(0.0, f64::max);
        let bright = || lit.iter().filter(|p| p.1 > DIM * most);
        let of_light = if bright().count() < 3 || all.means_given {
            None
        } else {
            line(bright().map(|&(x, y)| (x, y, 1.0 / (y * y))))
        };
        let linearity = of_light
            .map_or(0.0, |(a, b)| bright().map(|(x, y)| ((y - a - b * x) / y).abs()).fold(0.0, f64::max));
        Some(Self { gain_dn_per_e, read_noise_e: read, linearity })
    }

    /// Of a model with these effects.
    fn of_model(all: &Observations, fitted: &Fitted, effects: &Effects) -> Option<Self> {
        let list: Vec<(&dyn Effect, &[f64])> =
            effects.iter().map(|(e, p)| (*e as &dyn Effect, p.as_slice())).collect();
        let prediction = effects::predict(&all.campaign, &fitted.base, &list);
        let expected = expectations(all, &prediction, |_| true);
        Self::of(all, |i| expected[i].value)
    }

    /// Errors of this estimate, where `right` is the right one.
    fn against(&self, right: &Self) -> Cost {
        let rel = |a: f64, b: f64| if b > 0.0 && a.is_finite() { a / b - 1.0 } else { 0.0 };
        Cost {
            gain_rel: rel(self.gain_dn_per_e, right.gain_dn_per_e),
            read_noise_rel: rel(self.read_noise_e, right.read_noise_e),
            linearity_rel: (self.linearity - right.linearity).max(0.0),
        }
    }
}

/// Cost of leaving an effect of a model out of account.
pub(super) fn of_effect(all: &Observations, whole: &Fitted, id: &str) -> Cost {
    let rest: Effects = whole.effects.iter().filter(|(e, _)| e.id() != id).cloned().collect();
    let both = Plain::of_model(all, whole, &whole.effects).zip(Plain::of_model(all, whole, &rest));
    both.map_or_else(Cost::default, |(with, without)| with.against(&without))
}

/// Cost of the remainder: measured means and variances against those that the model expects.
pub(super) fn of_remainder(all: &Observations, whole: &Fitted) -> Cost {
    let both =
        Plain::of(all, |i| all.list[i].measured.value).zip(Plain::of_model(all, whole, &whole.effects));
    both.map_or_else(Cost::default, |(measured, expected)| measured.against(&expected))
}
