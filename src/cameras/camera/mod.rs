//! Cameras behind one trait: real ones, simulated ones, and recordings.
//!
//! A backend is one file here, with its [`Backend`], and one line below. What a camera cannot do answers
//! [`CameraError::NotAvailable`], and [`Capabilities`] says so beforehand.

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

/// A kind of camera.
#[derive(Debug, Clone, Copy)]
pub struct Backend {
    /// What stands before the colon of a camera's name.
    pub name: &'static str,
    /// What stands behind it, in words.
    pub takes: &'static str,
    /// Opens a camera by what stands behind the colon.
    pub open: fn(&str) -> Result<Box<dyn Camera>, CameraError>,
    /// The cameras that are there now.
    pub list: fn() -> Vec<Listed>,
}

/// A camera that can be opened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Listed {
    /// What [`open`] takes.
    pub camera: String,
    /// Maker.
    pub vendor: String,
    /// Model name.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// How it is reached, such as `GigEVision`.
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
/// [`CameraError::Absent`] where no backend has that name or no such camera answers.
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

/// What [`open`] takes, in words: `aravis:ID (...), sim:SENSOR or replay:DATASET`.
pub fn names() -> String {
    let forms: Vec<String> = BACKENDS.iter().map(|b| format!("{}:{}", b.name, b.takes)).collect();
    match forms.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        _ => forms.concat(),
    }
}

/// Every camera that [`open`] can open now, recordings aside. A search of networks and USB takes about a second.
pub fn list() -> Vec<Listed> {
    BACKENDS.iter().flat_map(|b| (b.list)()).collect()
}

/// What is missing where radcam was built without libaravis.
pub const NO_ARAVIS: &str = "this radcam was built without libaravis; install libaravis-dev and libusb-1.0-0-dev and \
                             build with the feature \"aravis\" (on by default)";

/// Who a camera is.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Identity {
    /// How it is opened again, such as `aravis:192.168.1.5`.
    pub id: String,
    /// Maker.
    pub vendor: String,
    /// Model name.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// Firmware version, where the camera tells.
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

/// What a number may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Step, where the camera has one.
    pub increment: Option<f64>,
}

impl Bounds {
    /// The nearest value that the camera can take.
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

/// What a camera can do. `None`: it has no such setting.
#[derive(Debug, Clone, PartialEq)]
pub struct Capabilities {
    /// Exposure, s.
    pub exposure_s: Option<Bounds>,
    /// Gain, dB.
    pub gain_db: Option<Bounds>,
    /// Black level, DN (or the camera's own unit where it has another).
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
    /// Whether single frames can be asked for.
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
    /// The `[camera]` table of a dataset: who the camera is and how it is set, without its further features.
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

/// What a camera is now, in the terms of a dataset and of a calibration: identity, settings and features.
///
/// # Errors
///
/// What the camera refuses to tell.
pub fn info(camera: &mut dyn Camera) -> Result<CameraInfo, CameraError> {
    let settings = camera.settings()?;
    let features = camera.features().into_iter().map(|(name, value)| (name, value.into())).collect();
    Ok(CameraInfo { features, ..settings.info(camera.identity()) })
}

/// How long a frame is waited for: twice the exposure, since one may be under way, and time for the camera to
/// answer; a day at most.
pub fn patience(exposure_s: f64) -> Duration {
    Duration::from_secs_f64((2.0 * exposure_s.max(0.0) + 5.0).min(86_400.0))
}

/// When the camera exposes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Trigger {
    /// One frame after another.
    #[default]
    FreeRun,
    /// One frame for each [`FrameStream::trigger`].
    Software,
}

/// An automatic function, and what became of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Automatic {
    /// GenICam name.
    pub feature: String,
    /// What it was.
    pub before: String,
    /// What it reads now.
    pub now: String,
    /// Whether it no longer touches the image.
    pub off: bool,
}

/// How a stream is set up.
#[derive(Debug, Clone, PartialEq)]
pub struct StreamOptions {
    /// Frames held ready for the camera to fill.
    pub buffers: usize,
    /// Whole frames that may wait to be taken: one more, and the oldest is dropped and counted. `None`: all
    /// wait, and a frame that finds no free buffer is an underrun. Keep it below `buffers`, so that one is
    /// always free.
    pub waiting: Option<usize>,
    /// GigE Vision: bytes of a packet; `None` negotiates the largest that passes.
    pub packet_size: Option<u32>,
    /// GigE Vision: whether lost packets are asked for again.
    pub packet_resend: bool,
    /// GigE Vision: time until a packet counts as lost.
    pub packet_timeout: Duration,
    /// GigE Vision: time until an unfinished frame is given up.
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

/// What a stream counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct StreamCounts {
    /// Whole frames handed out.
    pub completed: u64,
    /// Frames that arrived damaged or in part.
    pub failures: u64,
    /// Frames for which no buffer was free.
    pub underruns: u64,
    /// Whole frames that waited too long and made room for newer ones ([`StreamOptions::waiting`]).
    #[serde(default)]
    pub dropped: u64,
    /// Frames that the camera's numbers, or its clock after an interval without it, say were taken and of
    /// which nothing else is known.
    pub missing: u64,
    /// Number of whole frames whose number had come before. They are discarded, and none of them is lost.
    #[serde(default)]
    pub repeated: u64,
}

impl StreamCounts {
    /// Frames that did not come through: damaged, dropped, without a buffer, or never seen.
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

/// What went wrong with a camera.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// No such camera.
    #[error("camera {camera}: {message}")]
    Absent {
        /// What was asked for.
        camera: String,
        /// What was found instead, and what to do.
        message: String,
    },
    /// It was there and no longer answers.
    #[error("camera {camera} was lost: {message}")]
    Lost {
        /// Which camera.
        camera: String,
        /// How that was noticed.
        message: String,
    },
    /// A recording has no more frames.
    #[error("camera {camera}: {message}")]
    Ended {
        /// Which camera.
        camera: String,
        /// Under which settings there are no more.
        message: String,
    },
    /// It has no such feature.
    #[error("camera {camera} has no {feature}")]
    NotAvailable {
        /// Which camera.
        camera: String,
        /// Which feature.
        feature: String,
    },
    /// The value lies outside what the camera takes.
    #[error("camera {camera}: {feature} = {value} {unit} lies outside {min} to {max} {unit}")]
    OutOfRange {
        /// Which camera.
        camera: String,
        /// Which feature.
        feature: String,
        /// What was asked for.
        value: f64,
        /// Smallest value.
        min: f64,
        /// Largest value.
        max: f64,
        /// Unit of the three.
        unit: &'static str,
    },
    /// The camera took another value than the one asked for.
    #[error("camera {camera}: {feature} was set to {asked} and reads {got}")]
    ReadBack {
        /// Which camera.
        camera: String,
        /// Which feature.
        feature: String,
        /// With its unit.
        asked: String,
        /// With its unit.
        got: String,
    },
    /// No frame came.
    #[error("camera {camera}: no frame within {seconds:.1} s ({counts})")]
    Timeout {
        /// Which camera.
        camera: String,
        /// How long was waited.
        seconds: f64,
        /// What did come.
        counts: String,
    },
    /// The backend refused.
    #[error("camera {camera}: {feature}: {message}")]
    Backend {
        /// Which camera.
        camera: String,
        /// Feature or action.
        feature: String,
        /// What it said.
        message: String,
    },
}

/// A frame as it came, before it is unpacked.
#[derive(Debug, Clone, Copy)]
pub struct Arrived<'a> {
    /// Its pixels row by row, as they came over the wire.
    pub bytes: &'a [u8],
    /// What the bytes mean.
    pub format: PixelFormat,
    /// Columns and rows.
    pub size: (usize, usize),
    /// As [`Frame::id`].
    pub id: u64,
    /// As [`Frame::timestamp_ns`].
    pub timestamp_ns: Option<u64>,
    /// Time since its first packet came, where that is known.
    pub age: Option<Duration>,
}

/// A running acquisition. Dropping it stops the camera.
pub trait FrameStream {
    /// Waits for the next frame and fills `frame` with it, without a new allocation where the size fits.
    ///
    /// A damaged frame is handed out with its status and counted; it must not be used.
    ///
    /// # Errors
    ///
    /// [`CameraError::Timeout`] where no frame came in time, [`CameraError::Lost`] where the camera is gone.
    fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<(), CameraError>;

    /// Waits for the next frame and shows its bytes to `take` where they are, without a copy. A damaged frame
    /// is counted and comes as its reason. A backend whose frames do not come as bytes uses `memory`.
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

    /// Asks for one frame, with [`Trigger::Software`].
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] without a software trigger.
    fn trigger(&mut self) -> Result<(), CameraError>;

    /// What was counted so far.
    fn counts(&self) -> StreamCounts;
}

/// A camera.
///
/// Setters return what the camera then reports, which may be the nearest value that it can take.
pub trait Camera: Send {
    /// Who it is.
    fn identity(&self) -> &Identity;

    /// What it can do.
    fn capabilities(&self) -> &Capabilities;

    /// Reads every setting back.
    ///
    /// # Errors
    ///
    /// [`CameraError::Lost`] or what the camera refuses to tell.
    fn settings(&mut self) -> Result<Settings, CameraError>;

    /// Sets the exposure, s.
    ///
    /// # Errors
    ///
    /// [`CameraError::OutOfRange`], or what the camera refuses.
    fn set_exposure_s(&mut self, value: f64) -> Result<f64, CameraError>;

    /// Sets the gain, dB.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] where it has no such setting, [`CameraError::OutOfRange`], or what it
    /// refuses.
    fn set_gain_db(&mut self, _value: f64) -> Result<f64, CameraError> {
        Err(self.not_available("Gain"))
    }

    /// Sets the black level, DN.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] where it has no such setting, [`CameraError::OutOfRange`], or what it
    /// refuses.
    fn set_black_level_dn(&mut self, _value: f64) -> Result<f64, CameraError> {
        Err(self.not_available("BlackLevel"))
    }

    /// Sets the frame rate, 1/s.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] where it has no such setting, [`CameraError::OutOfRange`], or what it
    /// refuses.
    fn set_frame_rate_hz(&mut self, _value: f64) -> Result<f64, CameraError> {
        Err(self.not_available("AcquisitionFrameRate"))
    }

    /// Sets the pixel format.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] where it has no such format, or what it refuses.
    fn set_pixel_format(&mut self, format: PixelFormat) -> Result<PixelFormat, CameraError>;

    /// Sets the region of interest.
    ///
    /// # Errors
    ///
    /// [`CameraError::OutOfRange`], or what the camera refuses.
    fn set_region(&mut self, region: Region) -> Result<Region, CameraError>;

    /// Sets when the camera exposes.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] where it has no such trigger.
    fn set_trigger(&mut self, trigger: Trigger) -> Result<(), CameraError> {
        match trigger {
            Trigger::FreeRun => Ok(()),
            Trigger::Software => Err(self.not_available("TriggerSoftware")),
        }
    }

    /// Switches off what distorts radiometry, reads each setting back and tells what became of it.
    ///
    /// # Errors
    ///
    /// What the camera refuses to tell; what cannot be switched off is no error.
    fn disable_automatics(&mut self) -> Result<Vec<Automatic>, CameraError> {
        Ok(Vec::new())
    }

    /// Whether there is a feature of this GenICam name.
    fn has_feature(&mut self, _name: &str) -> bool {
        false
    }

    /// Sets a feature by its GenICam name and reads it back.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] where it has no such feature, or what it refuses.
    fn set_feature(&mut self, name: &str, _value: &Value) -> Result<Value, CameraError> {
        Err(self.not_available(name))
    }

    /// Reads a feature by its GenICam name.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] where it has no such feature, or what it refuses.
    fn feature(&mut self, name: &str) -> Result<Value, CameraError> {
        Err(self.not_available(name))
    }

    /// Executes a command by its GenICam name.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] where it has no such command, or what it refuses.
    fn execute(&mut self, command: &str) -> Result<(), CameraError> {
        Err(self.not_available(command))
    }

    /// Largest value of a feature that is a number.
    fn largest(&mut self, _name: &str) -> Option<f64> {
        None
    }

    /// Files in the camera that may be written or read (SFNC, File Access Control).
    fn files(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// Writes a file into the camera. `go_on` hears how many bytes are done, and ends it by false: what is
    /// then in the file is the camera's own choice.
    ///
    /// # Errors
    ///
    /// [`CameraError::NotAvailable`] where it has no such file, or what it refuses.
    fn write_file(
        &mut self,
        name: &str,
        _bytes: &[u8],
        _go_on: &mut dyn FnMut(usize) -> bool,
    ) -> Result<(), CameraError> {
        Err(self.not_available(name))
    }

    /// Reads a file of the camera, at most so many bytes of it.
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

    /// Settings worth keeping beside a capture, by GenICam name; of a feature that several entries of a
    /// selector share `Name[Entry]`.
    fn features(&mut self) -> BTreeMap<String, Value> {
        BTreeMap::new()
    }

    /// Features of which [`crate::features::role`] knows nothing and whose names speak of radiometry.
    fn unlisted_features(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// Whether it draws the same frames again from its first on: a campaign is then gone on with by drawing
    /// once more what is on disk.
    fn draws_again(&self) -> bool {
        false
    }

    /// Told before a campaign is continued: so many frames were taken, the last of them at this time, s. A
    /// simulated camera must not draw the same noise twice. Whether the camera's clock shows campaign time
    /// from now.
    fn continue_after(&mut self, _frames: u64, _time_s: f64) -> bool {
        false
    }

    /// Says which frame a simulated camera draws next, and its time, s: its noise then follows from the place
    /// of the frame in a campaign. `false`: a camera that cannot be told.
    fn draw_from(&mut self, _frame: u64, _time_s: f64) -> bool {
        false
    }

    /// The simulated bench before it, which drives its light; `None`: a real one.
    fn shared_bench(&self) -> Option<sim::SharedBench> {
        None
    }

    /// Photons per pixel per second that its own bench gives at illumination 1, where it says so: a simulated
    /// or served camera.
    fn photon_flux_per_s(&mut self) -> Option<f64> {
        None
    }

    /// Starts the acquisition.
    ///
    /// # Errors
    ///
    /// What the camera refuses, or that no stream can be set up.
    fn stream(&mut self, options: &StreamOptions) -> Result<Box<dyn FrameStream + '_>, CameraError>;

    /// The error for what this camera has not.
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
    // A hair beyond the end is rounding, not a wish.
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
