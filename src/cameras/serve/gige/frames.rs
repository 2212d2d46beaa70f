//! Frames as packets (GVSP; GigE Vision 2.0, chapters 23 and 24), sent from a separate thread.

use super::registers::{MIN_PACKET, Registers, address, word};
use super::{LOOK, Painter, Request, Shared};
use radcam_sim::rng::{PixelRng, Stream};
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Overhead of a packet, bytes: headers of IP, UDP and GVSP.
const OVERHEAD: usize = 20 + 8 + HEADER;
/// Bytes of a GVSP header: status, block id, format and packet id.
const HEADER: usize = 8;
const LEADER: u8 = 1;
const TRAILER: u8 = 2;
const PAYLOAD: u8 = 3;
/// Payload type of images.
const IMAGE: u16 = 1;
/// Maximum bytes per pixel: RGB of 16 bits, with a margin.
const PIXEL_BYTES: u64 = 8;
/// Seed of the simulated packet losses.
const LOSSES: u64 = 3956;

/// Sends frames until the camera ends.
pub(super) struct Frames {
    registers: Registers,
    socket: UdpSocket,
    painter: Box<dyn Painter>,
    shared: Arc<Shared>,
    /// Buffers of a frame and of a packet.
    image: Vec<u8>,
    packet: Vec<u8>,
    /// Packets sent so far, lost ones included.
    packets: u64,
}

/// An acquisition. Destination and packet size stay fixed from start to end.
struct Acquisition {
    number: u64,
    to: SocketAddrV4,
    /// Pixel bytes per packet.
    block: usize,
}

/// Returns true while an acquisition with a known destination runs.
fn runs(bytes: &[u8]) -> bool {
    word(bytes, address::ACQUISITION) != 0
        && word(bytes, address::PRIVILEGE) != 0
        && word(bytes, address::STREAM_PORT) & 0xffff != 0
}

/// Returns true if frames wait for a trigger (software or line).
fn triggered(bytes: &[u8]) -> bool {
    word(bytes, address::TRIGGER_MODE) == 1
}

/// Returns true if a software trigger is pending.
fn asked(bytes: &[u8]) -> bool {
    word(bytes, address::TRIGGER_SOURCE) == 1 && word(bytes, address::TRIGGER_SOFTWARE) == 1
}

impl Frames {
    pub(super) fn new(
        registers: Registers,
        socket: UdpSocket,
        painter: Box<dyn Painter>,
        shared: Arc<Shared>,
    ) -> Self {
        Self { registers, socket, painter, shared, image: Vec::new(), packet: Vec::new(), packets: 0 }
    }

    fn ends(&self) -> bool {
        self.shared.end.load(Ordering::Relaxed)
    }

    pub(super) fn run(mut self) {
        while !self.ends() {
            self.registers.wait(LOOK, runs);
            if let Some(acquisition) = self.begun() {
                self.acquire(&acquisition);
            }
        }
    }

    fn begun(&self) -> Option<Acquisition> {
        let bytes = self.registers.lock();
        let port = u16::try_from(word(&bytes, address::STREAM_PORT) & 0xffff).ok()?;
        let to = SocketAddrV4::new(Ipv4Addr::from(word(&bytes, address::STREAM_ADDRESS)), port);
        let size = (word(&bytes, address::PACKET_SIZE) & 0xffff).max(MIN_PACKET) as usize;
        runs(&bytes).then(|| Acquisition {
            number: self.registers.acquisitions(),
            to,
            block: size - OVERHEAD,
        })
    }

    /// Sends frames until the client ends this acquisition. Block ids start at 1 in each (GigE Vision 2.0,
    /// 23.3).
    fn acquire(&mut self, acquisition: &Acquisition) {
        let (mut id, mut due) = (0u16, Instant::now());
        while !self.ends() && self.goes_on(acquisition) {
            if !self.is_due(acquisition, &mut due) {
                continue;
            }
            // Block id 0 is never used.
            id = id.checked_add(1).unwrap_or(1);
            self.frame(acquisition, id);
        }
    }

    fn goes_on(&self, acquisition: &Acquisition) -> bool {
        self.registers.acquisitions() == acquisition.number && runs(&self.registers.lock())
    }

    /// Waits, in short slices, for the time of the next frame or for its trigger.
    fn is_due(&self, acquisition: &Acquisition, due: &mut Instant) -> bool {
        let over = |bytes: &[u8]| {
            !runs(bytes)
                || self.registers.acquisitions() != acquisition.number
                || triggered(bytes) && asked(bytes)
        };
        let now = Instant::now();
        if triggered(&self.registers.lock()) {
            self.registers.wait(LOOK, over);
            *due = now;
            let asked = asked(&self.registers.lock());
            if asked {
                self.registers.set_u32(address::TRIGGER_SOFTWARE, 0);
            }
            return asked && self.goes_on(acquisition);
        }
        if *due > now {
            let left = (*due - now).min(LOOK);
            self.registers.wait(left, |bytes| over(bytes) || triggered(bytes));
            return false;
        }
        let period = Duration::from_micros(self.registers.u32(address::FRAME_PERIOD_US).max(1).into());
        *due += period;
        // A late camera skips frames instead of sending a burst.
        if *due < now {
            *due = now + period;
        }
        true
    }

    fn frame(&mut self, acquisition: &Acquisition, id: u16) {
        let registers = self.registers.clone();
        let _turn = registers.turn_to_paint();
        if !self.goes_on(acquisition) {
            return;
        }
        let (request, sensor) = {
            let bytes = self.registers.lock();
            let read = |at| word(&bytes, at);
            let region = [
                read(address::OFFSET_X),
                read(address::OFFSET_Y),
                read(address::WIDTH),
                read(address::HEIGHT),
            ];
            let sensor = u64::from(read(address::SENSOR_WIDTH)) * u64::from(read(address::SENSOR_HEIGHT));
            (Request { region, format: read(address::PIXEL_FORMAT) }, sensor)
        };
        let [_, _, width, height] = request.region.map(u64::from);
        // The PFNC code holds the bits of a pixel.
        let bits = u64::from(request.format >> 16 & 0xff);
        let bytes = width.checked_mul(height).and_then(|n| n.checked_mul(bits)).map(|n| n / 8);
        let Some(bytes) = bytes.filter(|n| (1..=PIXEL_BYTES * sensor).contains(n)) else {
            tracing::warn!(?request, "a frame of this size cannot be sent");
            return;
        };
        self.image.clear();
        self.image.resize(bytes as usize, 0);
        let (painter, registers, image) = (&mut self.painter, &self.registers, &mut self.image);
        // A panic of the painter costs one frame, not the camera.
        let painted = catch_unwind(AssertUnwindSafe(|| painter.paint(registers, request, image)));
        let timestamp_ns = painted.unwrap_or_else(|_| {
            tracing::error!(?request, "painting a frame panicked");
            0
        });
        self.send_frame(acquisition, id, request, timestamp_ns);
    }

    fn send_frame(&mut self, acquisition: &Acquisition, id: u16, request: Request, timestamp_ns: u64) {
        let [x, y, width, height] = request.region;
        let mut leader = vec![0; 2];
        leader.extend(IMAGE.to_be_bytes());
        leader.extend(timestamp_ns.to_be_bytes());
        [request.format, width, height, x, y, 0].iter().for_each(|n| leader.extend(n.to_be_bytes()));
        let mut trailer = vec![0; 2];
        trailer.extend(IMAGE.to_be_bytes());
        trailer.extend(height.to_be_bytes());
        let image = std::mem::take(&mut self.image);
        self.send(acquisition.to, id, LEADER, 0, &leader);
        let mut number = 0;
        for block in image.chunks(acquisition.block) {
            number += 1;
            self.send(acquisition.to, id, PAYLOAD, number, block);
        }
        self.send(acquisition.to, id, TRAILER, number + 1, &trailer);
        self.image = image;
    }

    /// Sends one packet, unless it is lost on purpose.
    fn send(&mut self, to: SocketAddrV4, id: u16, format: u8, number: u32, body: &[u8]) {
        self.packets += 1;
        let lose = f64::from_bits(self.shared.lose.load(Ordering::Relaxed));
        if lose > 0.0 && PixelRng::new(LOSSES, Stream::Effect, self.packets, 0, 0).uniform() < lose {
            return;
        }
        self.packet.clear();
        self.packet.extend([0; 2]);
        self.packet.extend(id.to_be_bytes());
        self.packet.extend((u32::from(format) << 24 | number & 0xff_ffff).to_be_bytes());
        self.packet.extend(body);
        // A full queue or a vanished client loses packets, as in a network.
        if let Err(e) = self.socket.send_to(&self.packet, to) {
            tracing::debug!(%to, error = %e, "a packet could not be sent");
        }
    }
}
