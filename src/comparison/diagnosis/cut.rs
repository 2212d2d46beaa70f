//! Noise that the range of the codes cuts off: black-clipping at code 0, for which counts are the evidence.

use super::Part;
use crate::dataset::Kind;
use crate::inference::{Fitted, fit};
use crate::number::percent;
use crate::observables::{Observations, mean};
use radcam_sim::effects::find;
use radcam_sim::predict::{BaseParameters, SetInfo};
use std::collections::BTreeSet;

/// Minimum share of a dark's samples below code 0 for a black level that is too low (a named choice: cut off
/// at 2.9 deviations, the noise's variance loses half a per cent).
const CUT_OFF: f64 = 0.002;

/// Identifier of the effect that cuts noise off below a code.
pub(super) const CUT: &str = "black-clipping";
/// Its parameters for code 0.
const AT_CODE_0: [f64; 2] = [0.0, 1.0];

/// Adds the cut-off of noise below code 0 to a model, and fits it.
pub(super) fn with_cut(all: &Observations, model: &Fitted) -> Fitted {
    let mut effects = model.effects.clone();
    effects.extend(find(CUT).map(|e| (e, AT_CODE_0.to_vec())));
    fit(all, &model.base, &effects)
}

/// A camera whose black level is too low: the noise of its darks reaches below code 0.
pub(super) struct CutOff {
    /// The model with noise below code 0 that is not cut off.
    pub model: Fitted,
    /// Largest share of a dark's samples below code 0.
    share: f64,
    /// Twice the logarithm of the likelihood ratio: the model expects samples below code 0, and there are
    /// none (Poisson).
    evidence: f64,
}

impl std::fmt::Display for CutOff {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let share = percent(self.share);
        write!(
            f,
            "by the noise of the darks {share} of their samples would lie below code 0, where none can be"
        )
    }
}

impl CutOff {
    /// Returns the cut-off of a campaign under a model; none for a camera that states that it has no black
    /// level, and cuts by design.
    pub fn of(all: &Observations, model: &Fitted) -> Option<Self> {
        let has_it = model.effects.iter().any(|(e, _)| e.id() == CUT);
        if !all.campaign.from_code_0 || all.no_black_level || has_it || !model.base.cut_at_0 {
            return None;
        }
        let base = &model.base;
        let below = |set: &SetInfo| {
            let noise_dn = base.read_noise_e * base.gain_dn_per_e;
            let level_dn = base.offset_dn + base.gain_dn_per_e * base.dark_e_per_s * set.exposure_s;
            let deviation = noise_dn.hypot(set.spread_dn).max(1e-6);
            0.5 * libm::erfc((level_dn + 0.5) / deviation * std::f64::consts::FRAC_1_SQRT_2)
        };
        let shares: Vec<f64> = all.campaign.sets.iter().map(below).collect();
        // Darks that were left out stay in the campaign as exposed frames, but were not counted.
        let counted: BTreeSet<usize> = all.of(&mean::Mean).filter_map(|o| o.set).collect();
        let is_dark = |set: &usize| all.kinds[*set] == Kind::Dark && counted.contains(set);
        let share = (0..shares.len()).filter(is_dark).map(|set| shares[set]).fold(0.0, f64::max);
        if share < CUT_OFF {
            return None;
        }
        tracing::debug!("{share:.4} of a dark's samples fall below code 0");
        let pixels = (all.campaign.shape.0 * all.campaign.shape.1) as f64;
        let darks = all.campaign.frames.iter().filter(|frame| is_dark(&frame.set));
        let evidence = 2.0 * darks.map(|frame| shares[frame.set] * pixels).sum::<f64>();
        let open = BaseParameters { cut_at_0: false, ..base.clone() };
        Some(Self { model: fit(all, &open, &model.effects), share, evidence })
    }

    /// Adds the evidence of the counts to the part that cuts.
    pub fn weigh(&self, parts: &mut [Part]) {
        if let Some(part) = parts.iter_mut().find(|p| p.effect.id() == CUT) {
            part.evidence = part.evidence.max(0.0) + self.evidence;
        }
    }
}
