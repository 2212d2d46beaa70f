//! Exposures of a plan in seconds, with a search for the one that brings the light close to full scale.

use super::{Capture, CaptureError};
use crate::camera::StreamCounts;
use crate::dataset::Kind;
use crate::frame::{Frame, Status};
use crate::plan::{FULL_EXPOSURE_LEVEL, Plan, SetPlan};

/// Frames discarded before a level that must follow a known one: after the search for the exposure, and when
/// a set restarts. A filter that keeps a third of the last frame has decayed to one part in 10^7.
pub(super) const SETTLING: usize = 16;

/// Returns the longest exposure of sets with light, s.
fn longest_flat(plan: &Plan, full: f64) -> f64 {
    let lit = plan.sets.iter().filter(|s| s.kind != Kind::Dark);
    lit.map(|s| s.exposure_s.unwrap_or(s.exposure.unwrap_or(1.0) * full)).fold(0.0, f64::max)
}

/// Returns the common factor that shortens long darks, so that the longest is within the camera's bounds and
/// they stay distinct. Exposures given in seconds are not changed.
fn shrink(plan: &Plan, full: f64, longest_flat: f64, max: f64) -> f64 {
    if plan.sets.iter().any(|s| s.exposure_s.is_some_and(|e| e > longest_flat)) {
        return 1.0;
    }
    let darks = plan.sets.iter().filter(|s| s.kind == Kind::Dark).filter_map(|s| s.exposure);
    let longest = darks.map(|e| e * full).fold(0.0, f64::max);
    let shrink = if longest > longest_flat && max > longest_flat { (max / longest).min(1.0) } else { 1.0 };
    if shrink < 1.0 {
        tracing::info!(
            longest_s = max,
            "the camera's longest exposure: longer darks are shortened to it in proportion"
        );
    }
    shrink
}

/// Frame number of search frames, beyond the frames of any campaign.
const PILOT_FRAME: u64 = 1 << 31;

impl Capture<'_> {
    /// Converts every exposure to seconds; measures the full exposure if the plan needs it.
    pub(super) fn absolute(&mut self, plan: &Plan, counts: &mut StreamCounts) -> Result<Plan, CaptureError> {
        let known = match plan.full_exposure_s {
            Some(full) => Some(full),
            None if plan.needs_full_exposure() => Some(self.search(plan, counts)?),
            // Every exposure is given in seconds, so no exposure counts as 1.
            None => None,
        };
        let full = known.unwrap_or(1.0);
        let bounds = self.camera.capabilities().exposure_s;
        if let Some(bounds) = bounds {
            for exposure_s in plan.sets.iter().filter_map(|s| s.exposure_s) {
                let id = &self.camera.identity().id;
                crate::camera::check_bounds(id, "ExposureTime", Some(bounds), exposure_s, "s")?;
            }
        }
        let long = longest_flat(plan, full);
        let shrink = bounds.map_or(1.0, |b| shrink(plan, full, long, b.max));
        let fitting = |e: f64| if e > long { (e * shrink).max(long) } else { e };
        let mut absolute = plan.absolute(full, |e| bounds.map_or(e, |b| b.nearest(fitting(e))));
        absolute.full_exposure_s = known;
        absolute.searched |= plan.full_exposure_s.is_none() && plan.needs_full_exposure();
        for (wanted, set) in plan.sets.iter().zip(&absolute.sets) {
            let wanted = fitting(wanted.exposure_s.unwrap_or(wanted.exposure.unwrap_or(1.0) * full));
            let got = set.exposure_s.unwrap_or(wanted);
            if (got / wanted - 1.0).abs() > 0.05 {
                tracing::warn!(
                    wanted_s = wanted,
                    taken_s = got,
                    "the camera cannot expose so; nearest taken"
                );
            }
        }
        Ok(absolute)
    }

    /// Finds the full exposure, then lets the memory of the search frames fade under the first set's light.
    pub(super) fn search(&mut self, plan: &Plan, counts: &mut StreamCounts) -> Result<f64, CaptureError> {
        let full = self.find_full_exposure(plan, counts)?;
        if let Some(first) = plan.sets.first() {
            self.expose(first, full, counts)?;
        }
        Ok(full)
    }

    /// Finds the exposure that brings the card to [`FULL_EXPOSURE_LEVEL`] of full scale, at the highest
    /// illumination of the plan's flats (1 without flats).
    fn find_full_exposure(&mut self, plan: &Plan, counts: &mut StreamCounts) -> Result<f64, CaptureError> {
        let reference = plan.sets.iter().filter(|s| s.kind == Kind::Flat);
        let light = reference.map(|s| s.illumination).fold(0.0, f64::max);
        let light = if light > 0.0 { light } else { 1.0 };
        let state = SetPlan {
            kind: Kind::Flat,
            frames: 2,
            exposure_s: None,
            exposure: None,
            illumination: light,
            configuration: 0,
        };
        self.bench.apply(&state.bench(), self.camera)?;
        let Some(bounds) = self.camera.capabilities().exposure_s else {
            return Err(self.camera.not_available("ExposureTime").into());
        };
        let settings = self.camera.settings()?;
        let full_scale = f64::from(settings.pixel_format.full_scale_dn());
        let target = FULL_EXPOSURE_LEVEL * full_scale;
        // Level without light, from the shortest exposure.
        let black = self.pilot(bounds.min, counts)?.0;
        let mut exposure = settings.exposure_s.clamp(bounds.min, bounds.max);
        let mut fastest = 0.0;
        for _ in 0..12 {
            let (mean, clipped) = self.pilot(exposure, counts)?;
            let rate = (mean - black) / exposure;
            if clipped <= 0.01 && mean < target && rate < 0.85 * fastest {
                tracing::warn!(
                    mean_dn = mean,
                    full_scale_dn = full_scale,
                    "the signal stops below full scale: the well is full; exposures end there"
                );
                // The fill rate of the well is measured at a third of the exposure that fills it.
                let third = bounds.nearest(0.3 * (mean - black) / fastest);
                let (level, _) = self.pilot(third, counts)?;
                let fastest = f64::max(fastest, (level - black) / third);
                return Ok(bounds.nearest(1.05 * (mean - black) / fastest));
            }
            // Only levels well above black count: below them offsets and zero determine the rate.
            if mean - black > 0.02 * full_scale && clipped <= 0.01 {
                fastest = f64::max(fastest, rate);
            }
            tracing::debug!(exposure_s = exposure, mean_dn = mean, clipped, "looking for the full exposure");
            let next = if clipped > 0.01 {
                exposure / 4.0
            } else {
                // At most a factor of 8 per step: near black the estimate is coarse.
                exposure * ((target - black) / (mean - black).max(1e-3 * full_scale)).clamp(0.1, 8.0)
            };
            let next = bounds.nearest(next);
            if (next / exposure - 1.0).abs() < 0.01 {
                return Ok(next);
            }
            exposure = next;
        }
        tracing::warn!(
            exposure_s = exposure,
            "the light does not reach the wanted level; taking this exposure"
        );
        Ok(exposure)
    }

    /// Exposes frames under a set's light and discards them, until the previous level has faded. Otherwise
    /// lag and filters carry it into the first frames.
    pub(super) fn expose(
        &mut self,
        set: &SetPlan,
        exposure_s: f64,
        counts: &mut StreamCounts,
    ) -> Result<(), CaptureError> {
        self.bench.apply(&set.bench(), self.camera)?;
        for _ in 0..SETTLING / 2 {
            self.pilot(exposure_s, counts)?;
        }
        tracing::info!(exposure_s, "frames without a place in the plan let what was before fade");
        Ok(())
    }

    /// Returns the mean and the share of clipped pixels of a frame at an exposure. The first frame is
    /// discarded.
    fn pilot(&mut self, exposure_s: f64, counts: &mut StreamCounts) -> Result<(f64, f64), CaptureError> {
        self.camera.set_exposure_s(exposure_s)?;
        let full_scale = self.camera.settings()?.pixel_format.full_scale_dn();
        let timeout = crate::camera::patience(exposure_s);
        // A simulated camera then finds the same exposure each time. Its clock is set again before each set.
        self.camera.draw_from(PILOT_FRAME, 1.0);
        let mut stream = self.camera.stream(&self.options)?;
        let mut frame = Frame::new(0, 0);
        let mut good = 0;
        for _ in 0..8 {
            stream.next(&mut frame, timeout)?;
            good += u32::from(frame.status == Status::Complete);
            if good == 2 {
                break;
            }
        }
        counts.add(stream.counts());
        let n = frame.pixels.len().max(1) as f64;
        let sum: u64 = frame.pixels.iter().map(|&d| u64::from(d)).sum();
        let clipped = frame.pixels.iter().filter(|&&d| d >= full_scale).count();
        Ok((sum as f64 / n, clipped as f64 / n))
    }
}
