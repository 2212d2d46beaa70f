//! A virtual GigE Vision camera: Aravis answers the protocol, a [`Painter`] makes the frames.

use crate::Error;
use aravis::glib::translate::ToGlibPtr;
use aravis_sys::{ArvBuffer, ArvFakeCamera};
use std::ffi::c_void;
use std::io::Write;
use std::net::{IpAddr, UdpSocket};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

/// Port of the GigE Vision control protocol.
const GVCP_PORT: u16 = 3956;

/// Registers that the fake camera itself reads (arvfakecamera.h of libaravis 0.8).
pub mod address {
    /// Columns of the region.
    pub const WIDTH: u32 = 0x100;
    /// Rows of the region.
    pub const HEIGHT: u32 = 0x104;
    /// Columns of the sensor.
    pub const SENSOR_WIDTH: u32 = 0x11c;
    /// Rows of the sensor.
    pub const SENSOR_HEIGHT: u32 = 0x118;
    /// PFNC code.
    pub const PIXEL_FORMAT: u32 = 0x128;
    /// First column of the region.
    pub const OFFSET_X: u32 = 0x130;
    /// First row of the region.
    pub const OFFSET_Y: u32 = 0x134;
    /// Period of the frames, microseconds.
    pub const FRAME_PERIOD_US: u32 = 0x138;
    /// 1 while an acquisition runs.
    pub const ACQUISITION: u32 = 0x124;
    /// 1 where frames wait for a trigger.
    pub const TRIGGER_MODE: u32 = 0x300;
    /// 1 where the trigger is software's.
    pub const TRIGGER_SOURCE: u32 = 0x304;
    /// Writing 1 asks for a frame.
    pub const TRIGGER_SOFTWARE: u32 = 0x30c;
    /// Maker, 32 bytes of text (GigE Vision bootstrap registers).
    pub const VENDOR: u32 = 0x48;
    /// Model, 32 bytes of text.
    pub const MODEL: u32 = 0x68;
    /// Device version, 32 bytes of text.
    pub const VERSION: u32 = 0x88;
}

/// Bytes of register space; beyond it the description file begins.
const REGISTER_SPACE: usize = 0x1_0000;

/// The camera's registers, big endian, as any client reads and writes them.
pub struct Registers(*mut ArvFakeCamera);

impl Registers {
    /// Reads bytes; zeros beyond the register space. Only on the server's thread, or before anything else has the camera: Aravis has no lock
    /// on the registers.
    fn read<const N: usize>(&self, address: u32) -> [u8; N] {
        let mut bytes = [0; N];
        let size = const { size_of_read::<N>() };
        if address as usize + N <= REGISTER_SPACE {
            // SAFETY: the camera lives as long as the VirtualCamera that owns these registers, N bytes at `bytes` are
            // ours, and the range lies within the register space.
            unsafe {
                aravis_sys::arv_fake_camera_read_memory(self.0, address, size, bytes.as_mut_ptr().cast());
            }
        }
        bytes
    }

    /// Writes a 32-bit register; nothing beyond the register space.
    pub fn set_u32(&self, address: u32, value: u32) {
        let bytes = value.to_be_bytes();
        if address as usize + bytes.len() < REGISTER_SPACE {
            // SAFETY: as in `read`; libaravis copies from `bytes` and does not write to it.
            unsafe {
                aravis_sys::arv_fake_camera_write_memory(
                    self.0,
                    address,
                    4,
                    bytes.as_ptr().cast_mut().cast(),
                );
            }
        }
    }

    /// Reads a 32-bit register.
    pub fn u32(&self, address: u32) -> u32 {
        u32::from_be_bytes(self.read(address))
    }

    /// Reads a 64-bit floating-point register.
    pub fn f64(&self, address: u32) -> f64 {
        f64::from_be_bytes(self.read(address))
    }
}

/// The register space of a camera that answers, for a thread that does what a client's command asks for.
///
/// Aravis's thread reads and writes the same bytes without a lock. So only what a protocol hands over in turn may be touched: a client writes its
/// parameters, then the command's register, and waits until that register is cleared.
pub struct Memory(aravis::FakeCamera);

// SAFETY: the object is reference-counted atomically, and its memory lives as long as this reference.
unsafe impl Send for Memory {}

impl Memory {
    /// Reads bytes; zeros beyond the register space.
    pub fn read(&self, address: u32, bytes: &mut [u8]) {
        bytes.fill(0);
        let pointer: *mut ArvFakeCamera = self.0.to_glib_none().0;
        if let Some(size) = within(address, bytes.len()) {
            // SAFETY: the camera is alive by our reference, `size` bytes at `bytes` are ours, and the range lies within the register space.
            unsafe {
                aravis_sys::arv_fake_camera_read_memory(pointer, address, size, bytes.as_mut_ptr().cast());
            }
        }
    }

    /// Writes bytes; nothing beyond the register space.
    pub fn write(&self, address: u32, bytes: &[u8]) {
        let pointer: *mut ArvFakeCamera = self.0.to_glib_none().0;
        if let Some(size) = within(address, bytes.len()) {
            // SAFETY: as in `read`; libaravis copies from `bytes` and does not write to it.
            unsafe {
                aravis_sys::arv_fake_camera_write_memory(
                    pointer,
                    address,
                    size,
                    bytes.as_ptr().cast_mut().cast(),
                );
            }
        }
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
}

/// The size of a range of the register space; `None` where it leaves that, or is empty.
fn within(address: u32, bytes: usize) -> Option<u32> {
    let size = u32::try_from(bytes).ok().filter(|size| *size > 0)?;
    (address.checked_add(size)? as usize <= REGISTER_SPACE).then_some(size)
}

/// The size of what is read, checked while compiling.
const fn size_of_read<const N: usize>() -> u32 {
    assert!(N <= 8);
    #[expect(clippy::cast_possible_truncation, reason = "at most 8")]
    {
        N as u32
    }
}

/// What the registers hold when the camera begins to answer.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Initial(Vec<(u32, Vec<u8>)>);

impl Initial {
    /// A 32-bit register.
    pub fn set_u32(&mut self, address: u32, value: u32) {
        self.0.push((address, value.to_be_bytes().into()));
    }

    /// A 64-bit floating-point register.
    pub fn set_f64(&mut self, address: u32, value: f64) {
        self.0.push((address, value.to_be_bytes().into()));
    }

    /// Text in a field of so many bytes, cut and filled with zeros.
    pub fn set_text(&mut self, address: u32, field: usize, text: &str) {
        let mut bytes = vec![0; field];
        let length = text.len().min(field.saturating_sub(1));
        bytes[..length].copy_from_slice(&text.as_bytes()[..length]);
        self.0.push((address, bytes));
    }

    /// Writes them over the control protocol (GigE Vision 2.0, WRITEMEM_CMD). Aravis starts its thread with the camera and has no lock on the
    /// registers, so that thread itself must write.
    fn send(&self, interface: IpAddr) -> std::io::Result<()> {
        const COMMAND: u8 = 0x42;
        const ACKNOWLEDGE: u8 = 0x01;
        const WRITEMEM_CMD: u16 = 0x0086;
        const WRITEMEM_ACK: u16 = 0x0087;
        let socket = UdpSocket::bind((interface, 0))?;
        socket.connect((interface, GVCP_PORT))?;
        socket.set_read_timeout(Some(Duration::from_millis(500)))?;
        for (id, (address, bytes)) in (1u16..).zip(&self.0) {
            let size = 4 + u16::try_from(bytes.len()).map_err(std::io::Error::other)?;
            let mut packet = vec![COMMAND, ACKNOWLEDGE];
            [WRITEMEM_CMD, size, id].iter().for_each(|n| packet.extend(n.to_be_bytes()));
            packet.extend(address.to_be_bytes());
            packet.extend(bytes);
            let acknowledged = || -> std::io::Result<bool> {
                socket.send(&packet)?;
                let mut answer = [0; 64];
                let n = socket.recv(&mut answer)?;
                Ok(n >= 8 && answer[2..4] == WRITEMEM_ACK.to_be_bytes() && answer[6..8] == id.to_be_bytes())
            };
            // Loopback loses nothing; a slow machine may be late.
            if !(0..4).any(|_| acknowledged().unwrap_or(false)) {
                let message =
                    format!("the register at {address:#x} could not be written; another client has control");
                return Err(std::io::Error::other(message));
            }
        }
        Ok(())
    }
}

/// The frame that is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    /// Frames painted before this one.
    pub number: u64,
    /// x, y, width, height of the region, pixels.
    pub region: [u32; 4],
    /// PFNC code.
    pub format: u32,
}

/// Makes frames. Runs on the thread that also answers the control protocol: be quick.
pub trait Painter: Send {
    /// Fills the bytes of a frame and returns its timestamp, ns.
    fn paint(&mut self, registers: &Registers, request: Request, frame: &mut [u8]) -> u64;
}

/// What the callback finds behind its pointer.
struct Context {
    registers: Registers,
    painter: Box<dyn Painter>,
    number: u64,
}

/// A camera that answers on the network until it is dropped.
pub struct VirtualCamera {
    // Dropped by hand, in the order that `Drop` explains.
    server: Option<aravis::GvFakeCamera>,
    camera: aravis::FakeCamera,
    context: *mut Context,
}

// SAFETY: the raw pointer is a Box that only the callback (on the server's thread, under the library's mutex) touches
// until Drop has joined that thread; the two objects are reference-counted atomically.
unsafe impl Send for VirtualCamera {}

unsafe extern "C" fn fill(
    buffer: *mut ArvBuffer,
    data: *mut c_void,
    _exposure: u32,
    _gain: u32,
    _format: aravis_sys::ArvPixelFormat,
) {
    // SAFETY: `data` is the Context that `start` boxed; it is freed only after the callback was taken off and the
    // thread that calls it was joined. The library holds a mutex around the call, so that there is no second one.
    let context = unsafe { &mut *data.cast::<Context>() };
    let Context { registers, painter, number } = context;
    let read = |address| registers.u32(address);
    let request = Request {
        number: *number,
        region: [
            read(address::OFFSET_X),
            read(address::OFFSET_Y),
            read(address::WIDTH),
            read(address::HEIGHT),
        ],
        format: read(address::PIXEL_FORMAT),
    };
    *number += 1;
    // SAFETY: the registers hold the camera, which outlives the callback.
    let payload = unsafe { aravis_sys::arv_fake_camera_get_payload(registers.0) };
    let mut received = 0;
    // SAFETY: the library gives a valid buffer; its received length is 0 in here, and it has checked that at least
    // `payload` bytes are allocated before calling. They were zeroed or filled before, so that they are initialised.
    let bytes = unsafe {
        let pointer = aravis_sys::arv_buffer_get_data(buffer, &mut received).cast::<u8>();
        if pointer.is_null() || payload == 0 {
            return;
        }
        pointer.write_bytes(0, payload);
        std::slice::from_raw_parts_mut(pointer, payload)
    };
    // A panic must not cross into C. The frame stays as it is and the fault is in the log.
    match catch_unwind(AssertUnwindSafe(|| painter.paint(registers, request, bytes))) {
        // SAFETY: as above.
        Ok(timestamp_ns) => unsafe { aravis_sys::arv_buffer_set_timestamp(buffer, timestamp_ns) },
        Err(_) => tracing::error!(number = request.number, "painting a frame panicked"),
    }
}

impl VirtualCamera {
    /// Answers on `interface` (its IPv4 address) with the description file `xml`, its registers as `initial` says.
    ///
    /// # Errors
    ///
    /// Where the interface cannot be bound, another server has the port, or the description cannot be written.
    pub fn start(
        interface: IpAddr,
        serial: &str,
        xml: &str,
        painter: Box<dyn Painter>,
        initial: &Initial,
    ) -> Result<Self, Error> {
        let fault = |message: String| Error::new(&format!("virtual camera on {interface}"), message);
        if serial.is_empty() || serial.len() > 15 || !serial.is_ascii() {
            return Err(fault(format!("serial \"{serial}\" must have 1 to 15 ASCII characters")));
        }
        // Aravis reports success where its port is taken.
        UdpSocket::bind((interface, GVCP_PORT)).map_err(|e| {
            fault(format!("port {GVCP_PORT} cannot be opened ({e}); is another camera served there?"))
        })?;
        let mut file =
            tempfile::Builder::new().suffix(".xml").tempfile().map_err(|e| fault(e.to_string()))?;
        file.write_all(xml.as_bytes()).map_err(|e| fault(e.to_string()))?;
        let path = file.path().to_string_lossy().into_owned();
        let server = aravis::GvFakeCamera::new_full(Some(&interface.to_string()), Some(serial), Some(&path));
        let camera = server.fake_camera().ok_or_else(|| fault("libaravis made no camera".into()))?;
        if !server.is_running() {
            let message = "no network interface has this address; for a second camera on this machine give the loopback one more: \
                           ip addr add 127.0.0.2/8 dev lo";
            return Err(fault(message.into()));
        }
        // The library asks 25 times a second for a trigger; a thousand times make it prompt.
        camera.set_trigger_frequency(1000.0);
        let pointer: *mut ArvFakeCamera = camera.to_glib_none().0;
        initial.send(interface).map_err(|e| fault(e.to_string()))?;
        let context = Box::into_raw(Box::new(Context { registers: Registers(pointer), painter, number: 0 }));
        // SAFETY: the camera is alive, and `context` is until Drop has taken the callback off.
        unsafe {
            aravis_sys::arv_fake_camera_set_fill_pattern(pointer, Some(fill), context.cast());
        }
        Ok(Self { server: Some(server), camera, context })
    }

    /// Asks for one frame, where [`address::TRIGGER_MODE`] and [`address::TRIGGER_SOURCE`] are 1.
    pub fn trigger(&self) {
        // Four aligned bytes: either value that a race with Aravis's thread leaves is one that was written.
        self.memory().set_u32(address::TRIGGER_SOFTWARE, 1);
    }

    /// Its register space.
    pub fn memory(&self) -> Memory {
        Memory(self.camera.clone())
    }

    /// Whether a client has started an acquisition and not ended it.
    pub fn is_acquiring(&self) -> bool {
        self.memory().u32(address::ACQUISITION) != 0
    }

    /// Makes the camera lose this share of its packets, 0 to 1: a bad cable.
    pub fn set_lost_packets(&self, share: f64) {
        if let Some(server) = &self.server {
            server.set_gvsp_lost_ratio(share);
        }
    }
}

impl Drop for VirtualCamera {
    fn drop(&mut self) {
        let pointer: *mut ArvFakeCamera = self.camera.to_glib_none().0;
        // SAFETY: the camera is alive by our reference; null restores the library's own pattern. The library holds its mutex here and around
        // the callback: after this nobody paints any more.
        unsafe { aravis_sys::arv_fake_camera_set_fill_pattern(pointer, None, std::ptr::null_mut()) };
        // Dropping the only reference joins the server's thread.
        drop(self.server.take());
        // SAFETY: the context came from Box::into_raw, and its only other user, the callback, is gone.
        drop(unsafe { Box::from_raw(self.context) });
    }
}
