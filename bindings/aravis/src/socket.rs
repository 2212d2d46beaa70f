//! Sockets of libaravis, and kernel filters that keep unchecked packets from it.
//!
//! libaravis 0.8.26 checks neither the sender nor the length of received datagrams (docs/aravis-faults.md),
//! and does not expose its sockets. They are found as the new ones among the open files of this process.

use crate::Error;
use std::collections::BTreeSet;
use std::net::Ipv4Addr;
use std::os::fd::RawFd;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Held wherever libaravis opens sockets, so that new sockets belong to the lock holder.
static OPENING: Mutex<()> = Mutex::new(());

pub(crate) fn opening() -> MutexGuard<'static, ()> {
    OPENING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Open socket: file descriptor and inode, since descriptors are reused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct OpenSocket {
    pub(crate) fd: RawFd,
    inode: u64,
}

/// Returns the bound, unconnected UDP sockets over IPv4 of this process.
pub(crate) fn udp_sockets() -> BTreeSet<OpenSocket> {
    let entries = std::fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
    let of = |entry: std::fs::DirEntry| {
        let fd = entry.file_name().to_str()?.parse().ok()?;
        let target = std::fs::read_link(entry.path()).ok()?;
        let inode = target.to_str()?.strip_prefix("socket:[")?.strip_suffix(']')?.parse().ok()?;
        let udp = option(fd, libc::SO_DOMAIN) == Some(libc::AF_INET)
            && option(fd, libc::SO_PROTOCOL) == Some(libc::IPPROTO_UDP);
        (udp && port(fd).is_some_and(|port| port != 0)).then_some(OpenSocket { fd, inode })
    };
    entries.filter_map(of).collect()
}

/// Reads an integer option of a socket.
pub(crate) fn option(fd: RawFd, name: libc::c_int) -> Option<libc::c_int> {
    let mut value: libc::c_int = 0;
    let mut length = LENGTH_OF_INT;
    // SAFETY: `value` has `length` bytes, and the kernel checks the descriptor.
    let got = unsafe {
        libc::getsockopt(fd, libc::SOL_SOCKET, name, std::ptr::from_mut(&mut value).cast(), &mut length)
    };
    (got == 0).then_some(value)
}

#[expect(clippy::cast_possible_truncation, reason = "4")]
const LENGTH_OF_INT: libc::socklen_t = size_of::<libc::c_int>() as libc::socklen_t;

fn set_option(fd: RawFd, name: libc::c_int, value: libc::c_int) -> bool {
    // SAFETY: the kernel reads an integer of the length that is given, and checks the descriptor.
    let set = unsafe {
        libc::setsockopt(fd, libc::SOL_SOCKET, name, std::ptr::from_ref(&value).cast(), LENGTH_OF_INT)
    };
    set == 0
}

/// Returns the port to which an IPv4 socket is bound.
pub(crate) fn port(fd: RawFd) -> Option<u16> {
    // SAFETY: an address of zeros is a valid value of this plain structure.
    let mut address: libc::sockaddr_in = unsafe { std::mem::zeroed() };
    #[expect(clippy::cast_possible_truncation, reason = "16")]
    let mut length = size_of::<libc::sockaddr_in>() as libc::socklen_t;
    // SAFETY: `address` has `length` bytes, and the kernel checks the descriptor.
    let got = unsafe { libc::getsockname(fd, std::ptr::from_mut(&mut address).cast(), &mut length) };
    (got == 0 && libc::c_int::from(address.sin_family) == libc::AF_INET)
        .then(|| u16::from_be(address.sin_port))
}

/// Sets the receive buffer of a socket, bytes, beyond the system limit if this process may, and returns the
/// granted size.
pub(crate) fn set_receive_buffer(fd: RawFd, bytes: usize) -> usize {
    let wanted = libc::c_int::try_from(bytes).unwrap_or(libc::c_int::MAX);
    if !set_option(fd, libc::SO_RCVBUFFORCE, wanted) {
        set_option(fd, libc::SO_RCVBUF, wanted);
    }
    // The kernel doubles the requested size and reports the double.
    option(fd, libc::SO_RCVBUF).and_then(|n| usize::try_from(n / 2).ok()).unwrap_or(0)
}

/// Discards what a socket has received.
pub(crate) fn drain(fd: RawFd) {
    let mut byte = 0u8;
    loop {
        // SAFETY: one byte at `byte` is ours; the rest of a datagram is dropped by the kernel.
        let n = unsafe { libc::recv(fd, std::ptr::from_mut(&mut byte).cast(), 1, libc::MSG_DONTWAIT) };
        if n < 0 {
            return;
        }
    }
}

/// Offset at which a filter finds the IP header of a packet (linux/filter.h, SKF_NET_OFF).
const IP: u32 = 0xfff0_0000;
/// Length of the UDP header: the filter of a UDP socket sees the datagram from there on.
const UDP: u32 = 8;
const GVCP_PORT: u32 = 3956;
/// Bytes of a GVCP header.
const GVCP_HEADER: u32 = 8;

/// Returns the 8-bit code of a BPF instruction.
#[expect(clippy::cast_possible_truncation, reason = "8 bits")]
const fn instruction(code: u32) -> u16 {
    code as u16
}

const LD_W: u16 = instruction(libc::BPF_LD | libc::BPF_W | libc::BPF_ABS);
const LD_H: u16 = instruction(libc::BPF_LD | libc::BPF_H | libc::BPF_ABS);
const LD_B: u16 = instruction(libc::BPF_LD | libc::BPF_B | libc::BPF_ABS);
const LD_LEN: u16 = instruction(libc::BPF_LD | libc::BPF_W | libc::BPF_LEN);
const LD_MEM: u16 = instruction(libc::BPF_LD | libc::BPF_W | libc::BPF_MEM);
const STORE: u16 = instruction(libc::BPF_ST);
const AND: u16 = instruction(libc::BPF_ALU | libc::BPF_AND | libc::BPF_K);
const RETURN: u16 = instruction(libc::BPF_RET | libc::BPF_K);
const EQUAL: u16 = instruction(libc::BPF_JMP | libc::BPF_JEQ | libc::BPF_K);
const AT_LEAST: u16 = instruction(libc::BPF_JMP | libc::BPF_JGE | libc::BPF_K);
const ABOVE: u16 = instruction(libc::BPF_JMP | libc::BPF_JGT | libc::BPF_K);
const ANY_BIT: u16 = instruction(libc::BPF_JMP | libc::BPF_JSET | libc::BPF_K);

/// Target of a jump.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum To {
    Next,
    Drop,
    Accept,
    Label(usize),
}

/// Classic BPF program under construction; jumps go forward only.
#[derive(Debug, Default)]
struct Program {
    code: Vec<(u16, u32, To, To)>,
    labels: Vec<usize>,
}

impl Program {
    fn step(&mut self, code: u16, value: u32) {
        self.code.push((code, value, To::Next, To::Next));
    }

    fn jump(&mut self, code: u16, value: u32, yes: To, no: To) {
        self.code.push((code, value, yes, no));
    }

    /// Drops packets whose accumulator differs from this value.
    fn only(&mut self, value: u32) {
        self.jump(EQUAL, value, To::Next, To::Drop);
    }

    /// Drops packets whose accumulator is outside these bounds.
    fn between(&mut self, min: u32, max: u32) {
        self.jump(AT_LEAST, min, To::Next, To::Drop);
        self.jump(ABOVE, max, To::Drop, To::Next);
    }

    fn label(&mut self) -> usize {
        self.labels.push(usize::MAX);
        self.labels.len() - 1
    }

    fn here(&mut self, label: usize) {
        self.labels[label] = self.code.len();
    }

    /// Returns the program, with the accept and drop instructions at its end.
    fn build(mut self) -> Result<Vec<libc::sock_filter>, Error> {
        let (accept, drop) = (self.code.len(), self.code.len() + 1);
        self.step(RETURN, u32::MAX);
        self.step(RETURN, 0);
        let place = |at: usize, to: To| {
            let target = match to {
                To::Next => at + 1,
                To::Accept => accept,
                To::Drop => drop,
                To::Label(label) => self.labels[label],
            };
            u8::try_from(target - at - 1).map_err(|_| Error::new("socket filter", "a jump is too long"))
        };
        let one = |(at, (code, k, yes, no)): (usize, &(u16, u32, To, To))| {
            Ok(libc::sock_filter { code: *code, jt: place(at, *yes)?, jf: place(at, *no)?, k: *k })
        };
        self.code.iter().enumerate().map(one).collect()
    }
}

/// Builds a filter that drops every packet.
pub(crate) fn nothing() -> Result<Vec<libc::sock_filter>, Error> {
    let mut program = Program::default();
    program.jump(EQUAL, 0, To::Drop, To::Drop);
    program.build()
}

/// Builds a filter for a camera's answers to control requests: from its address and control port, and not
/// longer than the length field allows.
pub(crate) fn answers_of(camera: Ipv4Addr) -> Result<Vec<libc::sock_filter>, Error> {
    let mut p = Program::default();
    from(&mut p, camera, GVCP_PORT);
    p.step(LD_LEN, 0);
    p.between(UDP + GVCP_HEADER, UDP + GVCP_HEADER + 0xffff);
    p.build()
}

/// Drops packets from another host or port.
fn from(p: &mut Program, camera: Ipv4Addr, port: u32) {
    p.step(LD_W, IP + 12);
    p.only(u32::from(camera));
    if port != 0 {
        p.step(LD_H, 0);
        p.only(port);
    }
}

/// Format of an acquisition's packets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Frames {
    /// Address of the camera.
    pub(crate) camera: Ipv4Addr,
    /// Source port; 0 if unknown.
    pub(crate) port: u16,
    /// Packet size with IP and UDP headers, bytes.
    pub(crate) packet: u32,
    /// Frame size, bytes.
    pub(crate) payload: u32,
}

/// Bytes of the headers of IP and UDP.
const IP_UDP: u32 = 28;
/// Bytes of a GVSP header with 16-bit block ids, and with extended ones (GigE Vision 2.0, 24.1).
const HEADERS: [u32; 2] = [8, 20];
/// Slots of the program's scratch memory.
const PACKET_ID: u32 = 0;
const STATUS: u32 = 1;
const LEADER: u32 = 1;
const TRAILER: u32 = 2;
const PAYLOAD: u32 = 3;
/// Minimum sizes behind the header, bytes: leader of images, leader of chunk data, trailer.
const IMAGE_LEADER: u32 = 36;
const CHUNK_LEADER: u32 = 12;
const SHORTEST_TRAILER: u32 = 4;

/// Builds a filter for packets of a camera's frames: from its address (and port), with complete headers,
/// leaders of images, and packet ids and lengths within a frame of this size. libaravis relies on each of
/// these; docs/aravis-faults.md lists packets with which it fails.
pub(crate) fn frames_of(frames: Frames) -> Result<Vec<libc::sock_filter>, Error> {
    let smallest = IP_UDP + HEADERS[1] + IMAGE_LEADER;
    if frames.packet <= smallest || frames.payload == 0 {
        let message = format!("packets of {} bytes for frames of {}", frames.packet, frames.payload);
        return Err(Error::new("socket filter", message));
    }
    let mut p = Program::default();
    from(&mut p, frames.camera, frames.port.into());
    p.step(LD_LEN, 0);
    p.between(UDP + HEADERS[0], UDP + frames.packet - IP_UDP);
    // Status of a first transmission, of a resend, or of the answer that a packet is unavailable.
    p.step(LD_H, UDP);
    p.step(AND, 0x8000);
    p.step(STORE, STATUS);
    let known = p.label();
    p.jump(EQUAL, 0x8000, To::Label(known), To::Next);
    p.step(LD_H, UDP);
    p.jump(EQUAL, 0, To::Label(known), To::Next);
    p.only(0x0100);
    p.here(known);
    let extended = p.label();
    p.step(LD_B, UDP + 4);
    p.jump(ANY_BIT, 0x80, To::Label(extended), To::Next);
    p.step(LD_W, UDP + 4);
    p.step(AND, 0xff_ffff);
    p.step(STORE, PACKET_ID);
    formats(&mut p, &frames, HEADERS[0]);
    p.here(extended);
    p.step(LD_LEN, 0);
    p.jump(AT_LEAST, UDP + HEADERS[1], To::Next, To::Drop);
    p.step(LD_W, UDP + 16);
    p.step(STORE, PACKET_ID);
    formats(&mut p, &frames, HEADERS[1]);
    p.build()
}

/// Accepts leaders, trailers and data packets behind a header of this length; drops everything else.
fn formats(p: &mut Program, frames: &Frames, header: u32) {
    let block = frames.packet - IP_UDP - header;
    let data = frames.payload.div_ceil(block);
    let rest = frames.payload - (data - 1) * block;
    let (trailer, payload) = (p.label(), p.label());
    p.step(LD_B, UDP + 4);
    p.step(AND, 0x7f);
    p.jump(EQUAL, TRAILER, To::Label(trailer), To::Next);
    p.jump(EQUAL, PAYLOAD, To::Label(payload), To::Next);
    p.only(LEADER);
    p.step(LD_MEM, PACKET_ID);
    p.only(0);
    leader(p, header);
    p.here(trailer);
    p.step(LD_MEM, PACKET_ID);
    p.between(1, data + 1);
    p.step(LD_LEN, 0);
    p.jump(AT_LEAST, UDP + header + SHORTEST_TRAILER, To::Accept, To::Drop);
    p.here(payload);
    p.step(LD_MEM, PACKET_ID);
    p.between(1, data);
    p.step(LD_MEM, STATUS);
    p.jump(EQUAL, 0, To::Next, To::Accept);
    let last = p.label();
    p.step(LD_MEM, PACKET_ID);
    p.jump(EQUAL, data, To::Label(last), To::Next);
    p.step(LD_LEN, 0);
    p.jump(EQUAL, UDP + header + block, To::Accept, To::Drop);
    p.here(last);
    p.step(LD_LEN, 0);
    p.jump(AT_LEAST, UDP + header + rest, To::Accept, To::Drop);
}

/// Accepts leaders by payload type (GigE Vision 2.0, table 24-4): 1 image, 4 chunk data, 5 chunk data with an
/// image; bit 14 marks chunks that follow.
fn leader(p: &mut Program, header: u32) {
    let chunk = p.label();
    p.step(LD_LEN, 0);
    p.jump(AT_LEAST, UDP + header + CHUNK_LEADER, To::Next, To::Drop);
    p.step(LD_H, UDP + header + 2);
    p.step(AND, 0x3fff);
    p.jump(EQUAL, 4, To::Accept, To::Next);
    p.jump(EQUAL, 1, To::Label(chunk), To::Next);
    p.only(5);
    p.here(chunk);
    p.step(LD_LEN, 0);
    p.jump(AT_LEAST, UDP + header + IMAGE_LEADER, To::Accept, To::Drop);
}

/// Attaches a filter to a socket, replacing its present one.
pub(crate) fn attach(fd: RawFd, program: &[libc::sock_filter]) -> Result<(), Error> {
    let fault = |e: std::io::Error| Error::new("socket filter", e);
    let len = u16::try_from(program.len()).map_err(|e| Error::new("socket filter", e))?;
    let all = libc::sock_fprog { len, filter: program.as_ptr().cast_mut() };
    #[expect(clippy::cast_possible_truncation, reason = "16")]
    let size = size_of::<libc::sock_fprog>() as libc::socklen_t;
    // SAFETY: the kernel copies `len` instructions from `program`, which lives until the call returns, and
    // checks each and the descriptor.
    let set = unsafe {
        libc::setsockopt(fd, libc::SOL_SOCKET, libc::SO_ATTACH_FILTER, std::ptr::from_ref(&all).cast(), size)
    };
    if set == 0 { Ok(()) } else { Err(fault(std::io::Error::last_os_error())) }
}

/// Returns the broadcast address of the network of an interface (its IPv4 address).
pub fn broadcast_address(interface: Ipv4Addr) -> Option<Ipv4Addr> {
    let mut list = std::ptr::null_mut();
    // SAFETY: the call fills in one pointer, to a list that is freed below.
    if unsafe { libc::getifaddrs(&mut list) } != 0 {
        return None;
    }
    let (mut next, mut found) = (list, None);
    while !next.is_null() && found.is_none() {
        // SAFETY: entries of the list live until it is freed.
        let entry = unsafe { &*next };
        if ipv4(entry.ifa_addr) == Some(interface) {
            found = ipv4(entry.ifa_ifu);
        }
        next = entry.ifa_next;
    }
    // SAFETY: the list came from getifaddrs, and no reference into it is left.
    unsafe { libc::freeifaddrs(list) };
    found
}

/// Reads an IPv4 address behind a pointer of getifaddrs.
fn ipv4(address: *const libc::sockaddr) -> Option<Ipv4Addr> {
    // SAFETY: getifaddrs gives null or an address whose family tells its type; that of AF_INET is a sockaddr_in.
    let address = unsafe {
        let family = address.as_ref()?.sa_family;
        (libc::c_int::from(family) == libc::AF_INET)
            .then(|| address.cast::<libc::sockaddr_in>().read_unaligned())?
    };
    Some(Ipv4Addr::from(u32::from_be(address.sin_addr.s_addr)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::UdpSocket;
    use std::os::fd::AsRawFd;
    use std::time::Duration;

    const FRAME: Frames =
        Frames { camera: Ipv4Addr::new(127, 0, 0, 3), port: 0, packet: 1400, payload: 3000 };

    /// Returns the packets that pass a filter.
    fn passed(program: &[libc::sock_filter], sender: Ipv4Addr, packets: &[Vec<u8>]) -> Vec<Vec<u8>> {
        let receiver = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        attach(receiver.as_raw_fd(), program).unwrap();
        receiver.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
        let sender = UdpSocket::bind((sender, 0)).unwrap();
        let mut buffer = vec![0; 65_536];
        let mut out = Vec::new();
        for packet in packets {
            sender.send_to(packet, receiver.local_addr().unwrap()).unwrap();
            // Loopback delivers synchronously.
            receiver.set_nonblocking(true).unwrap();
            if let Ok(n) = receiver.recv(&mut buffer) {
                out.push(buffer[..n].to_vec());
            }
        }
        out
    }

    fn packet(format: u8, id: u32, body: usize) -> Vec<u8> {
        let mut out = vec![0, 0, 0, 9];
        out.extend((u32::from(format) << 24 | id).to_be_bytes());
        out.resize(8 + body, 0);
        if u32::from(format & 0x7f) == LEADER && body >= 4 {
            out[11] = 1;
        }
        out
    }

    fn extended(format: u8, id: u32, body: usize) -> Vec<u8> {
        let mut out = vec![0; 20];
        out[4] = 0x80 | format;
        out[15] = 9;
        out[16..20].copy_from_slice(&id.to_be_bytes());
        out.resize(20 + body, 0);
        if u32::from(format) == LEADER && body >= 4 {
            out[23] = 1;
        }
        out
    }

    #[test]
    fn sound_packets_of_the_camera_pass_and_no_others() {
        let program = frames_of(FRAME).unwrap();
        // Pixel bytes of the packets: 1364, 1364 and 272; behind extended headers 1352, 1352 and 296.
        let mut error = packet(3, 2, 0);
        error[..2].copy_from_slice(&[0x80, 0x0c]);
        let mut again = packet(3, 1, 1364);
        again[0] = 1;
        let sound = [
            packet(1, 0, 36),
            packet(1, 0, 40),
            packet(3, 1, 1364),
            packet(3, 2, 1364),
            packet(3, 3, 272),
            packet(3, 3, 1364),
            packet(2, 4, 8),
            extended(1, 0, 36),
            extended(3, 1, 1352),
            extended(3, 3, 296),
            extended(2, 4, 8),
            error,
            again,
        ];
        assert_eq!(passed(&program, FRAME.camera, &sound), sound);
        assert_eq!(passed(&program, Ipv4Addr::new(127, 0, 0, 4), &sound), Vec::<Vec<u8>>::new());
        let mut multipart = packet(1, 0, 60);
        multipart[11] = 10;
        let mut status = packet(3, 1, 1364);
        status[1] = 1;
        let mut bent = vec![
            vec![],
            vec![0; 1],
            vec![0; 4],
            vec![0; 7],
            multipart,
            status,
            packet(1, 0, 35),
            packet(1, 0, 4),
            packet(1, 0, 0),
            packet(1, 1, 36),
            packet(2, 0, 8),
            packet(2, 5, 8),
            packet(2, 0xff_ffff, 8),
            packet(2, 4, 0),
            packet(3, 0, 1364),
            packet(3, 4, 1364),
            packet(3, 1, 1363),
            packet(3, 1, 1365),
            packet(3, 3, 271),
            packet(3, 3, 0),
            packet(3, 3, 1365),
            packet(4, 0, 36),
            packet(7, 1, 16),
            packet(8, 1, 16),
            packet(0, 0, 36),
            extended(1, 0, 35),
            extended(2, u32::MAX, 8),
            extended(2, u32::MAX - 1, 8),
            extended(2, 0, 8),
            extended(3, 1, 1353),
            extended(3, 1, 1351),
            extended(3, u32::MAX, 1352),
        ];
        bent.extend((8..20).map(|n| extended(3, 1, 0)[..n].to_vec()));
        assert_eq!(passed(&program, FRAME.camera, &bent), Vec::<Vec<u8>>::new());
        assert_eq!(passed(&nothing().unwrap(), FRAME.camera, &sound), Vec::<Vec<u8>>::new());
    }

    #[test]
    fn a_port_that_the_camera_tells_is_the_only_one() {
        let receiver = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let [camera, other] = [(); 2].map(|()| UdpSocket::bind((FRAME.camera, 0)).unwrap());
        let port = camera.local_addr().unwrap().port();
        attach(receiver.as_raw_fd(), &frames_of(Frames { port, ..FRAME }).unwrap()).unwrap();
        receiver.set_nonblocking(true).unwrap();
        let got = |from: &UdpSocket| {
            from.send_to(&packet(1, 0, 36), receiver.local_addr().unwrap()).unwrap();
            receiver.recv(&mut [0; 100]).is_ok()
        };
        assert_eq!((got(&camera), got(&other), got(&camera)), (true, false, true));
    }

    #[test]
    fn new_sockets_are_found_and_drained() {
        let _one = opening();
        let before = udp_sockets();
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let found = udp_sockets().difference(&before).any(|s| s.fd == socket.as_raw_fd());
        assert!(found && port(socket.as_raw_fd()) == Some(socket.local_addr().unwrap().port()));
        for _ in 0..3 {
            socket.send_to(&[1, 2], socket.local_addr().unwrap()).unwrap();
        }
        drain(socket.as_raw_fd());
        socket.set_nonblocking(true).unwrap();
        assert!(socket.recv(&mut [0; 2]).is_err());
        assert!(set_receive_buffer(socket.as_raw_fd(), 100_000) >= 100_000);
    }

    #[test]
    fn packets_too_small_for_a_leader_are_refused() {
        for packet in [0, 36, 64, 84] {
            assert!(frames_of(Frames { packet, ..FRAME }).is_err());
        }
        assert!(frames_of(Frames { payload: 0, ..FRAME }).is_err());
    }
}
