//! Findings of the look at the data, and the dataset without the rows that are left out.

use super::{DataFault, Dataset, Set, SharedNoise};
use crate::statistics::outliers;
use ndarray::Array2;
use std::collections::HashSet;
use std::sync::Arc;

/// Set that is left out, and was exposed nonetheless: what follows it may carry its charge.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PassedOver {
    /// Number of the set.
    pub set: u32,
    /// Mean of its last frame, DN.
    pub last_dn: f64,
    /// True if its charge is that of stated exposure and light, and its level is not, as under another gain.
    pub as_stated: bool,
}

/// Findings of the examination beside the faults.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Examination {
    /// Step of the converter as the codes show it, DN; 1 before.
    pub code_step_dn: f64,
    /// Single samples that stand far off.
    pub struck: StruckSamples,
    /// Share of a change of level that first frames carry from the set before; 0 where none is seen.
    pub carried_share: f64,
    /// Noise that neighbours or successive frames share.
    pub shared_noise: Option<SharedNoise>,
    /// True if the flats are dark-subtracted: the black level of the manifest is not theirs.
    pub flats_are_dark_subtracted: bool,
}

/// Values before the examination.
pub(super) const UNEXAMINED: Examination = Examination {
    code_step_dn: 1.0,
    struck: StruckSamples { number: 0, are_rays: true },
    carried_share: 0.0,
    shared_noise: None,
    flats_are_dark_subtracted: false,
};

/// Single samples that stand far off the same pixel in other frames.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StruckSamples {
    /// Their number; 0 before the examination.
    pub number: u64,
    /// False where they lie in the same pixels again and again, and belong to the sensor.
    pub are_rays: bool,
}

impl Dataset {
    /// Faults that [`examined`](crate::data_faults::examined) found; empty before it ran.
    pub fn data_faults(&self) -> &[DataFault] {
        self.faults.as_deref().unwrap_or_default()
    }

    /// Distance of the codes of the converter, DN, as [`examined`](crate::data_faults::examined) found it from
    /// the codes that occur: 16 of 12 bits in the upper bits of 16; 1 before it ran, and of codes that are the
    /// converter's.
    pub fn code_step_dn(&self) -> f64 {
        self.examination.code_step_dn
    }

    /// Number of single samples that stand far off the same pixel in other frames (cosmic rays, bit errors); 0
    /// before [`examined`](crate::data_faults::examined) ran.
    pub fn struck(&self) -> u64 {
        self.examination.struck.number
    }

    /// Share of a change of level that first frames carry from the set before, by image lag or a filter over
    /// time, as [`examined`](crate::data_faults::examined) found it; 0 before it ran, and where none is seen.
    pub fn carried_share(&self) -> f64 {
        self.examination.carried_share
    }

    /// Black level of the manifest, DN; `None` for dark-subtracted flats.
    pub fn black_level_dn(&self) -> Option<f64> {
        self.manifest().camera.black_level_dn.filter(|_| !self.examination.flats_are_dark_subtracted)
    }

    /// Noise that neighbours or successive frames share in all flats.
    pub(crate) fn shared_noise(&self) -> Option<SharedNoise> {
        self.examination.shared_noise
    }

    /// False where the samples that stand far off lie in the same pixels again and again: noisy pixels.
    pub(crate) fn struck_are_rays(&self) -> bool {
        self.examination.struck.are_rays
    }

    /// Frames without single samples that stand far off the same pixel in the others, where these are rays,
    /// and how many they are.
    pub(crate) fn without_struck(&self, block: Vec<Arc<Array2<u16>>>) -> (Vec<Arc<Array2<u16>>>, usize) {
        if !self.examination.struck.are_rays {
            return (block, 0);
        }
        let (block, pixels) = outliers::without_struck(&block);
        (block, pixels.len())
    }

    /// Variance of quantisation, DN^2: q^2 / 12 (eq. 27 of Healey and Kondepudy).
    pub fn quantisation_dn2(&self) -> f64 {
        self.examination.code_step_dn.powi(2) / 12.0
    }

    /// Returns true after [`examined`](crate::data_faults::examined).
    pub fn is_examined(&self) -> bool {
        self.faults.is_some()
    }

    /// Removes rows because of these faults. Some of the sets were exposed nonetheless.
    pub(crate) fn without(
        &self,
        out: &[bool],
        passed_over: Vec<PassedOver>,
        faults: Vec<DataFault>,
        examination: Examination,
    ) -> Self {
        let mut kept = self.only(|row| !out[row]);
        (kept.faults, kept.examination) = (Some(faults.into()), examination);
        if !passed_over.is_empty() {
            let is_passed_over = |set: &&Set| passed_over.iter().any(|p| p.set == set.number);
            let rows: HashSet<usize> =
                self.sets.iter().filter(is_passed_over).flat_map(|s| s.rows.iter().copied()).collect();
            let mut all = self.only(|row| !out[row] || rows.contains(&row));
            (all.faults, all.examination) = (kept.faults.clone(), examination);
            kept.passed_over = Some(Arc::new((all, passed_over)));
        }
        kept
    }

    /// The campaign with the sets that were left out and exposed nonetheless, and these.
    pub(crate) fn timeline(&self) -> (Self, Vec<PassedOver>) {
        match &self.passed_over {
            Some(all) => (**all).clone(),
            None => (self.clone(), Vec::new()),
        }
    }
}
