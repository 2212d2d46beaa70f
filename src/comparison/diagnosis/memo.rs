//! Cache of the fits of a search: a search that is repeated without some effects makes most of them once
//! more.

use crate::inference::{Effects, Fitted, fit_near};
use crate::observables::Observations;
use radcam_sim::predict::BaseParameters;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Maximum memory of the cached fits, bytes.
const MOST_BYTES: usize = 256 << 20;

/// Everything that a fit depends on, as bits.
pub(super) type Key = Vec<u64>;

/// Returns the bits of a model: the point of a fit also tells its slopes.
pub(super) fn key(model: &Fitted) -> Key {
    let mut key = of_base(&model.base);
    key.push(model.objective.to_bits());
    key.extend(of_effects(&model.effects));
    key
}

fn of_base(base: &BaseParameters) -> Key {
    let monitor = base.monitor.map(|m| [m.ln_per_e, m.rel]);
    let mut all = vec![
        base.gain_dn_per_e,
        base.read_noise_e,
        base.read_noise_spread,
        base.offset_dn,
        base.dark_e_per_s,
        f64::from(u8::from(base.cut_at_0)),
        base.past_e.unwrap_or(f64::NAN),
        base.setting_rel.unwrap_or(f64::NAN),
    ];
    all.extend(monitor.into_iter().flatten());
    all.extend(&base.flux_e_per_s);
    all.into_iter().map(f64::to_bits).collect()
}

/// Returns the bits of effects with their values.
pub(super) fn of_effects(effects: &Effects) -> impl Iterator<Item = u64> + '_ {
    effects.iter().flat_map(|(e, values)| {
        let id = e.id().bytes().fold(7u64, |h, b| h.wrapping_mul(1_099_511_628_211) ^ u64::from(b));
        std::iter::once(id).chain(values.iter().map(|v| v.to_bits()))
    })
}

/// Cached fits by key.
#[derive(Default)]
pub(super) struct Memo(Mutex<Kept>);

#[derive(Default)]
struct Kept {
    fits: BTreeMap<Key, Vec<Fitted>>,
    bytes: usize,
}

impl Memo {
    /// Returns the fits of a key, and makes them if they are not known.
    pub fn fits(&self, key: Key, make: impl FnOnce() -> Vec<Fitted>) -> Vec<Fitted> {
        let kept = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = kept().fits.get(&key) {
            return known.clone();
        }
        let made = make();
        let bytes: usize = made.iter().map(Fitted::bytes).sum();
        let mut kept = kept();
        if kept.bytes + bytes <= MOST_BYTES {
            kept.bytes += bytes;
            kept.fits.insert(key, made.clone());
        }
        made
    }

    /// Returns the cached fit as of [`fit_near`].
    pub fn near(&self, all: &Observations, near: &Fitted, effects: &Effects) -> Fitted {
        let mut key = key(near);
        key.extend(of_effects(effects));
        let fit = || fit_near(all, near, effects);
        self.fits(key, || vec![fit()]).pop().unwrap_or_else(fit)
    }
}
