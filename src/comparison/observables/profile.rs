//! Residual of the profiles of rows and of columns over all levels, relative to the noise, after a fit of one
//! offset, gain and dark current per line. Large if the response or offset of rows or columns differs between
//! levels.

use super::{Expected, HalfView, Observable, Put, Statistic, View, in_quadrature};
use crate::statistics::pass::Summary;
use crate::statistics::profiles::{Profile, left_over};
use radcam_sim::predict::SetPrediction;

/// Mean square: of rows, then of columns.
#[derive(Debug)]
pub struct LineProfile;

impl Statistic for LineProfile {
    fn id(&self) -> &'static str {
        "profiles"
    }

    fn name(&self, index: usize) -> String {
        format!("profiles of {} against one offset, gain and dark current", ["rows", "columns"][index.min(1)])
    }

    fn meaning(&self, _: usize) -> &'static str {
        "parts of the sensor answer in different ways, or their offsets move"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        for axis in 0..2 {
            // A scene leaves its image in the next set.
            let sets = half.chunks.iter().zip(&half.sets);
            let profiles: Vec<_> = sets
                .filter(|(s, set)| !set.after_scene && set.in_main_field && s.frames > 2)
                .map(|(s, set)| of_summary(s, half.zero_dn, set.exposure_s, axis))
                .collect();
            if let Some(v) = left_over(&profiles) {
                put.put(axis, v.value, v.std_err);
            }
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let (rows, columns) = view.all.campaign.shape;
        let pixels = if o.index == 0 { columns } else { rows };
        let p = view.prediction;
        let (mut value, mut unsure, mut n) = (0.0, 0.0, 0.0);
        for s in &p.sets {
            let noise = of_line(s, o.index, pixels);
            if noise <= 0.0 {
                continue;
            }
            n += 1.0;
            value += correlated(s, USUAL_FRAMES);
            // Lines of noisier pixels scatter more; the mean over all lines hardly changes.
            let telegraph = s.unequal.max(0.0).sqrt() / pixels as f64 / (pixels as f64).sqrt();
            // A ripple whose phase moves slowly remains in the mean of a few frames.
            let ripple =
                if o.index == 0 { s.ripple(0.0) + s.fields.of_rows() } else { s.fields.of_columns() };
            unsure += USUAL_FRAMES * (s.uneven * s.uneven + telegraph + ripple) / noise;
        }
        let n = f64::max(n, 1.0);
        let expected = Expected::plain(o, value / n, in_quadrature(&[o.measured.std_err, unsure / n]));
        // No effect predicts such a misfit; the fit must not distort other parameters to reduce it.
        let alone = (o.measured.value - 1.0).abs() > NOT_FITTED * o.measured.std_err;
        if alone { expected.with_tails(expected.std_err) } else { expected }
    }
}

/// Misfit of profiles, in standard errors, above which it is reported but does not dominate the fit (a named
/// choice).
const NOT_FITTED: f64 = 20.0;

/// Usual number of frames of a chunk.
const USUAL_FRAMES: f64 = 4.0;

fn of_summary(s: &Summary, zero_dn: f64, exposure_s: f64, axis: usize) -> Profile<'_> {
    Profile {
        lines_dn: if axis == 0 { &s.rows_dn } else { &s.columns_dn },
        var_dn2: s.line_var_dn2[axis],
        frames: s.frames as f64,
        signal_dn: s.frame_means.mean_dn() - zero_dn,
        exposure_s,
    }
}

/// Returns the variance of the means of lines, DN^2.
fn of_line(s: &SetPrediction, axis: usize, pixels: usize) -> f64 {
    let own = (s.shot.along(1 - axis) + s.read.along(1 - axis)) / pixels as f64;
    own + if axis == 0 {
        s.row.lag(0) + s.ripple(0.0) + s.fields.of_rows()
    } else {
        s.column.lag(0) + s.fields.of_columns()
    }
}

/// Returns the ratio of the variance of the mean of this many frames to that expected from their scatter
/// about it, for temporally correlated noise.
fn correlated(s: &SetPrediction, frames: f64) -> f64 {
    let lost = |memory: &[f64]| -> f64 {
        memory.iter().enumerate().map(|(k, r)| (frames - (k + 1) as f64).max(0.0) * r).sum::<f64>() / frames
    };
    let (shot, read) = (s.shot.of_mean(), s.read.of_mean());
    let part =
        (shot * lost(&s.shot_memory) + read * lost(&s.read_memory)) / (shot + read).max(f64::MIN_POSITIVE);
    (1.0 + 2.0 * part) / (1.0 - 2.0 * part / (frames - 1.0))
}
