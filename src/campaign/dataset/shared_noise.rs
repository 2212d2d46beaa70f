//! Noise shared by neighbours or successive frames in all flats, and the gain corrected for it.

use crate::number::{Quantity, six_digits, with_unit};

/// Possible ratio of the covariances of neighbours to the variance: the variance of a sum cannot be
/// below 0, and strong smoothing, a mean of 5 x 5 pixels, gives 13 for the neighbours that are counted.
const OF_PIXELS: std::ops::RangeInclusive<f64> = -1.0..=18.0;

/// Direction of the correlation: pixels or frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Between {
    /// Neighbouring pixels.
    Neighbours,
    /// Successive frames.
    Frames,
}

/// Shared noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SharedNoise {
    pub between: Between,
    /// Covariances relative to the measured variance; below 0 after sharpening. For frames the minimum
    /// that a temporal filter causes.
    pub rel: f64,
    /// Standard error of the ratio.
    pub std_err: f64,
}

impl SharedNoise {
    /// Returns the share of the measured variance.
    pub(crate) fn quantity(&self) -> Quantity {
        Quantity::new(self.rel, self.std_err, "1")
    }

    /// Describes size and cause, and the corrected gain.
    pub(crate) fn in_words(&self, gain: f64, std_err: f64) -> String {
        let (what, at_least) = match self.between {
            Between::Frames => (
                "successive frames share noise in all flats (the camera averages over time: switch its noise reduction off): variance lacks it",
                "at least ",
            ),
            Between::Neighbours if self.rel < 0.0 => (
                "neighbouring pixels differ by more than chance makes them in all flats (the images were sharpened): variance has too much of it",
                "",
            ),
            Between::Neighbours => (
                "neighbouring pixels share noise in all flats (the images were resampled, demosaiced, smoothed or compressed, or the sensor has \
                 crosstalk): variance lacks it",
                "",
            ),
        };
        if self.between == Between::Neighbours && !OF_PIXELS.contains(&self.rel) {
            return format!(
                "frames differ by far more than the noise of single pixels (neighbours share {} times as much): bands of the lamp, light that changes \
                 from frame to frame, lost or filled-in parts. `radcam diagnose` fits what does it",
                six_digits((10.0 * self.rel).round() / 10.0)
            );
        }
        let own = gain * (1.0 + self.rel);
        format!(
            "{what}, and the system gain is {at_least}{} {}: {at_least}{}. `radcam diagnose` fits what does it",
            with_unit(100.0 * self.rel.abs(), 100.0 * self.std_err, "%"),
            if self.rel > 0.0 { "higher" } else { "lower" },
            with_unit(own, (std_err * (1.0 + self.rel)).hypot(gain * self.std_err), "DN/e")
        )
    }
}
