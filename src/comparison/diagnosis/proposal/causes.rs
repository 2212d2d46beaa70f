//! Mechanisms behind laws: a statistic and its growth point to a part of the camera, and to the measurement
//! that separates the causes.

use super::laws::Growth::{
    self, Constant, Exposure, Faster, Noise, Odd, Signal, Slower, Square, Step, Time, Wave,
};

/// Likely cause of a law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cause {
    /// Names of its targets.
    targets: &'static [&'static str],
    /// Ways of growing.
    growth: &'static [Growth],
    /// Mechanism in the camera, the lamp or the data.
    pub mechanism: &'static str,
    /// Measurement that separates it from the others.
    pub measure: &'static str,
    /// Publication that describes the mechanism or its measurement.
    pub source: &'static str,
}

macro_rules! causes {
    ($([$($target:literal)*] $growth:expr => $mechanism:literal; $measure:literal; $source:literal)*) => {
        const CAUSES: &[Cause] = &[$(Cause {
            targets: &[$($target),*], growth: $growth, mechanism: $mechanism, measure: $measure, source: $source,
        }),*];
    };
}

causes! {
    ["variance"] &[Square] => "a gain that differs from sample to sample (jitter of the sampling, noise of the reference)"; "flats of one light at several exposures: the noise follows the signal alone"; "Janesick 2007"
    ["variance"] &[Square] => "light that is uneven in another way in each frame (speckle, a textured card that moves)"; "the same with an integrating sphere and an incoherent lamp"; "Janesick 2007"
    ["variance"] &[Faster, Slower] => "noise whose origin is not known; a response that is bent before its noise was added has such a noise too"; "flats in small steps at one light"; "Janesick 2007"
    ["variance"] &[Exposure] => "charge that comes with time and not with the light (glow of the amplifier, a leak)"; "darks at several exposures"; "Janesick 2001, ch. 7"
    ["variance"] &[Step] => "two amplifiers or two gains that are merged at one level"; "flats in small steps around that level"; "Janesick 2007"
    ["cov_01"] &[Constant, Exposure, Step] => "noise that the read-out passes on to the next sample (finite bandwidth, settling)"; "darks at another pixel clock"; "Janesick 2001, ch. 6"
    ["cov_01"] &[Faster, Noise, Signal, Slower, Square] => "a filter along the row, or a read-out that has not settled"; "a slanted edge along the rows: a filter sharpens or blurs it"; "Janesick 2001, ch. 6"
    ["cov_10"] &[Constant, Exposure, Step] => "noise that rows share with the next (a reference that settles slowly)"; "darks at another line time"; "Janesick 2007"
    ["cov_10"] &[Faster, Noise, Signal, Slower, Square] => "a filter along the column, or charge that is left behind in the transfer"; "a slanted edge along the columns"; "Janesick 2001, ch. 6"
    ["cov_02"] &[Constant, Exposure, Faster, Noise, Signal, Slower, Square, Step] => "two interleaved channels of the read-out, or an echo two samples later"; "darks with one tap"; "Janesick 2001, ch. 6"
    ["cov_03"] &[Constant, Exposure, Faster, Noise, Signal, Slower, Square, Step] => "an echo three samples later, or interleaved channels"; "darks with one tap"; "Janesick 2001, ch. 6"
    ["cov_20"] &[Constant, Exposure, Faster, Noise, Signal, Slower, Square, Step] => "an echo of the line before last, or fields that are read one after the other"; "a scene with a bright line: its echo stands two rows below"; "Janesick 2001, ch. 6"
    ["cov_30"] &[Constant, Exposure, Faster, Noise, Signal, Slower, Square, Step] => "an echo from three rows before"; "a scene with a bright line: its echo stands three rows below"; "Janesick 2001, ch. 6"
    ["cov_11"] &[Constant, Exposure, Step] => "a filter of noise over both axes in darks"; "darks with all filters of the camera off"; "EMVA 1288 release 4, section 2 (raw data are required)"
    ["cov_11"] &[Faster, Noise, Signal, Slower, Square] => "charge shared with diagonal neighbours, or a filter over both axes"; "an edge, and flats of several levels"; "Moore, Ninkov and Forrest 2006, Opt. Eng. 45, 076402"
    ["cov_1-1" "diagonal down"] &[Constant, Exposure, Faster, Noise, Signal, Slower, Square, Step] => "stripes that run along a diagonal: interference whose period is near a whole number of pixels a row"; "darks at another line time: the slope changes"; "EMVA 1288 release 4, section 8"
    ["cov_12" "cov_21"] &[Constant, Exposure, Faster, Noise, Signal, Slower, Square, Step] => "a filter that reaches two pixels far, or stripes at a slant"; "darks with all filters of the camera off"; "EMVA 1288 release 4, section 2 (raw data are required)"
    ["parity_01" "parity_10"] &[Constant, Exposure, Faster, Noise, Signal, Slower, Square, Step] => "lines that share an amplifier in pairs, or an interpolation of every second line"; "darks: shared amplifiers show there"; "Janesick 2007"
    ["even pairs of columns" "odd pairs of columns"] &[Constant, Exposure, Faster, Noise, Signal, Slower, Square, Step] => "columns that share an amplifier in pairs"; "darks: it is there too"; "Janesick 2007"
    ["even pairs of rows" "odd pairs of rows"] &[Constant, Exposure, Faster, Noise, Signal, Slower, Square, Step] => "rows that share an amplifier in pairs, or are read together"; "darks: it is there too"; "Janesick 2007"
    ["blocks" "shifted blocks"] &[Constant, Exposure, Faster, Noise, Signal, Slower, Square, Step] => "pixels that share an amplifier in blocks of two by two, or binning in a part of the chain"; "darks: it is there too"; "Janesick 2007"
    ["neighbours"] &[Constant, Exposure, Step] => "a filter of noise over both axes in darks"; "darks with all filters of the camera off"; "EMVA 1288 release 4, section 2 (raw data are required)"
    ["neighbours"] &[Faster, Noise, Signal, Slower, Square] => "a filter over both axes, gains that differ by tiles, or charge shared with neighbours"; "an edge, and flats of several levels"; "Moore, Ninkov and Forrest 2006, Opt. Eng. 45, 076402"
    ["row"] &[Constant, Exposure, Step] => "noise of a supply or reference that is sampled once a row"; "darks with covered columns: their mean takes it off"; "EMVA 1288 release 4, section 8"
    ["row"] &[Faster, Signal, Slower, Square] => "a gain or reference that differs from row to row in each frame, or light that ripples during the read-out"; "another lamp, on direct current: what stays is the camera"; "EMVA 1288 release 4, section 8"
    ["column"] &[Constant, Exposure, Step] => "noise of the column amplifiers' supply"; "darks at another gain and exposure"; "EMVA 1288 release 4, section 8"
    ["column"] &[Faster, Signal, Slower, Square] => "a column amplifier's gain that differs from frame to frame"; "flats of several levels, with darks between"; "EMVA 1288 release 4, section 8"
    ["common"] &[Constant, Step] => "a black level that is clamped anew in each frame"; "darks: it is there too"; "Janesick 2007"
    ["common"] &[Exposure] => "dark charge that scatters with the temperature"; "darks with the temperature logged"; "Janesick 2001, ch. 7"
    ["common"] &[Faster, Signal, Slower, Square] => "a lamp or a shutter that scatters from frame to frame"; "a light monitor beside the camera"; "EMVA 1288 release 4, section 6 (stability of the light source)"
    ["gradient down" "gradient across" "gradients"] &[Faster, Signal, Slower, Square] => "light that moves between frames (a lamp, a diffuser, a card, a shadow)"; "the same with an integrating sphere, or with the lamp fixed to the camera"; "EMVA 1288 release 4, section 6 (stability of the light source)"
    ["gradient down" "gradient across" "gradients"] &[Constant, Exposure, Step] => "a black level that drifts while a frame is read out, anew in each frame (a supply that sags)"; "darks at another line time and frame rate"; "Janesick 2007"
    ["curvature down" "curvature across" "bulge"] &[Faster, Signal, Slower, Square] => "a lens that breathes (focus, iris, vibration), or several lamps that flicker each by itself"; "the same without the lens, or with one lamp"; "EMVA 1288 release 4, section 6 (stability of the light source)"
    ["curvature down" "curvature across" "bulge"] &[Constant, Exposure, Step] => "a black level that droops while a frame is read out, anew in each frame"; "darks at another line time and frame rate"; "Janesick 2007"
    ["mean"] &[Square] => "a response that bends"; "one light and many exposures against many lights and one exposure"; "EMVA 1288 release 4, section 6 (linearity by exposure time)"
    ["mean"] &[Step] => "two amplifiers or two gains that are merged at one level"; "flats in small steps around that level"; "Janesick 2007"
    ["mean"] &[Wave] => "a converter whose steps are unequal over the range, or a table of few nodes"; "a sweep in small steps"; "IEEE 1241-2010, histogram test"
    ["mean"] &[Time] => "a lamp, a black level or an amplifier that drifts"; "the first set once more at the end"; "EMVA 1288 release 4, section 6 (stability of the light source)"
    ["mean"] &[Odd] => "two readings, buffers or lamp phases that alternate"; "frames one by one, at half of the frame rate"; "Janesick 2007"
}

/// Returns the causes of a law, the likeliest first.
pub fn of(target: &str, growth: Growth) -> Vec<&'static Cause> {
    CAUSES.iter().filter(|c| c.targets.contains(&target) && c.growth.contains(&growth)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::proposal::laws;

    /// Every law has a cause, and every entry belongs to some law and names a measurement and a source.
    #[test]
    fn every_law_has_a_cause_and_every_cause_a_law() {
        for law in laws::all() {
            assert!(!of(law.target.name, law.shape.growth).is_empty(), "{}", law.effect.id());
        }
        for cause in CAUSES {
            for target in cause.targets {
                let has = laws::all()
                    .iter()
                    .any(|law| law.target.name == *target && of(target, law.shape.growth).contains(&cause));
                assert!(has, "{target} {:?}", cause.growth);
            }
            assert!(!cause.measure.is_empty() && !cause.source.is_empty());
        }
    }
}
