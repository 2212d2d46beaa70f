//! Camera with corrected frames, eq. (51): any camera together with its calibration.

use super::{
    Automatic, Camera, CameraError, Capabilities, FrameStream, Identity, Settings, StreamCounts,
    StreamOptions, Trigger, Value, info,
};
use crate::calibrate::file::Calibration;
use crate::correct::{Codes, CorrectError, Corrector};
use crate::frame::{Frame, Region, Status};
use crate::pixel_format::PixelFormat;
use std::collections::BTreeMap;
use std::time::Duration;

/// Camera and corrector. Frames are 16-bit codes; [`Codes`] gives their meaning.
///
/// ```
/// # use radcam::calibrate::file::Calibration;
/// # use radcam::camera::{Camera, corrected::Corrected};
/// # use radcam::correct::Codes;
/// # fn on_the_line(camera: impl Camera, calibration: Calibration) -> Result<(), Box<dyn std::error::Error>> {
/// let codes = Codes { scale: 16.0, offset: 1024.0 }; // 16 codes per DN, zero at 1024
/// let mut camera = Corrected::new(camera, calibration, codes)?;
/// camera.set_exposure_s(0.004)?; // the dark reference follows, where the calibration holds a dark current
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Corrected<C> {
    camera: C,
    calibration: Calibration,
    codes: Codes,
    corrector: Corrector,
}

fn fault(camera: &impl Camera, error: CorrectError) -> CameraError {
    CameraError::Backend {
        camera: camera.identity().id.clone(),
        feature: "correction".into(),
        message: error.to_string(),
    }
}

impl<C: Camera> Corrected<C> {
    /// Joins a camera and its calibration. Refuses if camera, size, format, gain or black level are not those
    /// of the calibration, and names the differences. Also refuses if the dark reference does not cover the
    /// current exposure.
    ///
    /// # Errors
    ///
    /// Differences between the camera and that of the calibration.
    pub fn new(mut camera: C, calibration: Calibration, codes: Codes) -> Result<Self, CameraError> {
        let now = info(&mut camera)?;
        let found = calibration.description.camera.differences(&now);
        if !found.is_empty() {
            return Err(fault(&camera, CorrectError::Settings(found.join("; "))));
        }
        let exposure_s = camera.settings()?.exposure_s;
        let corrector = Corrector::new(&calibration, exposure_s).map_err(|e| fault(&camera, e))?;
        Ok(Self { camera, calibration, codes, corrector })
    }

    /// Also replaces the pixels that the calibration flags.
    pub fn replacing_defects(mut self) -> Self {
        self.corrector = self.corrector.replacing_defects(&self.calibration);
        self
    }

    /// Returns the meaning of the codes.
    pub fn codes(&self) -> Codes {
        self.codes
    }

    /// Returns the camera without correction.
    pub fn into_inner(self) -> C {
        self.camera
    }

    /// Switches to the dark reference of another exposure. Restores the old exposure if the reference does
    /// not cover the new one.
    fn follow(&mut self, before_s: f64, now_s: f64) -> Result<(), CameraError> {
        if now_s == before_s {
            return Ok(());
        }
        match Corrector::new(&self.calibration, now_s) {
            Ok(c) => {
                let replaces = self.corrector.replaced() > 0;
                self.corrector = if replaces { c.replacing_defects(&self.calibration) } else { c };
                Ok(())
            }
            Err(e) => {
                self.camera.set_exposure_s(before_s)?;
                Err(fault(&self.camera, e))
            }
        }
    }

    /// Applies a setting, and undoes it if the calibration does not hold under it.
    fn keep<T>(
        &mut self,
        set: impl FnOnce(&mut C) -> Result<T, CameraError>,
        undo: impl FnOnce(&mut C, &Settings) -> Result<(), CameraError>,
    ) -> Result<T, CameraError> {
        let before = self.camera.settings()?;
        let value = set(&mut self.camera)?;
        let found = self.calibration.description.camera.differences(&info(&mut self.camera)?);
        if found.is_empty() {
            return Ok(value);
        }
        undo(&mut self.camera, &before)?;
        Err(fault(&self.camera, CorrectError::Settings(found.join("; "))))
    }
}

impl<C: Camera> Camera for Corrected<C> {
    fn identity(&self) -> &Identity {
        self.camera.identity()
    }

    fn capabilities(&self) -> &Capabilities {
        self.camera.capabilities()
    }

    fn settings(&mut self) -> Result<Settings, CameraError> {
        self.camera.settings()
    }

    fn set_exposure_s(&mut self, value: f64) -> Result<f64, CameraError> {
        let before_s = self.camera.settings()?.exposure_s;
        let now_s = self.camera.set_exposure_s(value)?;
        self.follow(before_s, now_s)?;
        Ok(now_s)
    }

    fn set_gain_db(&mut self, value: f64) -> Result<f64, CameraError> {
        self.keep(
            |c| c.set_gain_db(value),
            |c, before| before.gain_db.map_or(Ok(()), |g| c.set_gain_db(g).map(drop)),
        )
    }

    fn set_black_level_dn(&mut self, value: f64) -> Result<f64, CameraError> {
        self.keep(
            |c| c.set_black_level_dn(value),
            |c, before| before.black_level_dn.map_or(Ok(()), |b| c.set_black_level_dn(b).map(drop)),
        )
    }

    fn set_frame_rate_hz(&mut self, value: f64) -> Result<f64, CameraError> {
        self.camera.set_frame_rate_hz(value)
    }

    fn set_pixel_format(&mut self, format: PixelFormat) -> Result<PixelFormat, CameraError> {
        self.keep(
            |c| c.set_pixel_format(format),
            |c, before| c.set_pixel_format(before.pixel_format).map(drop),
        )
    }

    fn set_region(&mut self, region: Region) -> Result<Region, CameraError> {
        // A calibration of an earlier version states no position of its region: only the region at
        // construction is accepted.
        let now = self.camera.settings()?.region;
        if region == now {
            return Ok(now);
        }
        let message = format!("region {now:?} belongs to the calibration, and {region:?} is asked for");
        Err(fault(&self.camera, CorrectError::Settings(message)))
    }

    fn set_trigger(&mut self, trigger: Trigger) -> Result<(), CameraError> {
        self.camera.set_trigger(trigger)
    }

    fn disable_automatics(&mut self) -> Result<Vec<Automatic>, CameraError> {
        self.camera.disable_automatics()
    }

    fn has_feature(&mut self, name: &str) -> bool {
        self.camera.has_feature(name)
    }

    fn set_feature(&mut self, name: &str, value: &Value) -> Result<Value, CameraError> {
        let before = self.camera.feature(name).ok();
        let before_s = self.camera.settings()?.exposure_s;
        let set = |c: &mut C| c.set_feature(name, value);
        let value = self.keep(set, |c, _| before.map_or(Ok(()), |b| c.set_feature(name, &b).map(drop)))?;
        let now_s = self.camera.settings()?.exposure_s;
        self.follow(before_s, now_s)?;
        Ok(value)
    }

    fn feature(&mut self, name: &str) -> Result<Value, CameraError> {
        self.camera.feature(name)
    }

    fn features(&mut self) -> BTreeMap<String, Value> {
        self.camera.features()
    }

    fn draw_from(&mut self, frame: u64, time_s: f64) -> bool {
        self.camera.draw_from(frame, time_s)
    }

    fn continue_after(&mut self, frames: u64, time_s: f64) -> bool {
        self.camera.continue_after(frames, time_s)
    }

    fn photon_flux_per_s(&mut self) -> Option<f64> {
        self.camera.photon_flux_per_s()
    }

    fn shared_bench(&self) -> Option<super::sim::SharedBench> {
        self.camera.shared_bench()
    }

    fn stream(&mut self, options: &StreamOptions) -> Result<Box<dyn FrameStream + '_>, CameraError> {
        let raw = Frame::new(0, 0);
        let id = self.camera.identity().id.clone();
        let stream = self.camera.stream(options)?;
        Ok(Box::new(CorrectedStream { id, stream, corrector: &self.corrector, codes: self.codes, raw }))
    }
}

struct CorrectedStream<'a> {
    id: String,
    stream: Box<dyn FrameStream + 'a>,
    corrector: &'a Corrector,
    codes: Codes,
    /// Raw frame (recycled buffer).
    raw: Frame,
}

impl FrameStream for CorrectedStream<'_> {
    fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<(), CameraError> {
        self.stream.next(&mut self.raw, timeout)?;
        let (height, width) = self.raw.pixels.dim();
        frame.status = self.raw.status.clone();
        frame.id = self.raw.id;
        frame.timestamp_ns = self.raw.timestamp_ns;
        frame.temperature_c = self.raw.temperature_c;
        let whole = frame.status == Status::Complete;
        let out = frame.pixels_mut(width, height);
        if !whole {
            out.fill(0);
            return Ok(());
        }
        let raw = self.raw.pixels.as_slice().unwrap_or_default();
        self.corrector.to_u16(raw, self.codes, out).map_err(|e| CameraError::Backend {
            camera: self.id.clone(),
            feature: "correction".into(),
            message: e.to_string(),
        })
    }

    fn trigger(&mut self) -> Result<(), CameraError> {
        self.stream.trigger()
    }

    fn counts(&self) -> StreamCounts {
        self.stream.counts()
    }
}
