//! Findings of the examination of the data, and the dataset without the excluded rows.

use super::{DataFault, Dataset, Set, SharedNoise};
use crate::statistics::outliers;
use ndarray::Array2;
use std::collections::HashSet;
use std::sync::Arc;

/// Excluded set that was still exposed: its charge may carry over to the next set.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PassedOver {
    /// Number of the set.
    pub set: u32,
    /// Mean of its last frame, DN.
    pub last_dn: f64,
    /// True if its charge matches the stated exposure and light but its level does not, as under another
    /// gain.
    pub as_stated: bool,
}

/// Findings of the examination other than faults.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Examination {
    /// Code step of the converter, DN; 1 before the examination.
    pub code_step_dn: f64,
    /// Outlier samples.
    pub struck: StruckSamples,
    /// Fraction of a level change carried over from the previous set into first frames; 0 if none is
    /// seen.
    pub carried_share: f64,
    /// Noise shared by neighbours or successive frames.
    pub shared_noise: Option<SharedNoise>,
    /// True if the flats are dark-subtracted: the black level of the manifest does not apply to them.
    pub flats_are_dark_subtracted: bool,
    /// True if rows with text are excluded.
    pub is_without_text: bool,
}

/// Values before the examination.
pub(super) const UNEXAMINED: Examination = Examination {
    code_step_dn: 1.0,
    struck: StruckSamples { number: 0, are_rays: true },
    carried_share: 0.0,
    shared_noise: None,
    flats_are_dark_subtracted: false,
    is_without_text: false,
};

/// Single samples that are far from the same pixel in other frames.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StruckSamples {
    /// Number of outliers; 0 before the examination.
    pub number: u64,
    /// False if the outliers repeat in the same pixels and so belong to the sensor.
    pub are_rays: bool,
}

impl Dataset {
    /// Returns the faults found by [`examined`](crate::data_faults::examined); empty before it ran.
    pub fn data_faults(&self) -> &[DataFault] {
        self.faults.as_deref().unwrap_or_default()
    }

    /// Returns the code step of the converter, DN, found by [`examined`](crate::data_faults::examined)
    /// from the codes that occur: 16 for 12 bits stored in the upper bits of 16; 1 before it ran, and if
    /// the codes are unscaled.
    pub fn code_step_dn(&self) -> f64 {
        self.examination.code_step_dn
    }

    /// Returns the number of single samples far from the same pixel in other frames (cosmic rays, bit
    /// errors); 0 before [`examined`](crate::data_faults::examined) ran.
    pub fn struck(&self) -> u64 {
        self.examination.struck.number
    }

    /// Returns the fraction of a level change carried over from the previous set into first frames, by
    /// image lag or a temporal filter, found by [`examined`](crate::data_faults::examined); 0 before it
    /// ran and if none is seen.
    pub fn carried_share(&self) -> f64 {
        self.examination.carried_share
    }

    /// Returns the black level of the manifest, DN; `None` for dark-subtracted flats.
    pub fn black_level_dn(&self) -> Option<f64> {
        self.manifest().camera.black_level_dn.filter(|_| !self.examination.flats_are_dark_subtracted)
    }

    /// Returns the noise shared by neighbours or successive frames in all flats.
    pub(crate) fn shared_noise(&self) -> Option<SharedNoise> {
        self.examination.shared_noise
    }

    /// Returns false if the outlier samples repeat in the same pixels: noisy pixels.
    pub(crate) fn struck_are_rays(&self) -> bool {
        self.examination.struck.are_rays
    }

    /// Returns the frames with outlier samples removed if these are cosmic rays, and the number removed.
    pub(crate) fn without_struck(&self, block: Vec<Arc<Array2<u16>>>) -> (Vec<Arc<Array2<u16>>>, usize) {
        if !self.examination.struck.are_rays {
            return (block, 0);
        }
        let (block, pixels) = outliers::without_struck(&block);
        (block, pixels.len())
    }

    /// Returns the quantisation variance, DN^2: q^2 / 12 (eq. 27 of Healey and Kondepudy).
    pub fn quantisation_dn2(&self) -> f64 {
        self.examination.code_step_dn.powi(2) / 12.0
    }

    /// Returns true if rows with text, such as a time stamp, are excluded.
    pub(crate) fn is_without_text(&self) -> bool {
        self.examination.is_without_text
    }

    /// Returns true after [`examined`](crate::data_faults::examined).
    pub fn is_examined(&self) -> bool {
        self.faults.is_some()
    }

    /// Removes rows with these faults. Some of the removed sets were still exposed.
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

    /// Returns the campaign including the excluded sets that were still exposed, and the list of these.
    pub(crate) fn timeline(&self) -> (Self, Vec<PassedOver>) {
        match &self.passed_over {
            Some(all) => (**all).clone(),
            None => (self.clone(), Vec::new()),
        }
    }
}
