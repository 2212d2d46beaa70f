//! Examination of the data before any physics: faults in recording are named with their sets and
//! excluded.
//!
//! Every command that reads a campaign uses [`examined`]: excluded data are excluded everywhere, and
//! reported everywhere in the same words.
//!
//! # To add a check
//!
//! Write one file here with a type that implements `Check`, and add both names to the list at the end of
//! this file. Checks run in that order, and each sees the campaign without the data excluded by earlier
//! ones.
//!
//! No check knows a sensor model. Sets are compared with the others of their campaign: levels with a
//! smooth law of exposure times light, variances with a smooth law of the level. An effect on all sets
//! alike bends those laws and is left to `diagnose`; a fault is a deviation of one set or a few.

mod campaign;
mod facts;
mod hot_charge;
mod law;
mod orientation;
mod overlay;
mod patterns;
mod set_view;
mod shared_noise;
mod stray_level;
mod transfer;

pub(crate) use crate::dataset::SharedNoise;
pub use crate::dataset::{DataFault, FaultKind};
use campaign::Campaign;
pub(crate) use facts::SetFacts;
pub(crate) use overlay::part_that_jumps;

use crate::dataset::{Dataset, DatasetError, Examination, Key, Kind, StruckSamples};
use crate::statistics::outliers::are_rays;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Check for one kind of fault.
trait Check: Sync {
    /// Finds faults, and marks the sets and frames excluded by it in the campaign.
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault>;
}

/// Errors of an examination.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExamineError {
    /// Error of the dataset.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Interrupted by the user.
    #[error("interrupted")]
    Interrupted,
}

/// Returns the dataset without the faulty data; [`Dataset::data_faults`] then lists the faults. An
/// examined dataset is returned unchanged.
///
/// ```
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("campaign");
/// # let mut camera = radcam::camera::open("sim:cmos12")?;
/// # let mut plan = radcam::plan::Plan::quick();
/// # plan.camera.region = Some([0, 0, 64, 64]);
/// # let mut bench = radcam::bench::of(&mut *camera, &plan);
/// # radcam::capture::Capture::new(&mut *camera, &mut *bench).run(&plan, &path)?;
/// use radcam::{data_faults, dataset::Dataset};
/// let stop = std::sync::atomic::AtomicBool::new(false);
/// let dataset = data_faults::examined(&Dataset::open(&path)?, &stop)?;
/// assert!(dataset.data_faults().is_empty()); // nothing was wrong
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
///
/// A frame cannot be read, or the user interrupted.
pub fn examined(dataset: &Dataset, stop: &AtomicBool) -> Result<Dataset, ExamineError> {
    if dataset.is_examined() {
        return Ok(dataset.clone());
    }
    let mut facts = facts_of(dataset, stop)?;
    let mut faults = Vec::new();
    let part = overlay::without_part_that_jumps(dataset, &facts).map(|(part, fault, is_text)| {
        faults.push(fault);
        (part, is_text)
    });
    if let Some((part, _)) = &part {
        facts = facts_of(part, stop)?;
    }
    let is_without_text = part.as_ref().is_some_and(|(_, is_text)| *is_text);
    let dataset = part.as_ref().map_or(dataset, |(part, _)| part);
    let struck = StruckSamples::of(&facts);
    let mut campaign = Campaign::new(dataset, facts);
    for check in CHECKS {
        faults.extend(check.find(&mut campaign));
    }
    let passed_over = campaign.passed_over(&faults);
    let shared_noise = shared_noise::shared_noise(&campaign);
    let examination = Examination {
        code_step_dn: campaign.code_step_dn,
        struck,
        carried_share: campaign.carried_share,
        shared_noise,
        flats_are_dark_subtracted: campaign.flats_are_dark_subtracted,
        is_without_text,
    };
    Ok(dataset.without(&campaign.rows_left_out(), passed_over, faults, examination))
}

impl StruckSamples {
    /// Counts outlier samples over all sets. Samples that repeat in the same pixels are noisy pixels,
    /// not cosmic rays.
    fn of(facts: &[SetFacts]) -> Self {
        let pixels: Vec<usize> =
            facts.iter().flat_map(|f| f.struck_pixels.iter().map(|pixel| *pixel as usize)).collect();
        let samples = facts.iter().map(|f| f.pixels * f.means_dn.len() as f64).sum();
        let frame = facts.iter().map(|f| f.pixels).fold(0.0, f64::max);
        let are_rays = are_rays(&pixels, samples, frame);
        Self { number: if are_rays { pixels.len() as u64 } else { 0 }, are_rays }
    }
}

/// Computes the statistics of every set, or takes them from a file of statistics.
pub(crate) fn facts_of(dataset: &Dataset, stop: &AtomicBool) -> Result<Vec<SetFacts>, ExamineError> {
    // Memory is bounded by actual data: a frame must confirm the size claimed by a header.
    if let Some(row) = dataset.rows().first().filter(|_| dataset.reduced().is_none()) {
        dataset.read(row)?;
    }
    let of_set = |set: &crate::dataset::Set| {
        if stop.load(Ordering::Relaxed) {
            return Err(ExamineError::Interrupted);
        }
        let kept = dataset.reduced().and_then(|r| r.get::<SetFacts>(&Key::first(dataset, set, usize::MAX)));
        if let Some(known) = kept {
            return Ok(known.clone());
        }
        match dataset.settings(set).kind {
            Kind::Dark | Kind::Flat => facts::of_set(dataset, set, stop),
            Kind::Scene | Kind::Target => Ok(SetFacts::default()),
        }
    };
    dataset.sets().par_iter().map(of_set).collect()
}

macro_rules! checks {
    ($($module:ident::$name:ident)*) => {
        $(mod $module;)*
        /// All checks in execution order.
        static CHECKS: &[&dyn Check] = &[$(&$module::$name),*];
    };
}

checks! {
    stretched_contrast::StretchedContrast
    lost_parts::LostParts
    lit_dark_frame::LitDarkFrame
    dim_firsts::DimFirsts
    stale_frame::StaleFrame
    copied_frames::CopiedFrames
    mean_among_frames::MeanAmongFrames
    old_data::OldDataInFrames
    odd_frame::OddFrame
    frames_of_two_levels::FramesOfTwoLevels
    moving_field::MovingField
    fewer_bits::FewerBits
    rounded_means::RoundedMeans
    gain_step::GainStep
    repeats_of_two_gains::RepeatsOfTwoGains
    kind_label::KindLabel
    light_in_darks::LightInDarks
    unequal_light::UnequalLight
    other_orientation::OtherOrientation
    other_pattern::OtherPattern
    subtracted_darks::SubtractedDarks
    stray_dark_charge::StrayDarkCharge
    dark_labels::DarkLabels
    dark_settings::DarkSettings
    darks_of_flats::DarksOfFlats
    averages_of_one_kind::AveragesOfOneKind
    averages_among_sets::AveragesAmongSets
    other_field::OtherField
    automatic::Automatic
    exposure_limit::ExposureLimit
    setting_label::SettingLabel
    equal_darks::EqualDarks
    dependent_frames::DependentFrames
    shading_corrected::ShadingCorrected
}
