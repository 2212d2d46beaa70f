//! Cameras behind one trait: real ones, simulated ones, and recordings.
//!
//! Each backend is one file or folder here with a [`Backend`], and one line in the list below; [`corrected`]
//! wraps any of them. An unsupported operation returns [`CameraError::NotAvailable`]; [`Capabilities`] tells
//! beforehand.

pub mod corrected;
mod counter;

pub use counter::FrameCounter;

macro_rules! backends {
    ($($(#[$when:meta])* $module:ident)*) => {
        $($(#[$when])* pub mod $module;)*

        /// Every backend of this build.
        pub static BACKENDS: &[Backend] = &[$($(#[$when])* $module::BACKEND),*];
    };
}

backends! {
    #[cfg(feature = "aravis")]
    aravis
    sim
    replay
}

use crate::dataset::CameraInfo;
pub use crate::features::Value;
use crate::frame::{Frame, Region};
use crate::pixel_format::PixelFormat;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

/// Camera backend: one kind of camera.
#[derive(Debug, Clone, Copy)]
pub struct Backend {
    /// Prefix of a camera name, before the colon.
    pub name: &'static str,
    /// Description of the part after the colon, for messages.
    pub takes: &'static str,
    /// Function that opens a camera, given the part after the colon.
    pub open: fn(&str) -> Result<Box<dyn Camera>, CameraError>,
    /// Function that lists the cameras available now.
    pub list: fn() -> Vec<Listed>,
}

/// A camera that can be opened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Listed {
    /// Name that [`open`] accepts.
    pub camera: String,
    /// Maker.
    pub vendor: String,
    /// Model name.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// Transport protocol, such as `GigEVision`.
    pub protocol: String,
}

/// Opens a camera by its name: `aravis:ID` (an IP address, an Aravis id or a serial number), `sim:SENSOR` or
/// `replay:DATASET`.
///
/// ```
/// let camera = radcam::camera::open("sim:cmos12")?;
/// assert_eq!(camera.identity().id, "sim:cmos12");
/// # Ok::<(), radcam::camera::CameraError>(())
/// ```
///
/// # Errors
///
/// [`CameraError::Absent`] if no backend has that name or no such camera answers.
pub fn open(name: &str) -> Result<Box<dyn Camera>, CameraError> {
    let absent = |message: String| CameraError::Absent { camera: name.into(), message };
    let Some((kind, id)) = name.split_once(':') else {
        return Err(absent(format!("write {}; `radcam cameras` lists them", names())));
    };
    match BACKENDS.iter().find(|b| b.name == kind) {
        Some(backend) => (backend.open)(id),
        None if kind == "aravis" => Err(absent(NO_ARAVIS.into())),
        None => {
            let names: Vec<&str> = BACKENDS.iter().map(|b| b.name).collect();
            Err(absent(format!("no backend \"{kind}\"; there are {}", names.join(", "))))
        }
    }
}

/// Returns the name forms that [`open`] accepts: `aravis:ID (...), sim:SENSOR or replay:DATASET`.
pub fn names() -> String {
    let forms: Vec<String> = BACKENDS.iter().map(|b| format!("{}:{}", b.name, b.takes)).collect();
    match forms.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        _ => forms.concat(),
    }
}

/// Lists every camera that [`open`] can open now, except recordings. A search of networks and USB takes about
/// a second.
pub fn list() -> Vec<Listed> {
    BACKENDS.iter().flat_map(|b| (b.list)()).collect()
}

/// Error message of a radcam that was built without libaravis.
pub const NO_ARAVIS: &str = "this radcam was built without libaravis; install libaravis-dev and libusb-1.0-0-dev and \
                             build with the feature \"aravis\" (on by default)";

/// Identity of a camera.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Identity {
    /// Name that opens the camera again, such as `aravis:192.168.1.5`.
    pub id: String,
    /// Maker.
    pub vendor: String,
    /// Model name.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// Firmware version, if the camera reports it.
    pub firmware: Option<String>,
}

impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for word in [&self.vendor, &self.model, &self.serial].into_iter().filter(|w| !w.is_empty()) {
            write!(f, "{word} ")?;
        }
        write!(f, "({})", self.id)
    }
}

/// Range and step of a numeric setting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Step, if the camera has one.
    pub increment: Option<f64>,
}

impl Bounds {
    /// Returns the nearest value that the camera accepts.
    pub fn nearest(&self, value: f64) -> f64 {
        let value = value.min(self.max).max(self.min);
        match self.increment {
            Some(step) if step > 0.0 => {
                let last = ((self.max - self.min) / step + 1e-9).floor();
                self.min + ((value - self.min) / step).round().min(last) * step
            }
            _ => value,
        }
    }
}

/// Capabilities of a camera. `None`: the camera has no such setting.
#[derive(Debug, Clone, PartialEq)]
pub struct Capabilities {
    /// Exposure, s.
    pub exposure_s: Option<Bounds>,
    /// Gain, dB.
    pub gain_db: Option<Bounds>,
    /// Black level, DN (or the camera's own unit if it has another).
    pub black_level_dn: Option<Bounds>,
    /// Frames per second.
    pub frame_rate_hz: Option<Bounds>,
    /// Width, pixels.
    pub width: Bounds,
    /// Height, pixels.
    pub height: Bounds,
    /// Step of the region's first column and first row, pixels.
    pub offset_increment: (u32, u32),
    /// Formats that radcam can unpack.
    pub pixel_formats: Vec<PixelFormat>,
    /// True if single frames can be triggered by software.
    pub software_trigger: bool,
}

/// Settings as the camera reports them.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Exposure, s.
    pub exposure_s: f64,
    /// Gain, dB.
    pub gain_db: Option<f64>,
    /// Black level, DN.
    pub black_level_dn: Option<f64>,
    /// Frames per second.
    pub frame_rate_hz: Option<f64>,
    /// Format.
    pub pixel_format: PixelFormat,
    /// Region of interest.
    pub region: Region,
    /// Sensor temperature, degrees Celsius.
    pub temperature_c: Option<f64>,
}

impl Settings {
    /// Returns the `[camera]` table of a dataset: identity and settings, without further features.
    pub fn info(&self, identity: &Identity) -> CameraInfo {
        CameraInfo {
            vendor: identity.vendor.clone(),
            model: identity.model.clone(),
            serial: identity.serial.clone(),
            width: self.region.width as usize,
            height: self.region.height as usize,
            bit_depth: self.pixel_format.bits(),
            pixel_format: self.pixel_format.name().into(),
            gain_db: self.gain_db,
            black_level_dn: self.black_level_dn,
            temperature_c: self.temperature_c,
            firmware: identity.firmware.clone(),
            ..CameraInfo::default()
        }
    }
}

/// Reads identity, settings and features of a camera in the terms of a dataset and of a calibration.
///
/// # Errors
///
/// A setting that the camera refuses to report.
pub fn info(camera: &mut dyn Camera) -> Result<CameraInfo, CameraError> {
    let settings = camera.settings()?;
    let features = camera.features().into_iter().map(|(name, value)| (name, value.into())).collect();
    Ok(CameraInfo { features, ..settings.info(camera.identity()) })
}

/// Returns the timeout for a frame: twice the exposure, because one may be in progress, plus time for the
/// camera to answer; a day at most.
pub fn patience(exposure_s: f64) -> Duration {
    Duration::from_secs_f64((2.0 * exposure_s.max(0.0) + 5.0).min(86_400.0))
}

/// Trigger mode of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Trigger {
    /// Continuous acquisition.
    #[default]
    FreeRun,
    /// One frame for each [`FrameStream::trigger`].
    Software,
}

/// Automatic function of the camera, and the result of switching it off.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Automatic {
    /// GenICam name.
    pub feature: String,
    /// Value before.
    pub before: String,
    /// Value read back.
    pub now: String,
    /// True if the function no longer affects the image.
    pub off: bool,
}

/// Configuration of a stream.
#[derive(Debug, Clone, PartialEq)]
pub struct StreamOptions {
    /// Buffers queued for the camera to fill.
    pub buffers: usize,
    /// Maximum number of complete frames that wait to be taken. One more drops the oldest, which is counted.
    /// `None`: all wait, and a frame that finds no free buffer is an underrun. Keep it below `buffers`, so
    /// that one buffer is always free.
    pub waiting: Option<usize>,
    /// GigE Vision: packet size, bytes; `None` negotiates the largest that passes.
    pub packet_size: Option<u32>,
    /// GigE Vision: true if lost packets are requested again (packet resend).
    pub packet_resend: bool,
    /// GigE Vision: time until a packet counts as lost.
    pub packet_timeout: Duration,
    /// GigE Vision: time until an incomplete frame is given up.
    pub frame_retention: Duration,
    /// GigE Vision: receive buffer of the socket, bytes.
    pub socket_buffer: usize,
}

impl Default for StreamOptions {
    fn default() -> Self {
        Self {
            buffers: 8,
            waiting: None,
            packet_size: None,
            packet_resend: true,
            packet_timeout: Duration::from_millis(40),
            frame_retention: Duration::from_millis(200),
            socket_buffer: 8 << 20,
        }
    }
}

/// Frame counts of a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct StreamCounts {
    /// Complete frames handed out.
    pub completed: u64,
    /// Frames that arrived damaged or incomplete.
    pub failures: u64,
    /// Frames lost because no buffer was available (underruns).
    pub underruns: u64,
    /// Complete frames dropped to make room for newer ones ([`StreamOptions::waiting`]).
    #[serde(default)]
    pub dropped: u64,
    /// Frames known only from gaps in the frame numbers, or from the camera's clock after an interval without
    /// the camera.
    pub missing: u64,
    /// Complete frames discarded because their number had come before. None of them counts as lost.
    #[serde(default)]
    pub repeated: u64,
}

impl StreamCounts {
    /// Returns the number of lost frames: damaged, dropped, without a buffer, or never seen.
    pub fn lost(&self) -> u64 {
        self.failures + self.underruns + self.dropped + self.missing
    }

    /// Adds another stream's counts.
    pub fn add(&mut self, other: StreamCounts) {
        self.completed += other.completed;
        self.failures += other.failures;
        self.underruns += other.underruns;
        self.dropped += other.dropped;
        self.missing += other.missing;
        self.repeated += other.repeated;
    }
}

/// Camera error.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// No such camera.
    #[error("camera {camera}: {message}")]
    Absent {
        /// Requested name.
        camera: String,
        /// Reason or cameras found instead, and advice.
        message: String,
    },
    /// The camera was open and no longer answers.
    #[error("camera {camera} was lost: {message}")]
    Lost {
        /// Camera id.
        camera: String,
        /// Symptom of the loss.
        message: String,
    },
    /// A recording has no more frames.
    #[error("camera {camera}: {message}")]
    Ended {
        /// Camera id.
        camera: String,
        /// Settings without further frames.
        message: String,
    },
    /// The camera has no such feature.
    #[error("camera {camera} has no {feature}")]
    NotAvailable {
        /// Camera id.
        camera: String,
        /// Feature name.
        feature: String,
    },
    /// The value is outside the range that the camera accepts.
    #[error("camera {camera}: {feature} = {value} {unit} lies outside {min} to {max} {unit}")]
    OutOfRange {
        /// Camera id.
        camera: String,
        /// Feature name.
        feature: String,
        /// Requested value.
        value: f64,
        /// Smallest value.
        min: f64,
        /// Largest value.
        max: f64,
        /// Unit of the three.
        unit: &'static str,
    },
    /// The camera reports another value than the requested one.
    #[error("camera {camera}: {feature} was set to {asked} and reads {got}")]
    ReadBack {
        /// Camera id.
        camera: String,
        /// Feature name.
        feature: String,
        /// Requested value, with its unit.
        asked: String,
        /// Value read back, with its unit.
        got: String,
    },
    /// No frame arrived in time.
    #[error("camera {camera}: no frame within {seconds:.1} s ({counts})")]
    Timeout {
        /// Camera id.
        camera: String,
        /// Time waited, s.
        seconds: f64,
        /// Frames counted so far, or the cause, with advice.
        counts: String,
    },
    /// The backend reported an error.
    #[error("camera {camera}: {feature}: {message}")]
    Backend {
        /// Camera id.
        camera: String,
        /// Feature or action.
        feature: String,
        /// Message of the backend.
        message: String,
    },
}

/// Frame as received, before it is unpacked.
#[derive(Debug, Clone, Copy)]
pub struct Arrived<'a> {
    /// Pixels row by row, as received over the wire.
    pub bytes: &'a [u8],
    /// Pixel format of the bytes.
    pub format: PixelFormat,
    /// Columns and rows.
    pub size: (usize, usize),
    /// As [`Frame::id`].
    pub id: u64,
    /// As [`Frame::timestamp_ns`].
    pub timestamp_ns: Option<u64>,
    /// Time since the first packet of the frame arrived, if known.
    pub age: Option<Duration>,
}

/// A running acquisition. Dropping it stops the camera.
pub trait FrameStream {
    /// Waits for the next frame and writes it into `frame`, without an allocation if the size fits.
    ///
    /// A damaged frame is returned with its status and counted; it must not be used.
    ///
    /// # Errors
    ///
    /// [`CameraError::Timeout`] if no frame came in time, [`CameraError::Lost`] if the camera is gone.
    fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<(), CameraError>;

    /// Waits for the next frame and passes its bytes to `take` in place, without a copy. A damaged frame is
    /// counted, and `take` receives the reason. A backend whose frames do not arrive as bytes uses `memory`.
    ///
    /// # Errors
    ///
    /// As [`next`](Self::next).
    fn next_arrived(
        &mut self,
        memory: &mut Frame,
        timeout: Duration,
        take: &mut dyn FnMut(Result<Arrived<'_>, &str>),
    ) -> Result<(), CameraError> {
        self.next(memory, timeout)?;
        if let crate::frame::Status::Damaged(why) = &memory.status {
            take(Err(why));
            return Ok(());
        }
        let (height, width) = memory.pixels.dim();
        let codes = memory.pixels.as_slice_mut().unwrap_or_default();
        #[cfg(target_endian = "big")]
        codes.iter_mut().for_each(|c| *c = c.to_le());
        take(Ok(Arrived {
            bytes: bytemuck::cast_slice(codes),
            format: PixelFormat::MONO16,
            size: (width, height),
            id: memory.id,
            timestamp_ns: memory.timestamp_ns,
            age: None,
        }));
        Ok(())
    }

    /// Requests one frame, with [`Trigger::Software`].
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] without a software trigger.
    fn trigger(&mut self) -> Result<(), CameraError>;

    /// Returns the counts so far.
    fn counts(&self) -> StreamCounts;
}

/// Interface of a camera.
///
/// Setters return the value that the camera then reports, possibly the nearest that it accepts.
pub trait Camera: Send {
    /// Returns the identity of the camera.
    fn identity(&self) -> &Identity;

    /// Returns the capabilities of the camera.
    fn capabilities(&self) -> &Capabilities;

    /// Reads every setting back.
    ///
    /// # Errors
    ///
    /// [`CameraError::Lost`], or a setting that the camera refuses to report.
    fn settings(&mut self) -> Result<Settings, CameraError>;

    /// Sets the exposure, s.
    ///
    /// # Errors
    ///
    /// [`CameraError::OutOfRange`], or the camera refuses the value.
    fn set_exposure_s(&mut self, value: f64) -> Result<f64, CameraError>;

    /// Sets the gain, dB.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] if there is no such setting, [`CameraError::OutOfRange`], or the camera
    /// refuses the value.
    fn set_gain_db(&mut self, _value: f64) -> Result<f64, CameraError> {
        Err(self.not_available("Gain"))
    }

    /// Sets the black level, DN.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] if there is no such setting, [`CameraError::OutOfRange`], or the camera
    /// refuses the value.
    fn set_black_level_dn(&mut self, _value: f64) -> Result<f64, CameraError> {
        Err(self.not_available("BlackLevel"))
    }

    /// Sets the frame rate, 1/s.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] if there is no such setting, [`CameraError::OutOfRange`], or the camera
    /// refuses the value.
    fn set_frame_rate_hz(&mut self, _value: f64) -> Result<f64, CameraError> {
        Err(self.not_available("AcquisitionFrameRate"))
    }

    /// Sets the pixel format.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] if there is no such format, or the camera refuses it.
    fn set_pixel_format(&mut self, format: PixelFormat) -> Result<PixelFormat, CameraError>;

    /// Sets the region of interest.
    ///
    /// # Errors
    ///
    /// [`CameraError::OutOfRange`], or the camera refuses the region.
    fn set_region(&mut self, region: Region) -> Result<Region, CameraError>;

    /// Sets the trigger mode.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] if there is no such trigger.
    fn set_trigger(&mut self, trigger: Trigger) -> Result<(), CameraError> {
        match trigger {
            Trigger::FreeRun => Ok(()),
            Trigger::Software => Err(self.not_available("TriggerSoftware")),
        }
    }

    /// Switches off features that distort radiometry, reads each one back and returns the results.
    ///
    /// # Errors
    ///
    /// A feature that the camera refuses to report. A feature that cannot be switched off is no error.
    fn disable_automatics(&mut self) -> Result<Vec<Automatic>, CameraError> {
        Ok(Vec::new())
    }

    /// Returns true if the camera has a feature with this GenICam name.
    fn has_feature(&mut self, _name: &str) -> bool {
        false
    }

    /// Sets a feature by its GenICam name and reads it back.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] if there is no such feature, or the camera refuses the value.
    fn set_feature(&mut self, name: &str, _value: &Value) -> Result<Value, CameraError> {
        Err(self.not_available(name))
    }

    /// Reads a feature by its GenICam name.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] if there is no such feature, or the camera refuses to report it.
    fn feature(&mut self, name: &str) -> Result<Value, CameraError> {
        Err(self.not_available(name))
    }

    /// Executes a command by its GenICam name.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] if there is no such command, or the camera refuses it.
    fn execute(&mut self, command: &str) -> Result<(), CameraError> {
        Err(self.not_available(command))
    }

    /// Returns the maximum of a numeric feature.
    fn largest(&mut self, _name: &str) -> Option<f64> {
        None
    }

    /// Returns the names of camera files that can be written or read (SFNC, File Access Control).
    fn files(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// Writes a file into the camera. `go_on` receives the number of bytes done and cancels by returning
    /// false; the contents of the file are then up to the camera.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] if there is no such file, or the camera refuses it.
    fn write_file(
        &mut self,
        name: &str,
        _bytes: &[u8],
        _go_on: &mut dyn FnMut(usize) -> bool,
    ) -> Result<(), CameraError> {
        Err(self.not_available(name))
    }

    /// Reads a file of the camera, up to a maximum number of bytes.
    ///
    /// # Errors
    ///
    /// As [`write_file`](Self::write_file).
    fn read_file(
        &mut self,
        name: &str,
        _most: usize,
        _go_on: &mut dyn FnMut(usize) -> bool,
    ) -> Result<Vec<u8>, CameraError> {
        Err(self.not_available(name))
    }

    /// Returns the settings worth recording with a capture, by GenICam name. A feature that a selector gives
    /// several entries is named `Name[Entry]`.
    fn features(&mut self) -> BTreeMap<String, Value> {
        BTreeMap::new()
    }

    /// Returns features that are unknown to [`crate::features::role`] and whose names suggest radiometry.
    fn unlisted_features(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// Returns true if the camera repeats the same frames from the first one on. A campaign is then continued
    /// by drawing again the frames on disk.
    fn draws_again(&self) -> bool {
        false
    }

    /// Announces that a campaign is continued: the number of frames taken, and the time of the last one, s. A
    /// simulated camera must not draw the same noise twice. Returns true if the camera's clock shows campaign
    /// time from now on.
    fn continue_after(&mut self, _frames: u64, _time_s: f64) -> bool {
        false
    }

    /// Sets the number and the time, s, of the next frame of a simulated camera. Its noise then follows from
    /// the position of the frame in a campaign. Returns false if the camera cannot do this.
    fn draw_from(&mut self, _frame: u64, _time_s: f64) -> bool {
        false
    }

    /// Returns the simulated bench in front of the camera, which drives its light; `None`: a real bench.
    fn shared_bench(&self) -> Option<sim::SharedBench> {
        None
    }

    /// Returns the photons per pixel per second of the camera's own bench at illumination 1, if known: for a
    /// simulated or served camera.
    fn photon_flux_per_s(&mut self) -> Option<f64> {
        None
    }

    /// Starts the acquisition.
    ///
    /// # Errors
    ///
    /// The camera refuses, or no stream can be set up.
    fn stream(&mut self, options: &StreamOptions) -> Result<Box<dyn FrameStream + '_>, CameraError>;

    /// Returns the error for a feature that this camera does not have.
    fn not_available(&self, feature: &str) -> CameraError {
        CameraError::NotAvailable { camera: self.identity().id.clone(), feature: feature.into() }
    }
}

/// Checks a value against the bounds of a feature that may be absent.
pub(crate) fn check_bounds(
    camera: &str,
    feature: &str,
    bounds: Option<Bounds>,
    value: f64,
    unit: &'static str,
) -> Result<Bounds, CameraError> {
    let bounds =
        bounds.ok_or_else(|| CameraError::NotAvailable { camera: camera.into(), feature: feature.into() })?;
    // An excess within rounding error is accepted.
    let slack = 1e-9 * bounds.max.abs().max(bounds.min.abs());
    if value >= bounds.min - slack && value <= bounds.max + slack {
        return Ok(bounds);
    }
    let (min, max) = (bounds.min, bounds.max);
    Err(CameraError::OutOfRange { camera: camera.into(), feature: feature.into(), value, min, max, unit })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_value_lies_on_the_grid_and_within_bounds() {
        let bounds = Bounds { min: 1.0, max: 2.05, increment: Some(0.1) };
        assert!((bounds.nearest(1.234) - 1.2).abs() < 1e-12);
        assert_eq!(bounds.nearest(0.0), 1.0);
        assert!((bounds.nearest(9.0) - 2.0).abs() < 1e-12);
    }
}
