//! Register space of a served camera, big endian.

use std::net::Ipv4Addr;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Registers of every served camera: bootstrap registers (GigE Vision 2.0, chapter 28), and where the
/// standard leaves the address open, those of Aravis's fake camera, so that clients written for that one
/// work.
pub mod address {
    /// IPv4 address of the camera.
    pub const CURRENT_IP: u32 = 0x24;
    /// Manufacturer, 32 bytes of text.
    pub const VENDOR: u32 = 0x48;
    /// Model, 32 bytes of text.
    pub const MODEL: u32 = 0x68;
    /// Device version, 32 bytes of text.
    pub const VERSION: u32 = 0x88;
    /// Manufacturer info, 48 bytes of text.
    pub const ABOUT: u32 = 0xa8;
    /// Serial number, 16 bytes of text.
    pub const SERIAL: u32 = 0xd8;
    /// Columns of the region.
    pub const WIDTH: u32 = 0x100;
    /// Rows of the region.
    pub const HEIGHT: u32 = 0x104;
    /// Rows of the sensor.
    pub const SENSOR_HEIGHT: u32 = 0x118;
    /// Columns of the sensor.
    pub const SENSOR_WIDTH: u32 = 0x11c;
    /// 1 while an acquisition runs.
    pub const ACQUISITION: u32 = 0x124;
    /// PFNC code.
    pub const PIXEL_FORMAT: u32 = 0x128;
    /// Acquisition mode: 1 is continuous; other values are treated as continuous.
    pub const ACQUISITION_MODE: u32 = 0x12c;
    /// First column of the region.
    pub const OFFSET_X: u32 = 0x130;
    /// First row of the region.
    pub const OFFSET_Y: u32 = 0x134;
    /// Period of the frames, microseconds.
    pub const FRAME_PERIOD_US: u32 = 0x138;
    /// URL of the description file, 512 bytes of text of which the first half is used.
    pub const XML_URL: u32 = 0x200;
    /// 1 if frames wait for a trigger.
    pub const TRIGGER_MODE: u32 = 0x300;
    /// 1 for the software trigger.
    pub const TRIGGER_SOURCE: u32 = 0x304;
    /// Writing 1 triggers a frame.
    pub const TRIGGER_SOFTWARE: u32 = 0x30c;
    /// Network interfaces.
    pub const INTERFACES: u32 = 0x600;
    /// Stream channels.
    pub const STREAM_CHANNELS: u32 = 0x904;
    /// Heartbeat timeout, ms: a client without a request for this time loses control.
    pub const HEARTBEAT_MS: u32 = 0x938;
    /// Ticks of the device clock per second, 64 bits.
    pub const TICK_FREQUENCY: u32 = 0x93c;
    /// Control channel privilege: nonzero while a client has control.
    pub const PRIVILEGE: u32 = 0xa00;
    /// Destination port of frames.
    pub const STREAM_PORT: u32 = 0xd00;
    /// Packet size including IP and UDP headers, in the lower half.
    pub const PACKET_SIZE: u32 = 0xd04;
    /// Destination address of frames.
    pub const STREAM_ADDRESS: u32 = 0xd18;
    /// Source port of frames.
    pub const SOURCE_PORT: u32 = 0xd1c;
}

/// Size of the register space, bytes; the description file follows.
pub const REGISTER_SPACE: u32 = 0x1_0000;
/// Padding of the description file, bytes: a multiple of the longest read (Aravis reads 512 bytes at once).
const XML_STEP: usize = 512;

/// Minimum packet size: every GigE Vision device takes 576 bytes (GigE Vision 2.0, 28.33: the size that IPv4
/// guarantees).
pub const MIN_PACKET: u32 = 576;
/// Heartbeat timeout after power-on, ms (GigE Vision 2.0, 28.17).
const HEARTBEAT_MS: u32 = 3000;
/// Packet size after power-on, bytes: fits Ethernet.
const PACKET_SIZE: u32 = 1400;

struct Inside {
    bytes: Mutex<Vec<u8>>,
    changed: Condvar,
    acquisitions: AtomicU64,
    /// Lock held while a frame is painted and sent, and while a client's request writes.
    turn: Mutex<()>,
    /// Write requests waiting for the lock.
    writers: AtomicU64,
}

/// Registers of a camera, shared by its threads.
#[derive(Clone)]
pub struct Registers(Arc<Inside>);

impl Registers {
    pub(super) fn lock(&self) -> MutexGuard<'_, Vec<u8>> {
        // No code under this lock panics halfway, so a poisoned lock is still consistent.
        self.0.bytes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads bytes; zeros if the range exceeds the register space and the description.
    pub fn read(&self, address: u32, into: &mut [u8]) {
        into.fill(0);
        if let Some(from) =
            range(address, into.len()).and_then(|range| self.lock().get(range).map(<[u8]>::to_vec))
        {
            into.copy_from_slice(&from);
        }
    }

    /// Writes bytes; nothing if the range exceeds the register space.
    pub fn write(&self, address: u32, bytes: &[u8]) {
        let inside = range(address, bytes.len()).filter(|r| r.end <= REGISTER_SPACE as usize);
        if let Some(range) = inside
            && let Some(into) = self.lock().get_mut(range)
        {
            into.copy_from_slice(bytes);
        }
        self.wake();
    }

    /// Reads a 32-bit register.
    pub fn u32(&self, address: u32) -> u32 {
        let mut bytes = [0; 4];
        self.read(address, &mut bytes);
        u32::from_be_bytes(bytes)
    }

    /// Writes a 32-bit register.
    pub fn set_u32(&self, address: u32, value: u32) {
        self.write(address, &value.to_be_bytes());
    }

    /// Reads a 64-bit floating-point register.
    pub fn f64(&self, address: u32) -> f64 {
        let mut bytes = [0; 8];
        self.read(address, &mut bytes);
        f64::from_be_bytes(bytes)
    }

    /// Writes a 64-bit floating-point register.
    pub fn set_f64(&self, address: u32, value: f64) {
        self.write(address, &value.to_be_bytes());
    }

    /// Returns the number of acquisitions started by clients.
    pub(super) fn acquisitions(&self) -> u64 {
        self.0.acquisitions.load(Ordering::Relaxed)
    }

    /// Counts the start of an acquisition by a client.
    pub(super) fn begin(&self) {
        self.0.acquisitions.fetch_add(1, Ordering::Relaxed);
        self.wake();
    }

    /// Waits until no frame is in progress: each frame sees one state of the registers, and none is in
    /// progress once its end was acknowledged.
    pub(super) fn turn_to_write(&self) -> MutexGuard<'_, ()> {
        self.0.writers.fetch_add(1, Ordering::Relaxed);
        let turn = self.0.turn.lock().unwrap_or_else(PoisonError::into_inner);
        self.0.writers.fetch_sub(1, Ordering::Relaxed);
        turn
    }

    /// Waits for pending write requests. They have priority, so that a camera permanently behind its frame
    /// rate still obeys.
    pub(super) fn turn_to_paint(&self) -> MutexGuard<'_, ()> {
        while self.0.writers.load(Ordering::Relaxed) > 0 {
            std::thread::sleep(Duration::from_micros(50));
        }
        self.0.turn.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Wakes all threads waiting for a change.
    pub(super) fn wake(&self) {
        self.0.changed.notify_all();
    }

    /// Waits until `over` is true or the time is up.
    pub(super) fn wait(&self, time: Duration, over: impl Fn(&[u8]) -> bool) {
        let bytes = self.lock();
        let waited = self.0.changed.wait_timeout_while(bytes, time, |bytes| !over(bytes));
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}

/// Reads a 32-bit register from locked bytes.
pub(super) fn word(bytes: &[u8], address: u32) -> u32 {
    let word = range(address, 4).and_then(|range| bytes.get(range)?.try_into().ok());
    word.map_or(0, u32::from_be_bytes)
}

fn range(address: u32, bytes: usize) -> Option<Range<usize>> {
    let from = address as usize;
    Some(from..from.checked_add(bytes)?)
}

/// Bounds of values that clients may write into a 32-bit register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limit {
    /// Address of the register.
    pub address: u32,
    /// Mask of the checked bits.
    pub mask: u32,
    /// Smallest value.
    pub min: u32,
    /// Largest value.
    pub max: u32,
}

/// Rules for register writes by clients.
#[derive(Debug, Clone, Default)]
pub struct Rules {
    /// Read-only address ranges.
    pub fixed: Vec<Range<u32>>,
    /// Registers with bounds.
    pub limits: Vec<Limit>,
}

/// Initial register values, and the rules for client writes.
#[derive(Debug, Clone, Default)]
pub struct Initial {
    values: Vec<(u32, Vec<u8>)>,
    rules: Rules,
}

impl Initial {
    /// Sets a 32-bit register.
    pub fn set_u32(&mut self, address: u32, value: u32) {
        self.values.push((address, value.to_be_bytes().into()));
    }

    /// Sets a 64-bit floating-point register.
    pub fn set_f64(&mut self, address: u32, value: f64) {
        self.values.push((address, value.to_be_bytes().into()));
    }

    /// Sets a text field of `field` bytes, truncated and padded with zeros.
    pub fn set_text(&mut self, address: u32, field: usize, text: &str) {
        let mut bytes = vec![0; field];
        let length = text.len().min(field.saturating_sub(1));
        bytes[..length].copy_from_slice(&text.as_bytes()[..length]);
        self.values.push((address, bytes));
    }

    /// Bounds the values that clients may write into a register.
    pub fn limit(&mut self, address: u32, min: u32, max: u32) {
        self.rules.limits.push(Limit { address, mask: u32::MAX, min, max });
    }

    /// Makes a register of `bytes` bytes read-only for clients.
    pub fn fix(&mut self, address: u32, bytes: u32) {
        self.rules.fixed.push(address..address + bytes);
    }

    /// Builds the registers in their power-on state.
    pub(super) fn build(
        mut self,
        own: Ipv4Addr,
        source_port: u16,
        serial: &str,
        xml: &str,
    ) -> (Registers, Rules) {
        let mut bytes = vec![0; REGISTER_SPACE as usize];
        bytes.extend(xml.as_bytes());
        bytes.resize(bytes.len().next_multiple_of(XML_STEP), 0);
        let url = format!("Local:radcam.xml;{REGISTER_SPACE:x};{:x}", xml.len());
        let mut all = Self::default();
        all.set_u32(address::CURRENT_IP, own.into());
        all.set_text(address::ABOUT, 48, "none");
        all.set_text(address::SERIAL, 16, serial);
        all.set_text(address::XML_URL, 256, &url);
        for (at, value) in [
            (address::ACQUISITION_MODE, 1),
            (address::INTERFACES, 1),
            (address::STREAM_CHANNELS, 1),
            (address::HEARTBEAT_MS, HEARTBEAT_MS),
            (address::TICK_FREQUENCY + 4, 1_000_000_000),
            (address::PACKET_SIZE, PACKET_SIZE),
            (address::SOURCE_PORT, source_port.into()),
        ] {
            all.set_u32(at, value);
        }
        all.values.append(&mut self.values);
        for (at, value) in &all.values {
            if let Some(into) = range(*at, value.len()).and_then(|range| bytes.get_mut(range)) {
                into.copy_from_slice(value);
            }
        }
        let mut rules = self.rules;
        // Identity and description; counts, capabilities and clock; source port of the stream.
        rules.fixed.extend([
            0..address::WIDTH,
            address::SENSOR_HEIGHT..address::SENSOR_WIDTH + 4,
            address::XML_URL..address::TRIGGER_MODE,
            address::INTERFACES..address::HEARTBEAT_MS,
            address::TICK_FREQUENCY..address::TICK_FREQUENCY + 8,
            address::SOURCE_PORT..address::SOURCE_PORT + 4,
        ]);
        rules.limits.push(Limit {
            address: address::PACKET_SIZE,
            mask: 0xffff,
            min: MIN_PACKET,
            max: 0xffff,
        });
        rules.limits.push(Limit { address: address::STREAM_PORT, mask: u32::MAX, min: 0, max: 0xffff });
        let inside = Inside {
            bytes: Mutex::new(bytes),
            changed: Condvar::new(),
            acquisitions: AtomicU64::new(0),
            turn: Mutex::new(()),
            writers: AtomicU64::new(0),
        };
        (Registers(Arc::new(inside)), rules)
    }
}
