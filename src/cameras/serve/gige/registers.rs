//! The register space of a served camera, big endian, as clients read and write it.

use std::net::Ipv4Addr;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Registers that every served camera has: those of Aravis's fake camera where the standard leaves the
/// address open, so that clients written for that one work, and bootstrap registers (GigE Vision 2.0, chapter
/// 28).
pub mod address {
    /// IPv4 address of the camera.
    pub const CURRENT_IP: u32 = 0x24;
    /// Maker, 32 bytes of text.
    pub const VENDOR: u32 = 0x48;
    /// Model, 32 bytes of text.
    pub const MODEL: u32 = 0x68;
    /// Device version, 32 bytes of text.
    pub const VERSION: u32 = 0x88;
    /// Anything of the maker, 48 bytes of text.
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
    /// 1 continuous; others are taken for it.
    pub const ACQUISITION_MODE: u32 = 0x12c;
    /// First column of the region.
    pub const OFFSET_X: u32 = 0x130;
    /// First row of the region.
    pub const OFFSET_Y: u32 = 0x134;
    /// Period of the frames, microseconds.
    pub const FRAME_PERIOD_US: u32 = 0x138;
    /// Address of the description file, 512 bytes of text of which the first half is used.
    pub const XML_URL: u32 = 0x200;
    /// 1 where frames wait for a trigger.
    pub const TRIGGER_MODE: u32 = 0x300;
    /// 1 where the trigger is software's.
    pub const TRIGGER_SOURCE: u32 = 0x304;
    /// Writing 1 asks for a frame.
    pub const TRIGGER_SOFTWARE: u32 = 0x30c;
    /// Network interfaces.
    pub const INTERFACES: u32 = 0x600;
    /// Stream channels.
    pub const STREAM_CHANNELS: u32 = 0x904;
    /// Time without a request of the client after which it loses control, ms.
    pub const HEARTBEAT_MS: u32 = 0x938;
    /// Ticks of the device clock per second, 64 bits.
    pub const TICK_FREQUENCY: u32 = 0x93c;
    /// Control channel privilege: not 0 where a client has control.
    pub const PRIVILEGE: u32 = 0xa00;
    /// Port to which frames go.
    pub const STREAM_PORT: u32 = 0xd00;
    /// Packet size, with the headers of IP and UDP, in the lower half.
    pub const PACKET_SIZE: u32 = 0xd04;
    /// Address to which frames go.
    pub const STREAM_ADDRESS: u32 = 0xd18;
    /// Port from which frames come.
    pub const SOURCE_PORT: u32 = 0xd1c;
}

/// Bytes of register space; behind it lies the description file.
pub const REGISTER_SPACE: u32 = 0x1_0000;
/// The description file is filled up with zeros to a multiple of the longest read (Aravis reads 512 bytes at
/// once).
const XML_STEP: usize = 512;

/// Smallest packet: every GigE Vision device takes 576 bytes (GigE Vision 2.0, 28.33: the size that IPv4 grants).
pub const MIN_PACKET: u32 = 576;
/// Heartbeat timeout of a camera that was switched on, ms (GigE Vision 2.0, 28.17).
const HEARTBEAT_MS: u32 = 3000;
/// Packet size of a camera that was switched on: one that Ethernet takes.
const PACKET_SIZE: u32 = 1400;

struct Inside {
    bytes: Mutex<Vec<u8>>,
    changed: Condvar,
    acquisitions: AtomicU64,
    /// Held while a frame is painted and sent, and while a client's request writes.
    turn: Mutex<()>,
    /// Requests that wait for their turn.
    writers: AtomicU64,
}

/// Registers of a camera, shared by whoever answers, paints and keeps files.
#[derive(Clone)]
pub struct Registers(Arc<Inside>);

impl Registers {
    pub(super) fn lock(&self) -> MutexGuard<'_, Vec<u8>> {
        // Nothing in here panics half way.
        self.0.bytes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads bytes; zeros where the range leaves the register space and the description.
    pub fn read(&self, address: u32, into: &mut [u8]) {
        into.fill(0);
        if let Some(from) =
            range(address, into.len()).and_then(|range| self.lock().get(range).map(<[u8]>::to_vec))
        {
            into.copy_from_slice(&from);
        }
    }

    /// Writes bytes; nothing where the range leaves the register space.
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

    /// Acquisitions that clients have begun.
    pub(super) fn acquisitions(&self) -> u64 {
        self.0.acquisitions.load(Ordering::Relaxed)
    }

    /// A client begins one.
    pub(super) fn begin(&self) {
        self.0.acquisitions.fetch_add(1, Ordering::Relaxed);
        self.wake();
    }

    /// Waits until no frame is under way: one frame has one state of the registers, and none is under way
    /// once its end was acknowledged.
    pub(super) fn turn_to_write(&self) -> MutexGuard<'_, ()> {
        self.0.writers.fetch_add(1, Ordering::Relaxed);
        let turn = self.0.turn.lock().unwrap_or_else(PoisonError::into_inner);
        self.0.writers.fetch_sub(1, Ordering::Relaxed);
        turn
    }

    /// Waits for the requests that write. They go first: a camera that is always behind its frame rate obeys
    /// all the same.
    pub(super) fn turn_to_paint(&self) -> MutexGuard<'_, ()> {
        while self.0.writers.load(Ordering::Relaxed) > 0 {
            std::thread::sleep(Duration::from_micros(50));
        }
        self.0.turn.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Wakes whoever waits for a change.
    pub(super) fn wake(&self) {
        self.0.changed.notify_all();
    }

    /// Waits until `over` says so, or the time is up.
    pub(super) fn wait(&self, time: Duration, over: impl Fn(&[u8]) -> bool) {
        let bytes = self.lock();
        let waited = self.0.changed.wait_timeout_while(bytes, time, |bytes| !over(bytes));
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}

/// A 32-bit register of locked bytes.
pub(super) fn word(bytes: &[u8], address: u32) -> u32 {
    let word = range(address, 4).and_then(|range| bytes.get(range)?.try_into().ok());
    word.map_or(0, u32::from_be_bytes)
}

fn range(address: u32, bytes: usize) -> Option<Range<usize>> {
    let from = address as usize;
    Some(from..from.checked_add(bytes)?)
}

/// Values that clients may write into a 32-bit register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limit {
    /// Name of the register.
    pub address: u32,
    /// Bits that count.
    pub mask: u32,
    /// Smallest value.
    pub min: u32,
    /// Largest value.
    pub max: u32,
}

/// Registers that clients may write.
#[derive(Debug, Clone, Default)]
pub struct Rules {
    /// Ranges that nobody writes.
    pub fixed: Vec<Range<u32>>,
    /// Registers with bounds.
    pub limits: Vec<Limit>,
}

/// Values of the registers when the camera begins to answer, and the bits that clients may change.
#[derive(Debug, Clone, Default)]
pub struct Initial {
    values: Vec<(u32, Vec<u8>)>,
    rules: Rules,
}

impl Initial {
    /// A 32-bit register.
    pub fn set_u32(&mut self, address: u32, value: u32) {
        self.values.push((address, value.to_be_bytes().into()));
    }

    /// A 64-bit floating-point register.
    pub fn set_f64(&mut self, address: u32, value: f64) {
        self.values.push((address, value.to_be_bytes().into()));
    }

    /// Text in a field of so many bytes, cut and filled with zeros.
    pub fn set_text(&mut self, address: u32, field: usize, text: &str) {
        let mut bytes = vec![0; field];
        let length = text.len().min(field.saturating_sub(1));
        bytes[..length].copy_from_slice(&text.as_bytes()[..length]);
        self.values.push((address, bytes));
    }

    /// Bounds of what clients may write into a register.
    pub fn limit(&mut self, address: u32, min: u32, max: u32) {
        self.rules.limits.push(Limit { address, mask: u32::MAX, min, max });
    }

    /// A register of so many bytes that clients cannot write.
    pub fn fix(&mut self, address: u32, bytes: u32) {
        self.rules.fixed.push(address..address + bytes);
    }

    /// The registers of a camera that was switched on.
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
        // Identity and description; counts, capabilities and clock; the source of the stream.
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
