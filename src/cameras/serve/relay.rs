//! Corrected frames served as a GigE Vision camera, for any GenICam software.

use super::gige::{Initial, Painter, Registers, Request, VirtualCamera, address};
use super::{ServeError, description, register};
use crate::camera::{Identity, Settings};
use crate::pixel_format::PixelFormat;
use crate::stream::{Corrected, Sink, SinkCounts, StreamError};
use std::collections::VecDeque;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Maximum number of frames queued for the client.
const WAITING: usize = 8;
/// Time without a request after which a client counts as gone: only the newest frame stays queued.
const IDLE: Duration = Duration::from_secs(1);

#[derive(Default)]
struct Inside {
    waiting: VecDeque<Arc<Corrected>>,
    sent: u64,
    dropped: u64,
    /// Frames received without a client.
    unasked: u64,
    last: Option<Instant>,
}

/// State shared by stream and server. Under this lock the trigger register is 1 exactly when a frame is
/// queued.
#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Inside>>);

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Inside> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Camera that sends each corrected frame once.
pub struct Relay {
    camera: VirtualCamera,
    shared: Shared,
}

struct Hand {
    shared: Shared,
    format: PixelFormat,
}

impl Painter for Hand {
    fn paint(&mut self, registers: &Registers, _request: Request, frame: &mut [u8]) -> u64 {
        let mut inside = self.shared.lock();
        let next = inside.waiting.pop_front();
        registers.set_u32(address::TRIGGER_SOFTWARE, u32::from(!inside.waiting.is_empty()));
        inside.last = Some(Instant::now());
        let Some(next) = next else { return 0 };
        inside.sent += 1;
        drop(inside);
        if let Err(e) = self.format.pack(&next.pixels, frame) {
            tracing::error!(error = %e, "a client changed the size of the image; a black frame goes out");
        }
        next.timestamp_ns.unwrap_or(0)
    }
}

impl Relay {
    /// Starts a camera on an interface (its IPv4 address), with this serial number and frames of this size,
    /// format and exposure.
    ///
    /// # Errors
    ///
    /// The interface cannot be bound.
    pub fn start(
        interface: IpAddr,
        serial: &str,
        identity: &Identity,
        settings: &Settings,
        format: PixelFormat,
    ) -> Result<Self, ServeError> {
        let about = format!("frames of {identity}, corrected by radcam");
        let xml = description::of_relay(&identity.vendor, &identity.model, &about, format);
        let mut r = Initial::default();
        r.set_text(address::VENDOR, 32, &identity.vendor);
        r.set_text(address::MODEL, 32, &identity.model);
        r.set_text(address::VERSION, 32, env!("CARGO_PKG_VERSION"));
        let region = settings.region;
        for (at, value) in [
            (address::SENSOR_WIDTH, region.width),
            (address::SENSOR_HEIGHT, region.height),
            (address::WIDTH, region.width),
            (address::HEIGHT, region.height),
            (address::PIXEL_FORMAT, format.code()),
            (address::TRIGGER_MODE, 1),
            (address::TRIGGER_SOURCE, 1),
        ] {
            r.set_u32(at, value);
        }
        r.set_f64(register::EXPOSURE_US, 1e6 * settings.exposure_s);
        // Frames come from another camera: no setting can be changed.
        for (at, bytes) in [
            (address::WIDTH, 8),
            (address::PIXEL_FORMAT, 4),
            (address::OFFSET_X, 8),
            (address::TRIGGER_MODE, 8),
            (register::EXPOSURE_US, 8),
        ] {
            r.fix(at, bytes);
        }
        let shared = Shared::default();
        let hand = Hand { shared: shared.clone(), format };
        let camera = VirtualCamera::start(interface, serial, &xml, Box::new(hand), r)?;
        Ok(Self { camera, shared })
    }

    /// Returns the number of frames received without a client; they are neither sent nor dropped.
    pub fn unasked(&self) -> u64 {
        self.shared.lock().unasked
    }
}

impl Sink for Relay {
    fn name(&self) -> &'static str {
        "served"
    }

    fn take(&mut self, frame: &Arc<Corrected>) -> Result<(), StreamError> {
        let mut inside = self.shared.lock();
        // A killed client leaves its acquisition running.
        let idle = !self.camera.is_acquiring() || inside.last.is_some_and(|last| last.elapsed() > IDLE);
        if idle {
            inside.unasked += inside.waiting.len() as u64;
            inside.waiting.clear();
        } else if inside.waiting.len() >= WAITING {
            inside.waiting.pop_front();
            inside.dropped += 1;
        }
        inside.waiting.push_back(Arc::clone(frame));
        self.camera.trigger();
        Ok(())
    }

    fn counts(&self) -> SinkCounts {
        let inside = self.shared.lock();
        SinkCounts { taken: inside.sent, dropped: inside.dropped }
    }

    /// Sends the queued frames if a client takes them.
    fn finish(&mut self) -> Result<(), StreamError> {
        let begun = Instant::now();
        let waits = |i: &Inside| !i.waiting.is_empty() && i.last.is_some_and(|last| last.elapsed() < IDLE);
        while begun.elapsed() < IDLE && waits(&self.shared.lock()) {
            std::thread::sleep(Duration::from_millis(5));
        }
        // Leaves time for the last packet.
        std::thread::sleep(Duration::from_millis(50));
        Ok(())
    }
}
