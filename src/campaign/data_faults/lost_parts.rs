//! Frames with lost parts: a long run of samples that are exactly 0, while the rest of the frame and the
//! other frames have a black level. Links without resends lose such parts (GigE Vision packets).

use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use serde::{Deserialize, Serialize};

/// Minimum number of consecutive samples, in read-out order (a named choice: a tenth of the smallest
/// packet).
const MIN_RUN: usize = 64;
/// Maximum fraction of frames with lost parts: more are a property of the sensor: rows without pixels,
/// darks clipped at zero.
const MAX_SHARE: f64 = 0.5;
/// Maximum fraction of zeros among the other samples: more are darks clipped at zero.
const MAX_ZEROS: f64 = 0.01;
/// Maximum lost fraction of a frame, and minimum mean of the rest, DN: in darks clipped at zero nearly
/// all samples are in such runs, and the others have little signal (named choices).
const MAX_LOST: f64 = 0.5;
const MIN_REST_DN: f64 = 4.0;

/// Samples of a frame that are exactly 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Zeros {
    /// Samples in long runs.
    in_runs: u32,
    /// Samples elsewhere.
    single: u32,
}

impl Zeros {
    /// Returns the number of samples outside long runs.
    pub fn single(&self) -> f64 {
        f64::from(self.single)
    }

    /// Counts them in read-out order.
    pub fn of(codes: &[u16]) -> Self {
        let mut out = Self::default();
        for run in codes.chunk_by(|a, b| (*a == 0) == (*b == 0)).filter(|run| run[0] == 0) {
            let count = if run.len() < MIN_RUN { &mut out.single } else { &mut out.in_runs };
            *count += run.len() as u32;
        }
        out
    }

    /// Returns true for frames without long runs of zeros.
    pub fn are_single(&self) -> bool {
        self.in_runs == 0
    }
}

/// Check for lost parts.
pub struct LostParts;

impl Check for LostParts {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let sets = campaign.places(|s| matches!(s.kind, Kind::Dark | Kind::Flat));
        let (mut lost, mut all) = (Vec::new(), 0usize);
        let mut most = 0;
        for set in sets {
            let view = &campaign.sets[set];
            for (place, zeros) in view.facts.zeros.iter().enumerate().filter(|(p, _)| view.kept[*p]) {
                all += 1;
                let (pixels, in_runs) = (view.facts.pixels, f64::from(zeros.in_runs));
                let rest_dn = view.facts.means_dn[place] * pixels / (pixels - in_runs).max(1.0);
                let is_part = in_runs < MAX_LOST * pixels && rest_dn > MIN_REST_DN;
                if !zeros.are_single() && f64::from(zeros.single) < MAX_ZEROS * pixels && is_part {
                    lost.push((set, place));
                    most = most.max(zeros.in_runs);
                }
            }
        }
        if lost.is_empty() || lost.len() as f64 > MAX_SHARE * all as f64 {
            return Vec::new();
        }
        let (set, place) = lost[0];
        let text = format!(
            "{} of {all} frames have up to {most} samples that are exactly 0, in long runs (frame {place} of set {}, {}, is the first): parts of them were lost on the way from the camera (packets: larger ones, or fewer frames per second, end it)",
            six_digits(lost.len() as f64),
            campaign.sets[set].number,
            campaign.file(set, place)
        );
        vec![campaign.fault_of_frames(FaultKind::OddFrame, &lost, text)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_told_from_single_zeros() {
        let mut codes = vec![60u16; 1000];
        codes[100..100 + MIN_RUN].fill(0);
        codes[500..500 + MIN_RUN - 1].fill(0);
        codes[999] = 0;
        assert_eq!(Zeros::of(&codes), Zeros { in_runs: MIN_RUN as u32, single: MIN_RUN as u32 });
        assert_eq!(Zeros::of(&[]), Zeros::default());
    }
}
