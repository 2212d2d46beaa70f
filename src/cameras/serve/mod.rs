//! The simulator as a GigE Vision camera on the network.
//!
//! Any GenICam client can drive it: exposure, gain, black level, region and format change the physics, and
//! the features `BenchIllumination`, `BenchDark`, `BenchConfiguration`, `BenchScene` and `DeviceTemperature`
//! move the bench.
//!
//! Image processing of real cameras is available and off by default ([`processing::Processing`]). A feature
//! can be stuck, as in some firmware, and exposure, gain and black level can have the names of older cameras
//! ([`Options`]).
//!
//! The clock is simulated: timestamps grow by exposure and read-out time, while frames arrive as fast as
//! `AcquisitionFrameRate` allows. Frame n since the start shows the noise of frame number n. `BenchFrame` and
//! `BenchTime` set number and time of the next frame.

mod description;
mod files;
pub mod gige;
pub mod processing;
pub mod relay;

use crate::bench::BenchState;
use crate::camera::sim::{formats_of, narrow};
use crate::frame::Region;
use crate::pixel_format::PixelFormat;
use gige::{Initial, Painter, Registers, Request, VirtualCamera, address};
use processing::{Pattern, Processing};
use radcam_sim::{Conditions, Model, Scene, Sensor};
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// Own registers, behind those of the fake camera and the bootstrap registers.
mod register {
    pub const EXPOSURE_US: u32 = 0x8000;
    pub const GAIN_DB: u32 = 0x8008;
    pub const BLACK_LEVEL: u32 = 0x8010;
    pub const TEMPERATURE_C: u32 = 0x8018;
    pub const ILLUMINATION: u32 = 0x8020;
    pub const DARK: u32 = 0x8028;
    pub const CONFIGURATION: u32 = 0x802C;
    pub const SCENE: u32 = 0x8030;
    pub const BINNING_HORIZONTAL: u32 = 0x8040;
    pub const BINNING_VERTICAL: u32 = 0x8044;
    pub const GAMMA: u32 = 0x8048;
    pub const LUT: u32 = 0x8050;
    pub const SHARPENING: u32 = 0x8054;
    pub const DEFECTS: u32 = 0x8058;
    pub const PATTERN: u32 = 0x805C;
    pub const EXPOSURE_RAW: u32 = 0x8060;
    pub const GAIN_RAW: u32 = 0x8064;
    pub const BLACK_RAW: u32 = 0x8068;
    pub const EXPOSURE_BASE_US: u32 = 0x8070;
    pub const PHOTON_FLUX: u32 = 0x8078;
    pub const FLAT_FIELD: u32 = 0x8080;
    pub const FILE_SELECTOR: u32 = 0x8084;
    pub const FILE_OPERATION: u32 = 0x8088;
    pub const FILE_EXECUTE: u32 = 0x808C;
    pub const FILE_OPEN_MODE: u32 = 0x8090;
    pub const FILE_OFFSET: u32 = 0x8094;
    pub const FILE_LENGTH: u32 = 0x8098;
    pub const FILE_STATUS: u32 = 0x809C;
    pub const FILE_RESULT: u32 = 0x80A0;
    pub const FILE_SIZE: u32 = 0x80A4;
    pub const DEFECT_COUNT: u32 = 0x80A8;
    pub const DEFECT_INDEX: u32 = 0x80AC;
    /// Writing 1 takes over the list; 2: taken over; 0: no list.
    pub const DEFECT_APPLY: u32 = 0x80B0;
    /// Number of the next frame, the seed of its noise.
    pub const FRAME: u32 = 0x80B4;
    /// Time of the next frame, s.
    pub const TIME_S: u32 = 0x80B8;
    /// Column and row of each defect, 4 bytes each.
    pub const DEFECT_LIST: u32 = 0x9000;
    pub const FILE_BUFFER: u32 = 0xA000;
}

/// Names of exposure, gain and black level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Names {
    /// `ExposureTime`, `Gain`, `BlackLevel` (SFNC 2).
    #[default]
    Current,
    /// `ExposureTimeAbs`, `GainAbs`, `BlackLevelRaw` (SFNC 1).
    Abs,
    /// `ExposureTimeRaw` in steps of `ExposureTimeBaseAbs`, `GainRaw`, `BlackLevelRaw`.
    Raw,
}

/// `ExposureTimeBaseAbs`, us, as in a Basler piA640.
const EXPOSURE_BASE_US: f64 = 20.0;
/// `GainRaw` counts tenths of a dB.
const GAIN_STEP_DB: f64 = 0.1;

/// Options of a served camera.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Options {
    /// Names of exposure, gain and black level.
    pub names: Names,
    /// Read-only features of [`processing`] with their values, as text.
    pub stuck: Vec<(String, String)>,
}

/// Step of the region's width and height: the rows of every packed format end on a byte.
const SIZE_STEP: u32 = 4;

/// Reason why a camera cannot be served.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// Network error.
    #[error("virtual camera on {interface}: {message}")]
    Network {
        /// Address of the interface.
        interface: IpAddr,
        /// Reason.
        message: String,
    },
    /// Invalid sensor model.
    #[error(transparent)]
    Model(#[from] radcam_sim::ModelError),
    /// Invalid options.
    #[error("{0}")]
    Options(String),
}

/// A camera being served; it stops when dropped.
pub struct Served {
    // Dropped before the camera, whose files it keeps.
    _files: files::Keeper,
    camera: VirtualCamera,
}

impl Served {
    /// Drops this share of the packets, 0 to 1.
    pub fn set_lost_packets(&self, share: f64) {
        self.camera.set_lost_packets(share);
    }

    /// Returns the number of control requests refused or dropped.
    pub fn refused(&self) -> u64 {
        self.camera.refused()
    }
}

/// Serves a sensor on an interface, named by its IPv4 address.
///
/// # Errors
///
/// The interface cannot be bound, or an option has an invalid value.
pub fn serve(
    sensor: Arc<Sensor>,
    interface: IpAddr,
    serial: &str,
    options: &Options,
) -> Result<Served, ServeError> {
    let model = sensor.model().clone();
    let mut processing = Processing::default();
    for (name, value) in &options.stuck {
        processing.set(name, value).map_err(ServeError::Options)?;
    }
    let xml = description::of(&model, options);
    let files = files::Files::default();
    let painter = Artist::new(sensor, options.names, files.clone());
    let mut initial = Initial::default();
    set_up(&model, &mut initial);
    processing.write(&mut initial);
    let camera = VirtualCamera::start(interface, serial, &xml, Box::new(painter), initial)?;
    let _files = files::Keeper::start(
        camera.registers(),
        files,
        (size(model.camera.width), size(model.camera.height)),
    );
    Ok(Served { _files, camera })
}

/// Returns the pixel format at start: the deepest, unpacked.
fn native_format(bit_depth: u8) -> u32 {
    let formats = formats_of(bit_depth);
    formats.iter().max_by_key(|f| (f.bits(), f.bits_per_pixel())).map_or(0, |f| f.code())
}

fn size(pixels: u32) -> u32 {
    (pixels / SIZE_STEP * SIZE_STEP).max(1)
}

fn set_up(model: &Model, r: &mut Initial) {
    let body = &model.camera;
    r.set_text(address::VENDOR, 32, &body.vendor);
    r.set_text(address::MODEL, 32, &body.model);
    r.set_text(address::VERSION, 32, env!("CARGO_PKG_VERSION"));
    r.set_u32(address::SENSOR_WIDTH, size(body.width));
    r.set_u32(address::SENSOR_HEIGHT, size(body.height));
    r.set_u32(address::WIDTH, size(body.width));
    r.set_u32(address::HEIGHT, size(body.height));
    r.set_u32(address::PIXEL_FORMAT, native_format(body.bit_depth));
    r.set_u32(address::FRAME_PERIOD_US, 10_000);
    r.limit(address::WIDTH, 1, size(body.width));
    r.limit(address::HEIGHT, 1, size(body.height));
    r.limit(address::OFFSET_X, 0, size(body.width));
    r.limit(address::OFFSET_Y, 0, size(body.height));
    // 1000 to 0.1 frames per second, as in the description.
    r.limit(address::FRAME_PERIOD_US, 1000, 10_000_000);
    for at in [register::PHOTON_FLUX, register::EXPOSURE_BASE_US] {
        r.fix(at, 8);
    }
    r.set_f64(register::TIME_S, 1.0);
    let exposure_us = 1e6 * 0.01_f64.clamp(body.exposure_min_s, body.exposure_max_s);
    r.set_f64(register::EXPOSURE_US, exposure_us);
    r.set_f64(register::EXPOSURE_BASE_US, EXPOSURE_BASE_US);
    r.set_u32(register::EXPOSURE_RAW, (exposure_us / EXPOSURE_BASE_US).ceil() as u32);
    r.set_u32(register::GAIN_RAW, 0);
    r.set_u32(register::BLACK_RAW, model.base.black_level_dn.round() as u32);
    r.set_f64(register::GAIN_DB, 0.0);
    r.set_f64(register::BLACK_LEVEL, model.base.black_level_dn);
    r.set_f64(register::TEMPERATURE_C, model.base.dark_reference_c);
    r.set_f64(register::ILLUMINATION, 1.0);
    r.set_f64(register::PHOTON_FLUX, model.bench.photon_flux_per_s);
    r.set_u32(register::DARK, 0);
    r.set_u32(register::CONFIGURATION, 0);
    r.set_u32(register::SCENE, 0);
}

/// Entries of `BenchScene`.
const SCENES: [(&str, u32, Scene); 3] =
    [("Card", 0, Scene::Card), ("Patch", 1, Scene::Patch), ("Chart", 2, Scene::Chart)];

/// Reads the conditions from the registers.
fn conditions(sensor: &Sensor, names: Names, r: &Registers) -> Conditions {
    let body = &sensor.model().camera;
    let exposure_us = match names {
        Names::Current | Names::Abs => r.f64(register::EXPOSURE_US),
        Names::Raw => f64::from(r.u32(register::EXPOSURE_RAW)) * EXPOSURE_BASE_US,
    };
    let gain_db = match names {
        Names::Current | Names::Abs => r.f64(register::GAIN_DB),
        Names::Raw => f64::from(r.u32(register::GAIN_RAW)) * GAIN_STEP_DB,
    };
    let black_level_dn = match names {
        Names::Current => r.f64(register::BLACK_LEVEL),
        Names::Abs | Names::Raw => f64::from(r.u32(register::BLACK_RAW)),
    };
    let sound = |x: f64, min: f64, max: f64, or: f64| if x.is_finite() { x.clamp(min, max) } else { or };
    let exposure_s = sound(exposure_us * 1e-6, body.exposure_min_s, body.exposure_max_s, body.exposure_min_s);
    let dark = r.u32(register::DARK) != 0;
    let bench = BenchState {
        illumination: if dark { 0.0 } else { sound(r.f64(register::ILLUMINATION), 0.0, 1e6, 0.0) },
        configuration: r.u32(register::CONFIGURATION),
        scene: SCENES.iter().find(|(_, n, _)| *n == r.u32(register::SCENE)).map_or(Scene::Card, |s| s.2),
    };
    let full_scale = f64::from(sensor.model().full_scale_dn());
    Conditions {
        exposure_s,
        illumination: bench.illumination,
        configuration: bench.configuration,
        scene: bench.scene,
        temperature_c: sound(r.f64(register::TEMPERATURE_C), -273.0, 200.0, 25.0),
        gain_db: sound(gain_db, 0.0, body.gain_max_db, 0.0),
        black_level_dn: sound(black_level_dn, 0.0, full_scale, 0.0),
        time_s: 0.0,
    }
}

/// Contents of a frame.
#[derive(Debug, Clone, PartialEq)]
struct Job {
    number: u64,
    conditions: Conditions,
    /// Region in output (binned) pixels.
    region: Region,
    processing: Processing,
    memory: files::Memory,
}

/// Paints frames; a thread draws the next one ahead.
struct Artist {
    sensor: Arc<Sensor>,
    names: Names,
    jobs: SyncSender<(Job, Vec<u16>)>,
    done: Receiver<(Job, Vec<u16>)>,
    /// True while a frame is drawn ahead.
    ahead: bool,
    /// Frame memory not in use.
    spare: Vec<u16>,
    files: files::Files,
    memory: files::Memory,
}

impl Artist {
    fn new(sensor: Arc<Sensor>, names: Names, files: files::Files) -> Self {
        let (jobs, inbox) = sync_channel::<(Job, Vec<u16>)>(1);
        let (outbox, done) = sync_channel(1);
        let painter = Arc::clone(&sensor);
        // The thread ends when either channel closes.
        std::thread::spawn(move || {
            while let Ok((job, mut dn)) = inbox.recv() {
                draw(&painter, &job, &mut dn);
                if outbox.send((job, dn)).is_err() {
                    break;
                }
            }
        });
        let (spare, memory) = (Vec::new(), files::Memory::default());
        Self { sensor, names, jobs, done, ahead: false, spare, files, memory }
    }
}

fn draw(sensor: &Sensor, job: &Job, dn: &mut Vec<u16>) {
    let Region { x, y, width, height } = job.region;
    let (across, down) = job.processing.binning;
    let whole = Region { x: x * across, y: y * down, width: width * across, height: height * down };
    if job.processing.pattern == Pattern::Number {
        dn.resize(width as usize * height as usize, 0);
        // The number wraps, as in a camera that runs for years.
        processing::numbered(job.number as u32, sensor.model().full_scale_dn(), dn);
        return;
    }
    dn.resize(whole.width as usize * whole.height as usize, 0);
    sensor.draw(job.number, &job.conditions, whole, dn);
    job.processing.apply(dn, whole, sensor.model().full_scale_dn(), &job.memory);
}

impl Painter for Artist {
    fn paint(&mut self, registers: &Registers, request: Request, frame: &mut [u8]) -> u64 {
        let number = registers.u32(register::FRAME);
        let time_s = Some(registers.f64(register::TIME_S)).filter(|t| (0.0..1e9).contains(t)).unwrap_or(1.0);
        let now_ns = (time_s * 1e9).round() as u64;
        let body = &self.sensor.model().camera;
        let (bit_depth, readout_s) = (body.bit_depth, body.readout_s);
        let processing = Processing::read(registers);
        let [x, y, width, height] = request.region;
        let (wide, high) = processing.binned(self.sensor.region());
        let inside = u64::from(x) + u64::from(width) <= u64::from(wide)
            && u64::from(y) + u64::from(height) <= u64::from(high);
        if !inside {
            // As in cameras when binning shrinks the image: the region is limited to the rest from now on.
            registers.set_u32(address::OFFSET_X, 0);
            registers.set_u32(address::OFFSET_Y, 0);
            registers.set_u32(address::WIDTH, width.min(size(wide)));
            registers.set_u32(address::HEIGHT, height.min(size(high)));
        }
        let (true, Ok(format)) = (inside, PixelFormat::from_code(request.format)) else {
            tracing::warn!(
                ?request,
                "a client asked for a frame that the sensor has not; it gets a black one"
            );
            return now_ns;
        };
        let conditions =
            Conditions { time_s: time_s - 1.0, ..conditions(&self.sensor, self.names, registers) };
        let region = Region { x, y, width, height };
        self.memory.refresh(&self.files, registers, self.sensor.region());
        let memory = self.memory.clone();
        let job = Job { number: number.into(), conditions, region, processing, memory };

        let mut dn = std::mem::take(&mut self.spare);
        let mut ready = false;
        if self.ahead
            && let Ok((drawn, memory)) = self.done.recv()
        {
            self.ahead = false;
            ready = drawn == job;
            dn = memory;
        }
        if !ready {
            draw(&self.sensor, &job, &mut dn);
        }
        narrow(&mut dn, bit_depth, format.bits());
        if format.pack(&dn, frame).is_err() {
            tracing::warn!(%format, "frame memory of another size than the format needs; a black frame goes out");
        }
        let next_s = time_s + conditions.exposure_s + readout_s;
        registers.set_u32(register::FRAME, number.wrapping_add(1));
        registers.set_f64(register::TIME_S, next_s);
        // The next frame is most likely requested under the same conditions.
        let conditions = Conditions { time_s: next_s - 1.0, ..conditions };
        let next = Job { number: number.wrapping_add(1).into(), conditions, ..job };
        if !self.sensor.model().effects.is_empty() {
            // Effects may depend on the previous frame: no frame may be drawn unrequested.
            self.spare = dn;
            return now_ns;
        }
        match self.jobs.try_send((next, dn)) {
            Ok(()) => self.ahead = true,
            Err(std::sync::mpsc::TrySendError::Full((_, memory)))
            | Err(std::sync::mpsc::TrySendError::Disconnected((_, memory))) => self.spare = memory,
        }
        now_ns
    }
}
