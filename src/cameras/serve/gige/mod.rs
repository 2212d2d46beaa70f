//! GigE Vision camera in safe Rust: the control protocol (GVCP), its registers, and the frames (GVSP).
//!
//! Datagrams come from any host. Each is checked for length, command, addresses and values before a register
//! is touched ([`control`]). Invalid requests are refused with the status of GigE Vision 2.0; datagrams that
//! are no request are dropped. Both are counted.

pub mod control;
mod frames;
pub mod registers;

use super::ServeError;
use control::Control;
use frames::Frames;
pub use registers::{Initial, Registers, address};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Port of the GigE Vision control protocol.
const GVCP_PORT: u16 = 3956;
/// Polling interval of the end flag.
const LOOK: Duration = Duration::from_millis(50);
/// Maximum size of an IPv4 datagram, bytes.
const LONGEST: usize = 65_536;

/// Requested frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    /// x, y, width, height of the region, pixels.
    pub region: [u32; 4],
    /// PFNC code.
    pub format: u32,
}

/// Source of frames, called on a separate thread.
pub trait Painter: Send {
    /// Fills the bytes of a frame and returns its timestamp, ns.
    fn paint(&mut self, registers: &Registers, request: Request, frame: &mut [u8]) -> u64;
}

/// State shared by the threads of a camera.
#[derive(Default)]
struct Shared {
    end: AtomicBool,
    /// Requests refused or dropped.
    refused: AtomicU64,
    /// Share of packets to lose, as the bits of an f64.
    lose: AtomicU64,
}

/// Camera that answers on the network until dropped.
pub struct VirtualCamera {
    registers: Registers,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

impl VirtualCamera {
    /// Starts a camera on `interface` (its IPv4 address) with the description file `xml` and the register
    /// values `initial`.
    ///
    /// # Errors
    ///
    /// The interface cannot be bound, or another camera is served there.
    pub fn start(
        interface: IpAddr,
        serial: &str,
        xml: &str,
        painter: Box<dyn Painter>,
        initial: Initial,
    ) -> Result<Self, ServeError> {
        let fault = |message: String| ServeError::Network { interface, message };
        let IpAddr::V4(address) = interface else {
            return Err(fault("GigE Vision needs an IPv4 address".into()));
        };
        if serial.is_empty() || serial.len() > 15 || !serial.is_ascii() {
            return Err(fault(format!("serial \"{serial}\" must have 1 to 15 ASCII characters")));
        }
        let control = UdpSocket::bind((interface, GVCP_PORT)).map_err(|e| fault(not_bound(&e)))?;
        let stream = UdpSocket::bind((interface, 0)).map_err(|e| fault(e.to_string()))?;
        let port = stream.local_addr().map_err(|e| fault(e.to_string()))?.port();
        let (registers, rules) = initial.build(address, port, serial, xml);
        let shared = Arc::new(Shared::default());
        let answering = Arc::new(Mutex::new(Control::new(registers.clone(), rules)));
        let mut camera =
            Self { registers: registers.clone(), shared: Arc::clone(&shared), threads: Vec::new() };
        let control = Arc::new(control);
        for socket in broadcasts(address) {
            camera.listen(socket, &control, &answering, true).map_err(|e| fault(e.to_string()))?;
        }
        let own = control.try_clone().map_err(|e| fault(e.to_string()))?;
        camera.listen(own, &control, &answering, false).map_err(|e| fault(e.to_string()))?;
        let frames = Frames::new(registers, stream, painter, shared);
        camera.threads.push(std::thread::spawn(move || frames.run()));
        Ok(camera)
    }

    /// Answers requests from a socket through the control-port socket. Broadcasts may only be discovery
    /// requests.
    fn listen(
        &mut self,
        socket: UdpSocket,
        answer_by: &Arc<UdpSocket>,
        control: &Arc<Mutex<Control>>,
        broadcast: bool,
    ) -> std::io::Result<()> {
        socket.set_read_timeout(Some(LOOK))?;
        let (answer_by, control, shared) =
            (Arc::clone(answer_by), Arc::clone(control), Arc::clone(&self.shared));
        self.threads.push(std::thread::spawn(move || {
            let mut datagram = vec![0; LONGEST];
            while !shared.end.load(Ordering::Relaxed) {
                let Ok((n, from)) = socket.recv_from(&mut datagram) else {
                    lock(&control).rest(Instant::now());
                    continue;
                };
                if broadcast && !control::is_discovery(&datagram[..n]) {
                    continue;
                }
                let mut control = lock(&control);
                let answer = control.answer(Instant::now(), from, &datagram[..n]);
                tell_refused(&shared, control.refused(), from);
                drop(control);
                if let Some(answer) = answer
                    && let Err(e) = answer_by.send_to(&answer, from)
                {
                    tracing::debug!(%from, error = %e, "an answer could not be sent");
                }
            }
        }));
        Ok(())
    }

    /// Triggers one frame, if [`address::TRIGGER_MODE`] and [`address::TRIGGER_SOURCE`] are 1.
    pub fn trigger(&self) {
        self.registers.set_u32(address::TRIGGER_SOFTWARE, 1);
    }

    /// Returns the register space.
    pub fn registers(&self) -> Registers {
        self.registers.clone()
    }

    /// Returns true from a client's start of an acquisition to its end.
    pub fn is_acquiring(&self) -> bool {
        self.registers.u32(address::ACQUISITION) != 0
    }

    /// Simulates a bad cable: the camera loses this share of its packets, 0 to 1.
    pub fn set_lost_packets(&self, share: f64) {
        self.shared.lose.store(share.to_bits(), Ordering::Relaxed);
    }

    /// Returns the number of control requests refused or dropped.
    pub fn refused(&self) -> u64 {
        self.shared.refused.load(Ordering::Relaxed)
    }
}

impl Drop for VirtualCamera {
    fn drop(&mut self) {
        self.shared.end.store(true, Ordering::Relaxed);
        self.registers.wake();
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

fn lock(control: &Mutex<Control>) -> std::sync::MutexGuard<'_, Control> {
    control.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Stores the count and logs it at powers of two: a flood of requests must not flood the log.
fn tell_refused(shared: &Shared, refused: u64, from: SocketAddr) {
    if refused > shared.refused.swap(refused, Ordering::Relaxed) && refused.is_power_of_two() {
        tracing::warn!(%from, refused, "control requests refused so far");
    }
}

fn not_bound(e: &std::io::Error) -> String {
    match e.kind() {
        std::io::ErrorKind::AddrNotAvailable => "no network interface has this address".into(),
        _ => format!("port {GVCP_PORT} cannot be opened ({e}); is another camera served there?"),
    }
}

/// Opens sockets for discovery broadcasts. Without them a camera is still found by its address.
fn broadcasts(interface: Ipv4Addr) -> Vec<UdpSocket> {
    let subnet = radcam_aravis::broadcast_address(interface).filter(|a| *a != interface);
    let all = [Some(Ipv4Addr::BROADCAST), subnet];
    let bound = |address: Ipv4Addr| {
        let socket = shared_socket(address);
        socket.inspect_err(|e| tracing::debug!(%address, error = %e, "broadcasts are not heard")).ok()
    };
    all.into_iter().flatten().filter_map(bound).collect()
}

/// Opens a control-port socket that other cameras on this host may share.
fn shared_socket(address: Ipv4Addr) -> std::io::Result<UdpSocket> {
    use socket2::{Domain, Protocol, Socket, Type};
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_reuse_address(true)?;
    socket.bind(&SocketAddr::from((address, GVCP_PORT)).into())?;
    Ok(socket.into())
}
