//! Capture of the frames of a check, with a camera and its bench.

use super::{Check, Stack, Taken};
use crate::bench::{BenchError, Illuminator};
use crate::calibrate::file::Calibration;
use crate::camera::{self, Camera, CameraError, StreamOptions};
use crate::frame::{Frame, Status};
use crate::plan::BenchState;
use crate::stream::StreamError;
use radcam_sim::Scene;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

/// Maximum excess of damaged over whole frames before a check is aborted.
const DAMAGED: u64 = 20;

/// Exposures and frames of a check.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Exposure of flats and short darks, s; `None`: exposure of the calibration's dark reference.
    pub exposure_s: Option<f64>,
    /// Exposure of long darks, relative to the short ones.
    pub long: f64,
    /// Frames of each kind.
    pub frames: u64,
    /// Light of the reference flat, relative.
    pub illumination: f64,
}

impl Default for Plan {
    fn default() -> Self {
        Self { exposure_s: None, long: 10.0, frames: 8, illumination: 1.0 }
    }
}

/// Reason why a check could not be taken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TakeError {
    /// Camera error.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// Bench error.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// The camera is not the calibrated one, or cannot be brought to its settings.
    #[error(transparent)]
    Prepare(StreamError),
    /// More damaged than whole frames.
    #[error(
        "camera {camera}: {damaged} damaged frames, and {whole} whole ones; look at packet size, cable and switch"
    )]
    Damaged {
        /// Camera id.
        camera: String,
        /// Damaged frames.
        damaged: u64,
        /// Whole frames of the same kind.
        whole: u64,
    },
    /// Stopped on request.
    #[error("stopped")]
    Stopped,
    /// Frame size differs from the calibration.
    #[error("check: {0}")]
    Size(#[from] crate::statistics::moments::SizeMismatch),
}

impl From<StreamError> for TakeError {
    fn from(error: StreamError) -> Self {
        match error {
            StreamError::Camera(e) => Self::Camera(e),
            other => Self::Prepare(other),
        }
    }
}

/// Takes short darks, long darks and the reference flat; the bench stays set for the flat.
///
/// # Errors
///
/// The camera or the bench fails, more frames arrive damaged than whole, or a stop is requested.
pub fn take(
    camera: &mut dyn Camera,
    bench: &mut dyn Illuminator,
    calibration: &Calibration,
    plan: &Plan,
    options: &StreamOptions,
    stop: &AtomicBool,
) -> Result<Check, TakeError> {
    let exposure_s = plan.exposure_s.unwrap_or(calibration.description.dark_exposure_s);
    let longest = camera.capabilities().exposure_s.map_or(f64::INFINITY, |b| b.max);
    let known = calibration.dark.current_dn_per_s.is_some();
    let long_s = if known { (plan.long * exposure_s).min(longest) } else { exposure_s };
    let shape = calibration.k.dim();
    let bits = calibration.description.camera.bit_depth;
    let [mut short, mut long, mut flat] = [(); 3].map(|()| Stack::new(shape, bits));
    let dark = BenchState { illumination: 0.0, configuration: 0, scene: Scene::Card };
    let lit = BenchState { illumination: plan.illumination, ..dark };
    let id = camera.identity().id.clone();
    let mut lost = 0;
    let mut exposures = [exposure_s, long_s];
    for (stack, state, at) in [(&mut short, dark, 0), (&mut long, dark, 1), (&mut flat, lit, 0)] {
        bench.apply(&state, camera)?;
        exposures[at] = camera.set_exposure_s(exposures[at])?;
        let timeout = camera::patience(exposures[at]);
        let mut stream = camera.stream(options)?;
        let mut frame = Frame::new(0, 0);
        let mut damaged = 0;
        while stack.frames() < plan.frames {
            if stop.load(Ordering::Relaxed) {
                return Err(TakeError::Stopped);
            }
            stream.next(&mut frame, timeout)?;
            if frame.status == Status::Complete {
                stack.add(frame.pixels.as_slice().unwrap_or_default())?;
                continue;
            }
            damaged += 1;
            let whole = stack.frames();
            if damaged > DAMAGED + whole {
                return Err(TakeError::Damaged { camera: id, damaged, whole });
            }
        }
        lost += stream.counts().lost();
    }
    let temperature_c = camera.settings()?.temperature_c;
    let time_s = seconds_since_1970(SystemTime::now());
    let [exposure_s, long_s] = exposures;
    Ok(Taken { time_s, exposure_s, long_s, temperature_c, short, long, flat, lost }.check(calibration))
}

/// Converts to seconds since 1970; negative if the clock was never set.
fn seconds_since_1970(time: SystemTime) -> f64 {
    time.duration_since(UNIX_EPOCH).map_or_else(|e| -e.duration().as_secs_f64(), |t| t.as_secs_f64())
}
