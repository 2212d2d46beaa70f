//! A running acquisition.

use crate::socket::{self, Frames, OpenSocket};
use crate::{Error, Named};
use aravis::glib::prelude::*;
use aravis::glib::translate::{ToGlibPtr, from_glib_full};
use aravis::prelude::*;
use aravis::{
    Buffer, BufferPayloadType, BufferStatus, GvStream, GvStreamOption, GvStreamPacketResend,
    GvStreamSocketBuffer,
};
use aravis_sys::{ARV_STREAM_CALLBACK_TYPE_INIT, ArvBuffer, ArvStreamCallbackType};
use gio::prelude::*;
use std::collections::BTreeSet;
use std::ffi::c_void;
use std::net::{IpAddr, Ipv4Addr};
use std::os::fd::RawFd;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Stream options.
#[derive(Debug, Clone, PartialEq)]
pub struct StreamSetup {
    /// Number of frame buffers.
    pub buffers: usize,
    /// Maximum number of queued frames. When full, the oldest is dropped and counted in
    /// [`StreamCounts::dropped`]. `None`: no limit; frames are lost when no buffer is available (underruns).
    pub waiting: Option<usize>,
    /// GigE Vision: packet size, bytes; `None` lets Aravis find the largest that passes.
    pub packet_size: Option<u32>,
    /// GigE Vision: requests lost packets again.
    pub packet_resend: bool,
    /// GigE Vision: time until a packet counts as lost.
    pub packet_timeout: Duration,
    /// GigE Vision: time until an unfinished frame is abandoned.
    pub frame_retention: Duration,
    /// GigE Vision: receive buffer of the ordinary (not packet) socket, bytes.
    pub socket_buffer: usize,
}

/// Frame received from the stream.
#[derive(Debug)]
pub enum Received<'a> {
    /// Complete frame.
    Complete {
        /// Bytes as received.
        bytes: &'a [u8],
        /// PFNC code.
        format: u32,
        /// x, y, width, height of the region, pixels.
        region: [i32; 4],
        /// Frame number (block id) from the camera; 16 bits in GigE Vision, where 0 is never used.
        frame_id: u64,
        /// Device timestamp, ns; 0 if the camera sends none.
        timestamp_ns: u64,
        /// Time since its first packet; `None` if the host clock was set since.
        age: Option<Duration>,
    },
    /// Incomplete frame; the metadata in its buffer are those of an older frame.
    Damaged(String),
}

/// Stream counters: completed buffers, failures, underruns, drops.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StreamCounts {
    /// Complete frames.
    pub completed: u64,
    /// Damaged frames.
    pub failures: u64,
    /// Frames lost because no buffer was available.
    pub underruns: u64,
    /// Complete frames dropped from a full queue.
    pub dropped: u64,
    /// Damaged frames dropped from a full queue.
    pub dropped_damaged: u64,
}

/// Reason why no frame came.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Silence {
    Timeout,
    Lost,
}

/// Running acquisition; dropping it stops the camera.
#[derive(Debug)]
pub struct Stream<'a> {
    camera: &'a aravis::Camera,
    stream: aravis::Stream,
    lost: Arc<AtomicBool>,
    payload: usize,
    receive_buffer: Option<usize>,
    dropped: Arc<Dropped>,
    /// Spare buffers kept out of circulation; used only if the queue is limited.
    spare: Option<Arc<Spare>>,
    /// Referenced by the receiving thread, which ends with `stream`. Fields are dropped in this order.
    _opening: Box<Opening>,
}

/// Frames dropped from a full queue.
#[derive(Debug, Default)]
struct Dropped {
    whole: AtomicU64,
    damaged: AtomicU64,
}

/// Number of empty buffers that Aravis keeps if there are spare ones: as many as frames may begin before the
/// next is complete.
const READY: usize = 6;

/// Interval between refills of Aravis's empty buffers: six frames at 2000 per second take 3 ms.
const LOOK_AGAIN: Duration = Duration::from_millis(2);

/// Empty buffers that Aravis does not need now. Aravis fills its buffers in turn. Normally few buffers
/// circulate and stay in the cache; while frames are held for lost packets or for the reader, all are used.
#[derive(Debug, Default)]
struct Spare(Mutex<Vec<Buffer>>);

impl Spare {
    fn give_back(&self, stream: &aravis::Stream, buffer: Buffer) {
        if usize::try_from(stream.n_buffers().0).is_ok_and(|ready| ready >= READY) {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).push(buffer);
        } else {
            stream.push_buffer(buffer);
        }
    }

    fn top_up(&self, stream: &aravis::Stream) {
        let ready = usize::try_from(stream.n_buffers().0).unwrap_or(0);
        let mut spare = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        for _ in ready..READY {
            // The most recently used buffer is still in the cache.
            let Some(buffer) = spare.pop() else { break };
            stream.push_buffer(buffer);
        }
    }
}

/// Limits the queue to `waiting` frames. Runs on the receiving thread, so that a slow reader never costs the
/// newest frame.
fn drop_oldest(stream: &aravis::Stream, waiting: usize, spare: &Arc<Spare>) -> Arc<Dropped> {
    let dropped = Arc::new(Dropped::default());
    let (counts, spare) = (Arc::clone(&dropped), Arc::clone(spare));
    stream.connect_new_buffer(move |stream| {
        spare.top_up(stream);
        while usize::try_from(stream.n_buffers().1).is_ok_and(|ready| ready > waiting) {
            let Some(oldest) = stream.try_pop_buffer() else { break };
            let count =
                if oldest.status() == BufferStatus::Success { &counts.whole } else { &counts.damaged };
            count.fetch_add(1, Ordering::Relaxed);
            spare.give_back(stream, oldest);
        }
    });
    stream.set_emit_signals(true);
    dropped
}

/// Sockets open before that of libaravis's receiving thread.
#[derive(Debug)]
struct Opening {
    before: BTreeSet<OpenSocket>,
    /// Socket of that thread, closed to all packets; -1 if not found.
    socket: AtomicI32,
}

/// Callback of libaravis on the receiving thread; the first call precedes any read from its socket.
unsafe extern "C" fn at_start(data: *mut c_void, event: ArvStreamCallbackType, _buffer: *mut ArvBuffer) {
    if event != ARV_STREAM_CALLBACK_TYPE_INIT {
        return;
    }
    // SAFETY: `data` is the Opening that `open` boxed. The Stream keeps it until after libaravis has joined
    // this thread.
    let opening = unsafe { &*data.cast::<Opening>() };
    if let Ok(Some(socket)) = std::panic::catch_unwind(|| opening.close()) {
        opening.socket.store(socket, Ordering::Release);
    }
}

impl Opening {
    /// Closes the one new socket to all packets and discards what it has received since it was bound.
    fn close(&self) -> Option<RawFd> {
        let now = socket::udp_sockets();
        let mut new = now.difference(&self.before);
        let (Some(only), None) = (new.next(), new.next()) else { return None };
        socket::attach(only.fd, &socket::nothing().ok()?).ok()?;
        socket::drain(only.fd);
        Some(only.fd)
    }
}

/// Maximum attempts to open a stream whose socket was not found because another part of the program opened
/// one at the same time.
const OPENINGS: usize = 5;

/// Stream of libaravis, and the data its receiving thread refers to, which must be dropped later.
type Opened = (aravis::Stream, Box<Opening>);

/// Opens a stream whose receiving thread has not seen any packet.
fn open(camera: &aravis::Camera) -> Result<Opened, Error> {
    let _only = socket::opening();
    for _ in 0..OPENINGS {
        let opening = Box::new(Opening { before: socket::udp_sockets(), socket: AtomicI32::new(-1) });
        let data = std::ptr::from_ref(&*opening).cast_mut().cast();
        let mut error = std::ptr::null_mut();
        // SAFETY: the camera is alive by our reference; `data` outlives the stream (see `Opened`), whose
        // thread only reads it.
        let stream = unsafe {
            aravis_sys::arv_camera_create_stream(camera.to_glib_none().0, Some(at_start), data, &mut error)
        };
        if stream.is_null() {
            // SAFETY: libaravis gives null with an error that the caller frees, or with none.
            let why = (!error.is_null()).then(|| unsafe { from_glib_full::<_, aravis::glib::Error>(error) });
            return Err(Error::new("stream", why.as_ref().map_or("refused", |e| e.message())));
        }
        // SAFETY: libaravis gives the only reference of a new object to the caller.
        let stream: aravis::Stream = unsafe { from_glib_full(stream) };
        let Some(gv) = stream.downcast_ref::<GvStream>() else { return Ok((stream, opening)) };
        let found = opening.socket.load(Ordering::Acquire);
        if found >= 0 && socket::port(found) == Some(gv.port()) {
            return Ok((stream, opening));
        }
        tracing::debug!("the socket of the stream was not found; it is opened anew");
        drop(stream);
    }
    Err(Error::new("stream", "its socket was not found among the open files of this process (/proc/self/fd)"))
}

/// Returns the IPv4 address of a GigE Vision camera.
pub(crate) fn address_of(camera: &aravis::Camera) -> Option<Ipv4Addr> {
    let device = camera.device()?.downcast::<aravis::GvDevice>().ok()?;
    let address = device.device_address()?.downcast::<gio::InetSocketAddress>().ok()?;
    match IpAddr::from(address.address()) {
        IpAddr::V4(address) => Some(address),
        IpAddr::V6(_) => None,
    }
}

/// First register of the stream channels, bytes per channel, and offset of the source port in a channel (GigE
/// Vision 2.0, 28.32 to 28.36).
const CHANNELS: u64 = 0xd00;
const CHANNEL: u64 = 0x40;
const SOURCE_PORT: u64 = 0x1c;

/// Admits only packets of this camera's frames to the stream's socket.
fn admit(camera: &aravis::Camera, payload: usize, socket: RawFd) -> Result<(), Error> {
    let address = address_of(camera).ok_or_else(|| Error::new("stream", "the camera has no IPv4 address"))?;
    let channel = camera.gv_get_current_stream_channel().unwrap_or(0);
    let register = CHANNELS + CHANNEL * u64::try_from(channel).unwrap_or(0) + SOURCE_PORT;
    // Some cameras do not report the source port.
    let port = crate::camera::memory(camera, register, 4).unwrap_or_default();
    let port = port.get(2..4).map_or(0, |b| u16::from_be_bytes([b[0], b[1]]));
    let packet = camera.gv_get_packet_size().named("GevSCPSPacketSize")?;
    let number = |n: usize| u32::try_from(n).map_err(|e| Error::new("PayloadSize", e));
    let frames = Frames { camera: address, port, packet, payload: number(payload)? };
    tracing::debug!(?frames, "packets that are let in");
    socket::attach(socket, &socket::frames_of(frames)?)
}

impl<'a> Stream<'a> {
    pub(crate) fn start(
        camera: &'a aravis::Camera,
        setup: &StreamSetup,
        lost: Arc<AtomicBool>,
    ) -> Result<Self, Error> {
        if camera.is_gv_device() {
            // Until its own filter is set, Aravis's packet socket takes every packet on the network for one
            // of the stream.
            camera.gv_set_stream_options(GvStreamOption::PACKET_SOCKET_DISABLED);
        }
        let payload = camera.payload().named("PayloadSize")? as usize;
        let (stream, opening) = open(camera)?;
        let mut receive_buffer = None;
        if let Some(gv) = stream.downcast_ref::<GvStream>() {
            gv.set_packet_resend(if setup.packet_resend {
                GvStreamPacketResend::Always
            } else {
                GvStreamPacketResend::Never
            });
            gv.set_packet_timeout(microseconds(setup.packet_timeout));
            gv.set_frame_retention(microseconds(setup.frame_retention));
            let socket = opening.socket.load(Ordering::Acquire);
            receive_buffer = Some(socket::set_receive_buffer(socket, setup.socket_buffer));
            // 0: Aravis leaves the buffer size unchanged.
            gv.set_socket_buffer(GvStreamSocketBuffer::Fixed);
            gv.set_socket_buffer_size(0);
            admit(camera, payload, socket)?;
        }
        for _ in 0..setup.buffers.max(2) {
            stream.push_buffer(Buffer::new_allocate(payload));
        }
        let spare = setup.waiting.map(|_| Arc::<Spare>::default());
        let dropped = setup.waiting.zip(spare.as_ref()).map(|(n, spare)| drop_oldest(&stream, n, spare));
        camera.start_acquisition().named("AcquisitionStart")?;
        let dropped = dropped.unwrap_or_default();
        Ok(Self { camera, stream, lost, payload, receive_buffer, dropped, spare, _opening: opening })
    }

    /// GigE Vision: returns the receive buffer granted by the system, bytes.
    pub fn receive_buffer(&self) -> Option<usize> {
        self.receive_buffer
    }

    /// Returns the size of a frame, bytes.
    pub fn payload(&self) -> usize {
        self.payload
    }

    /// Sends one software trigger.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: the camera has no software trigger or does not answer.
    pub fn trigger(&self) -> Result<(), Error> {
        self.camera.software_trigger().named("TriggerSoftware")
    }

    /// Waits for the next frame and passes it to `take`. Returns `Ok(None)` on timeout.
    ///
    /// # Errors
    ///
    /// Control of the camera was lost. A timeout or a damaged frame is no error.
    pub fn next<T>(
        &mut self,
        timeout: Duration,
        take: impl FnOnce(Received<'_>) -> T,
    ) -> Result<Option<T>, Error> {
        match self.pop(timeout) {
            Ok(buffer) => {
                let answer = take(self.look(&buffer));
                // The bytes are no longer borrowed: Aravis may fill the buffer again.
                match &self.spare {
                    Some(spare) => spare.give_back(&self.stream, buffer),
                    None => self.stream.push_buffer(buffer),
                }
                Ok(Some(answer))
            }
            Err(Silence::Timeout) => Ok(None),
            Err(Silence::Lost) => Err(Error::new("control", "the camera no longer answers the heartbeat")),
        }
    }

    fn pop(&self, timeout: Duration) -> Result<Buffer, Silence> {
        let end = Instant::now() + timeout;
        loop {
            // Waits in slices, so that a lost camera is noticed during a long wait, and buffers are refilled
            // while a frame waits for lost packets.
            if let Some(spare) = &self.spare {
                spare.top_up(&self.stream);
            }
            let left = end.saturating_duration_since(Instant::now()).min(LOOK_AGAIN);
            if let Some(buffer) = self.stream.timeout_pop_buffer(microseconds(left).into()) {
                return Ok(buffer);
            }
            if self.lost.load(Ordering::Acquire) {
                return Err(Silence::Lost);
            }
            if Instant::now() >= end {
                return Err(Silence::Timeout);
            }
        }
    }

    /// Checks a buffer, also its length against the payload. A buffer with status Success can still be short:
    /// with the packet socket, the first IP fragment of a packet larger than the MTU passes for the whole.
    fn look<'b>(&self, buffer: &'b Buffer) -> Received<'b> {
        if buffer.status() != BufferStatus::Success {
            return Received::Damaged(format!("{:?}", buffer.status()));
        }
        if buffer.payload_type() != BufferPayloadType::Image {
            return Received::Damaged(format!("payload of type {:?}", buffer.payload_type()));
        }
        let (pointer, length) = buffer.data();
        if pointer.is_null() || length != self.payload {
            return Received::Damaged(format!("{length} bytes of {}", self.payload));
        }
        // SAFETY: Aravis owns `length` initialised bytes at `pointer` (checked above against the size that
        // the buffer was allocated with). The buffer has been popped, so that no other thread writes to it
        // until it is pushed back, which `next` does after the borrow has ended; buffers are never cloned.
        let bytes = unsafe { std::slice::from_raw_parts(pointer.cast_const(), length) };
        let (x, y, width, height) = buffer.image_region();
        Received::Complete {
            bytes,
            format: buffer.image_pixel_format().raw(),
            region: [x, y, width, height],
            frame_id: buffer.frame_id(),
            timestamp_ns: buffer.timestamp(),
            age: age(buffer.system_timestamp()),
        }
    }

    /// Returns the counters of Aravis and of dropped frames.
    pub fn counts(&self) -> StreamCounts {
        let (completed, failures, underruns) = self.stream.statistics();
        let dropped = self.dropped.whole.load(Ordering::Relaxed);
        let dropped_damaged = self.dropped.damaged.load(Ordering::Relaxed);
        StreamCounts { completed, failures, underruns, dropped, dropped_damaged }
    }
}

/// Maximum plausible age: no frame waits so long in a bounded queue, so a larger age means that the clock was
/// set.
const OLDEST: Duration = Duration::from_secs(60);

/// Returns the time since a wall-clock time, ns.
fn age(system_timestamp_ns: u64) -> Option<Duration> {
    let then = UNIX_EPOCH + Duration::from_nanos(system_timestamp_ns);
    SystemTime::now().duration_since(then).ok().filter(|age| *age < OLDEST)
}

/// Converts a time for libaravis, clamped to its maximum of 71 minutes.
fn microseconds(time: Duration) -> u32 {
    u32::try_from(time.as_micros()).unwrap_or(u32::MAX)
}

impl Drop for Stream<'_> {
    fn drop(&mut self) {
        self.stream.set_emit_signals(false);
        if self.lost.load(Ordering::Acquire) {
            return; // the camera is gone; asking it to stop would wait for an answer
        }
        if let Err(e) = self.camera.stop_acquisition() {
            tracing::warn!(error = e.message(), "the camera did not confirm the end of the acquisition");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clock set while a frame waited only makes its age unknown.
    #[test]
    fn a_step_of_the_clock_leaves_the_age_unknown() {
        let ns = |t: SystemTime| u64::try_from(t.duration_since(UNIX_EPOCH).unwrap().as_nanos()).unwrap();
        let now = SystemTime::now();
        let hour = Duration::from_secs(3600);
        assert_eq!((age(ns(now + hour)), age(ns(now - hour)), age(0)), (None, None, None));
        let young = age(ns(now - Duration::from_millis(5))).unwrap();
        assert!(young >= Duration::from_millis(5) && young < OLDEST);
    }
}
