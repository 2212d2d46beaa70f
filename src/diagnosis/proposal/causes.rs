//! Mechanisms behind laws: which statistic, growing with what, points to which part of a camera, and which
//! measurement separates the causes.

use super::laws::Growth::{
    self, Constant, Exposure, Faster, Noise, Odd, Signal, Slower, Square, Step, Time, Wave,
};

/// Likely cause of a law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cause {
    /// Targets: the first letters of their names.
    target: &'static str,
    /// Ways of growing.
    growth: &'static [Growth],
    /// Mechanism in the camera, the lamp or the data.
    pub mechanism: &'static str,
    /// Measurement that separates it from the others.
    pub measure: &'static str,
    /// Place where it is described.
    pub source: &'static str,
}

macro_rules! causes {
    ($($target:literal $growth:expr => $mechanism:literal; $measure:literal; $source:literal)*) => {
        const CAUSES: &[Cause] = &[$(Cause {
            target: $target, growth: $growth, mechanism: $mechanism, measure: $measure, source: $source,
        }),*];
    };
}

causes! {
    "variance" &[Square] => "a gain that differs from pixel to pixel in each frame (jitter of the sampling, noise of the reference)"; "flats of one light at several exposures: the noise follows the signal alone"; "Janesick 2007"
    "variance" &[Faster, Slower] => "a response that is bent for the noise and straight for the mean (a table with its inverse)"; "a fine sweep at one light: the codes show the table"; "EMVA 1288 release 4, section 2"
    "variance" &[Exposure] => "charge that comes with time and not with the light (glow of the amplifier, a leak, unequal dark current)"; "darks at several exposures"; "Janesick 2001, ch. 7"
    "variance" &[Step] => "two amplifiers or two gains that are merged at one level"; "flats in small steps around that level"; "EMVA 1288 release 4, section 6"
    "cov_01" &[Constant] => "noise that the read-out chain passes on to the next sample (finite bandwidth, settling)"; "darks at another pixel clock"; "Janesick 2001, ch. 6"
    "cov_10" &[Constant] => "noise that rows share with the next (a reference that settles slowly, a shared column bus)"; "darks at another line time"; "Janesick 2007"
    "cov_0" &[Noise, Signal, Faster, Square, Slower] => "a filter along the row, or charge that reaches the neighbours"; "a slanted edge: a filter sharpens or blurs it"; "Moore, Ninkov and Forrest 2006, Opt. Eng. 45, 076402"
    "cov_02" &[Constant] => "two interleaved channels of the read-out"; "darks with one tap"; "Janesick 2001, ch. 6"
    "cov_2" &[Constant, Noise, Signal] => "an echo of the line before last, or fields that are read one after the other"; "a scene with a bright line: its echo stands two rows below"; "Janesick 2001, ch. 6"
    "cov_3" &[Constant, Noise, Signal] => "an echo from some rows before, or a filter over several rows"; "a scene with a bright line"; "Janesick 2001, ch. 6"
    "cov_1-1" &[Constant, Noise, Exposure] => "interference whose stripes run along a diagonal: its period is close to a whole number of pixels per row"; "darks at another line time: the slope changes"; "EMVA 1288 release 4, section 8"
    "cov_1" &[Noise, Signal, Faster, Square, Slower] => "charge shared with neighbours, or a filter over both axes"; "an edge, and flats of several levels"; "Moore, Ninkov and Forrest 2006, Opt. Eng. 45, 076402"
    "blocks" &[Constant, Noise, Signal, Faster, Square, Slower, Exposure, Step] => "pixels that share an amplifier in blocks of two by two, or binning in a part of the chain"; "darks: shared amplifiers show there"; "Janesick 2007"
    "shifted blocks" &[Constant, Noise, Signal, Faster, Square, Slower, Exposure, Step] => "pixels that share an amplifier in blocks of two by two, in a region that begins off their corner"; "darks of the full sensor"; "Janesick 2007"
    "neighbours" &[Constant, Exposure, Step] => "smoothing of the dark noise alone (a filter of noise that spares what is bright)"; "darks with all filters of the camera off"; "EMVA 1288 release 4, section 2"
    "neighbours" &[Noise, Signal, Faster, Square, Slower] => "a filter over both axes, gains that differ by tiles, or charge shared with neighbours"; "an edge, and flats of several levels"; "Moore, Ninkov and Forrest 2006, Opt. Eng. 45, 076402"
    "parity" &[Constant, Noise, Signal, Faster, Square, Slower, Exposure, Step] => "pixels that share an amplifier in pairs or in blocks of two by two, or an interpolation of every second line"; "darks: shared amplifiers show there, an interpolation at every level"; "Janesick 2007"
    "row" &[Constant] => "noise of a supply or reference that is sampled once a row"; "darks with covered columns: their mean takes it off"; "EMVA 1288 release 4, section 8"
    "row" &[Signal, Faster, Square, Slower] => "a gain or reference that differs from row to row in each frame, or light that ripples during the read-out"; "another lamp, on direct current: what stays is the camera"; "EMVA 1288 release 4, section 8"
    "column" &[Constant] => "noise of the column amplifiers' supply"; "darks at another gain"; "Janesick 2007"
    "column" &[Signal, Faster, Square, Slower] => "a column amplifier's gain that differs from frame to frame"; "flats of several levels, with darks between"; "Janesick 2007"
    "common" &[Constant] => "a black level that is clamped anew in each frame"; "darks: it is there too"; "EMVA 1288 release 4, section 6"
    "common" &[Signal, Faster, Square, Slower] => "a lamp or a shutter that scatters from frame to frame"; "a light monitor beside the camera"; "EMVA 1288 release 4, section 6"
    "common" &[Exposure] => "dark charge that scatters with the temperature"; "darks with the temperature logged"; "Janesick 2001, ch. 7"
    "mean" &[Square] => "a response that bends"; "one light and many exposures against many lights and one exposure"; "EMVA 1288 release 4, section 6"
    "mean" &[Step] => "two amplifiers or two gains that are merged at one level"; "flats in small steps around that level"; "EMVA 1288 release 4, section 6"
    "mean" &[Wave] => "a converter whose steps are unequal over the range, or a table of few nodes"; "a sweep in small steps"; "IEEE 1241-2010"
    "mean" &[Time] => "a lamp, a black level or an amplifier that drifts"; "the first set once more at the end"; "EMVA 1288 release 4, section 6"
    "mean" &[Odd] => "two frame buffers, two phases of a lamp, or two readings that alternate"; "frames one by one, at half of the frame rate"; "EMVA 1288 release 4, section 6"
}

/// Causes of a law, the likeliest first.
pub fn of(target: &str, growth: Growth) -> Vec<&'static Cause> {
    CAUSES.iter().filter(|c| target.starts_with(c.target) && c.growth.contains(&growth)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::proposal::laws;

    /// Every entry belongs to some law, and names a measurement and a source.
    #[test]
    fn every_cause_has_a_law() {
        let laws = laws::all();
        for cause in CAUSES {
            let has = laws.iter().any(|law| of(law.target.name, law.shape.growth).contains(&cause));
            assert!(has, "{} {:?}", cause.target, cause.growth);
            assert!(!cause.measure.is_empty() && !cause.source.is_empty());
        }
    }
}
