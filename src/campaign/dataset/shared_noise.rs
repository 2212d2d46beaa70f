//! Noise that neighbours or successive frames share in all flats, and the gain without it.

use crate::number::{Quantity, six_digits, with_unit};

/// Covariances of neighbours over the variance that the noise of single pixels can have: the noise of a sum is no
/// variance below 0, and a strong smoothing, a mean of 5 x 5
/// pixels, has 13 among the neighbours that are counted.
const OF_PIXELS: std::ops::RangeInclusive<f64> = -1.0..=18.0;

/// Pixels or frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Between {
    /// Neighbouring pixels.
    Neighbours,
    /// Successive frames.
    Frames,
}

/// Noise that is shared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SharedNoise {
    pub between: Between,
    /// Its covariances over the variance that is measured; below 0 after sharpening. Of frames the least that
    /// a filter over time makes.
    pub rel: f64,
    /// Its standard error.
    pub std_err: f64,
}

impl SharedNoise {
    /// Its share of the variance that is measured.
    pub(crate) fn quantity(&self) -> Quantity {
        Quantity::new(self.rel, self.std_err, "1")
    }

    /// Size and cause, and the gain without it, in words.
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
