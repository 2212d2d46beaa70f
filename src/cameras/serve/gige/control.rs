//! Control protocol requests (GVCP; GigE Vision 2.0, chapters 13 to 18), each checked before a register is
//! touched.

use super::registers::{MIN_PACKET, REGISTER_SPACE, Registers, Rules, address, word};
use std::net::SocketAddr;
use std::time::{Duration, Instant};

/// First byte of a request.
const KEY: u8 = 0x42;
/// Bytes of a header: key, flags, command, length, request id.
const HEADER: usize = 8;
/// Maximum size of a control datagram behind the IP and UDP headers (GigE Vision 2.0, 13.1: 576 bytes in
/// all).
const LONGEST: usize = MIN_PACKET as usize - 28;
/// Maximum bytes per read: header and address stand before them.
const LONGEST_READ: u16 = LONGEST as u16 - HEADER as u16 - 4;
/// Size of the discovery answer, bytes.
const DISCOVERY: usize = 0xf8;
/// Minimum and maximum heartbeat timeout: a shorter one would lose control between two requests, a longer one
/// would leave a camera with a client that is gone.
const HEARTBEAT: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(600)];

const DISCOVERY_CMD: u16 = 0x0002;
const PACKETRESEND_CMD: u16 = 0x0040;
const READREG_CMD: u16 = 0x0080;
const WRITEREG_CMD: u16 = 0x0082;
const READMEM_CMD: u16 = 0x0084;
const WRITEMEM_CMD: u16 = 0x0086;

/// Status of a refusal (GigE Vision 2.0, table 19-1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u16)]
enum Status {
    NotImplemented = 0x8001,
    InvalidParameter = 0x8002,
    InvalidAddress = 0x8003,
    WriteProtect = 0x8004,
    BadAlignment = 0x8005,
    AccessDenied = 0x8006,
    InvalidHeader = 0x800e,
}

/// Control channel: the client with write access, and the answers to all clients.
pub struct Control {
    registers: Registers,
    rules: Rules,
    /// Client in control, and the time of its last request.
    holder: Option<(SocketAddr, Instant)>,
    refused: u64,
}

/// Parsed request.
struct Request<'a> {
    command: u16,
    id: u16,
    body: &'a [u8],
}

/// Reads a 16-bit number at an offset.
fn half(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes(bytes.get(at..at + 2)?.try_into().ok()?))
}

/// Reads a 32-bit number at an offset.
fn number(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

/// Returns true for a discovery request.
pub(super) fn is_discovery(datagram: &[u8]) -> bool {
    datagram.first() == Some(&KEY) && half(datagram, 2) == Some(DISCOVERY_CMD)
}

impl<'a> Request<'a> {
    /// Parses a datagram into a request and the length in its header. `None`: not a request, not answered.
    /// Request id 0 is invalid.
    fn parse(datagram: &'a [u8]) -> Option<(Self, u16)> {
        let (command, length, id) = (half(datagram, 2)?, half(datagram, 4)?, half(datagram, 6)?);
        let body = datagram.get(HEADER..)?;
        (datagram[0] == KEY && id != 0).then_some((Self { command, id, body }, length))
    }
}

fn packet(status: u16, command: u16, id: u16, body: &[u8]) -> Vec<u8> {
    let length = u16::try_from(body.len()).unwrap_or(0);
    let mut out: Vec<u8> = [status, command, length, id].iter().flat_map(|n| n.to_be_bytes()).collect();
    out.extend(body);
    out
}

impl Control {
    pub(super) fn new(registers: Registers, rules: Rules) -> Self {
        Self { registers, rules, holder: None, refused: 0 }
    }

    /// Returns the number of requests refused or dropped so far.
    pub(super) fn refused(&self) -> u64 {
        self.refused
    }

    /// Ends the control of a silent client (heartbeat timeout).
    pub(super) fn rest(&mut self, now: Instant) {
        let ms = self.registers.u32(address::HEARTBEAT_MS);
        let patience = Duration::from_millis(ms.into()).clamp(HEARTBEAT[0], HEARTBEAT[1]);
        if let Some((client, last)) = self.holder
            && now.saturating_duration_since(last) > patience
        {
            tracing::warn!(%client, "heartbeat timeout: the client has lost control");
            self.release();
        }
    }

    /// Releases control. A camera without a controlling client sends no frames (GigE Vision 2.0, 28.18).
    fn release(&mut self) {
        self.holder = None;
        self.registers.set_u32(address::PRIVILEGE, 0);
        self.registers.set_u32(address::ACQUISITION, 0);
    }

    /// Returns the answer to a datagram, if it needs one.
    pub(super) fn answer(&mut self, now: Instant, from: SocketAddr, datagram: &[u8]) -> Option<Vec<u8>> {
        self.rest(now);
        let Some((request, length)) = Request::parse(datagram) else {
            self.refused += 1;
            return None;
        };
        let sound = usize::from(length) == request.body.len() && datagram.len() <= LONGEST;
        let done = if sound { self.carry_out(now, from, &request) } else { Err(Status::InvalidHeader) };
        if let Some((client, last)) = &mut self.holder
            && *client == from
            && done.is_ok()
        {
            *last = now;
        }
        match done {
            Ok(body) => Some(packet(0, request.command + 1, request.id, &body)),
            Err(status) => {
                self.refused += 1;
                tracing::debug!(%from, command = request.command, ?status, "control request refused");
                // Resend requests have no answer.
                let silent = request.command == PACKETRESEND_CMD;
                (!silent).then(|| packet(status as u16, request.command | 1, request.id, &[]))
            }
        }
    }

    fn carry_out(
        &mut self,
        now: Instant,
        from: SocketAddr,
        request: &Request<'_>,
    ) -> Result<Vec<u8>, Status> {
        let body = request.body;
        match request.command {
            DISCOVERY_CMD if body.is_empty() => self.memory(0, DISCOVERY),
            READREG_CMD if whole(body, 4) => {
                let places = body.chunks_exact(4).filter_map(|b| number(b, 0));
                Ok(places.map(|at| self.memory(at, 4)).collect::<Result<Vec<_>, _>>()?.concat())
            }
            READMEM_CMD if body.len() == 8 => {
                let (at, count) = (number(body, 0), half(body, 6).filter(|n| (1..=LONGEST_READ).contains(n)));
                let (at, count) = at.zip(count).ok_or(Status::InvalidParameter)?;
                let bytes = self.memory(at, count.into())?;
                Ok([at.to_be_bytes().to_vec(), bytes].concat())
            }
            WRITEREG_CMD if whole(body, 8) => {
                for pair in body.chunks_exact(8) {
                    let at = number(pair, 0).ok_or(Status::InvalidParameter)?;
                    self.write(now, from, at, &pair[4..])?;
                }
                Ok(written(body.len() / 8))
            }
            WRITEMEM_CMD if body.len() > 4 => {
                let at = number(body, 0).ok_or(Status::InvalidParameter)?;
                self.write(now, from, at, &body[4..])?;
                Ok(written(body.len() - 4))
            }
            DISCOVERY_CMD | READREG_CMD | READMEM_CMD | WRITEREG_CMD | WRITEMEM_CMD => {
                Err(Status::InvalidHeader)
            }
            _ => Err(Status::NotImplemented),
        }
    }

    /// Reads whole words of registers or description.
    fn memory(&self, at: u32, count: usize) -> Result<Vec<u8>, Status> {
        if !at.is_multiple_of(4) || !count.is_multiple_of(4) {
            return Err(Status::BadAlignment);
        }
        let at = at as usize;
        self.registers.lock().get(at..at + count).map(<[u8]>::to_vec).ok_or(Status::InvalidAddress)
    }

    /// Writes whole words, all or none.
    fn write(&mut self, now: Instant, from: SocketAddr, at: u32, bytes: &[u8]) -> Result<(), Status> {
        if !at.is_multiple_of(4) || !bytes.len().is_multiple_of(4) {
            return Err(Status::BadAlignment);
        }
        let count = u32::try_from(bytes.len()).map_err(|_| Status::InvalidParameter)?;
        let end = at.checked_add(count).ok_or(Status::InvalidAddress)?;
        if end > REGISTER_SPACE {
            let read = self.registers.lock().len();
            return Err(if end as usize <= read { Status::WriteProtect } else { Status::InvalidAddress });
        }
        let takes_control = at == address::PRIVILEGE && count == 4;
        match self.holder {
            Some((client, _)) if client != from => return Err(Status::AccessDenied),
            None if !takes_control => return Err(Status::AccessDenied),
            _ => {}
        }
        if self.rules.fixed.iter().any(|range| at < range.end && end > range.start) {
            return Err(Status::WriteProtect);
        }
        let written = |address: u32| (address >= at && address < end).then(|| word(bytes, address - at));
        for limit in &self.rules.limits {
            if written(limit.address).is_some_and(|v| !(limit.min..=limit.max).contains(&(v & limit.mask))) {
                return Err(Status::InvalidParameter);
            }
        }
        let registers = self.registers.clone();
        let _turn = registers.turn_to_write();
        let ran = self.registers.u32(address::ACQUISITION) != 0;
        self.registers.write(at, bytes);
        if !ran && written(address::ACQUISITION).is_some_and(|v| v != 0) {
            self.registers.begin();
        }
        match written(address::PRIVILEGE) {
            Some(0) => self.release(),
            Some(_) => self.holder = Some((from, now)),
            None => {}
        }
        Ok(())
    }
}

/// Returns true for one or more whole entries of this size.
fn whole(body: &[u8], entry: usize) -> bool {
    !body.is_empty() && body.len().is_multiple_of(entry)
}

/// Returns the body of the answer to a write request.
fn written(count: usize) -> Vec<u8> {
    let count = u16::try_from(count).unwrap_or(u16::MAX);
    [[0; 2], count.to_be_bytes()].concat()
}

#[cfg(test)]
mod tests {
    use super::super::registers::Initial;
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};
    use std::net::Ipv4Addr;

    const CLIENT: &str = "127.0.0.1:5000";

    fn control() -> Control {
        let mut initial = Initial::default();
        initial.set_u32(address::SENSOR_WIDTH, 64);
        initial.limit(address::WIDTH, 1, 64);
        let (registers, rules) = initial.build(Ipv4Addr::LOCALHOST, 4000, "A1", "<xml/>");
        Control::new(registers, rules)
    }

    fn request(command: u16, body: &[u8]) -> Vec<u8> {
        let mut out = vec![KEY, 1];
        [command, body.len() as u16, 7].iter().for_each(|n| out.extend(n.to_be_bytes()));
        out.extend(body);
        out
    }

    fn words(all: &[u32]) -> Vec<u8> {
        all.iter().flat_map(|w| w.to_be_bytes()).collect()
    }

    /// Returns status and body of the answer.
    fn ask(control: &mut Control, from: &str, datagram: &[u8]) -> Option<(u16, Vec<u8>)> {
        let answer = control.answer(Instant::now(), from.parse().unwrap(), datagram)?;
        assert_eq!(half(&answer, 4).unwrap() as usize, answer.len() - HEADER);
        Some((half(&answer, 0).unwrap(), answer[HEADER..].to_vec()))
    }

    fn status(control: &mut Control, datagram: &[u8]) -> u16 {
        ask(control, CLIENT, datagram).unwrap().0
    }

    #[test]
    fn what_is_sound_is_answered() {
        let mut c = control();
        assert_eq!(ask(&mut c, CLIENT, &request(DISCOVERY_CMD, &[])).unwrap().1.len(), DISCOVERY);
        let (at, source) = (words(&[address::SOURCE_PORT]), words(&[4000]));
        assert_eq!(ask(&mut c, CLIENT, &request(READREG_CMD, &at)), Some((0, source.clone())));
        let two = words(&[address::SOURCE_PORT, address::SENSOR_WIDTH]);
        assert_eq!(ask(&mut c, CLIENT, &request(READREG_CMD, &two)), Some((0, words(&[4000, 64]))));
        let read = request(READMEM_CMD, &words(&[REGISTER_SPACE, 512]));
        assert!(ask(&mut c, CLIENT, &read).unwrap().1[4..].starts_with(b"<xml/>"));
        let control = request(WRITEREG_CMD, &words(&[address::PRIVILEGE, 2]));
        assert_eq!(ask(&mut c, CLIENT, &control), Some((0, words(&[1]))));
        assert_eq!(status(&mut c, &request(WRITEMEM_CMD, &words(&[address::WIDTH, 32]))), 0);
        assert_eq!(c.registers.u32(address::WIDTH), 32);
        assert_eq!(c.refused(), 0);
    }

    /// Invalid requests get the GigE Vision status of their kind; registers stay unchanged.
    #[test]
    fn what_is_wrong_is_refused_by_its_kind() {
        let mut c = control();
        let width = words(&[address::WIDTH, 32]);
        assert_eq!(status(&mut c, &request(WRITEREG_CMD, &width)), Status::AccessDenied as u16);
        assert_eq!(status(&mut c, &request(WRITEREG_CMD, &words(&[address::PRIVILEGE, 2]))), 0);
        let before = c.registers.lock().clone();
        use Status::*;
        for (command, body, wanted) in [
            (READMEM_CMD, words(&[0xffff_fffc, 512]), InvalidAddress),
            (READMEM_CMD, words(&[REGISTER_SPACE, 516]), InvalidAddress),
            (READMEM_CMD, words(&[REGISTER_SPACE - 4, 0]), InvalidParameter),
            (READMEM_CMD, words(&[0, 540]), InvalidParameter),
            (READMEM_CMD, words(&[0, 65_535]), InvalidParameter),
            (READMEM_CMD, words(&[0, 6]), BadAlignment),
            (READMEM_CMD, words(&[2, 8]), BadAlignment),
            (READMEM_CMD, words(&[0]), InvalidHeader),
            (READREG_CMD, words(&[0x7fff_fffc]), InvalidAddress),
            (READREG_CMD, words(&[1]), BadAlignment),
            (READREG_CMD, vec![0; 3], InvalidHeader),
            (READREG_CMD, vec![], InvalidHeader),
            (WRITEREG_CMD, words(&[address::WIDTH]), InvalidHeader),
            (WRITEREG_CMD, words(&[address::WIDTH, 65]), InvalidParameter),
            (WRITEREG_CMD, words(&[address::WIDTH, 0]), InvalidParameter),
            (WRITEREG_CMD, words(&[address::PACKET_SIZE, 36]), InvalidParameter),
            (WRITEMEM_CMD, words(&[address::STREAM_PORT, 5000, 36]), InvalidParameter),
            (WRITEREG_CMD, words(&[address::SENSOR_WIDTH, 1]), WriteProtect),
            (WRITEREG_CMD, words(&[REGISTER_SPACE, 1]), WriteProtect),
            (WRITEREG_CMD, words(&[0xffff_fffc, 1]), InvalidAddress),
            (WRITEMEM_CMD, words(&[REGISTER_SPACE - 4, 1, 2]), WriteProtect),
            (WRITEMEM_CMD, vec![], InvalidHeader),
            (WRITEMEM_CMD, vec![0; 1], InvalidHeader),
            (WRITEMEM_CMD, vec![0; 4], InvalidHeader),
            (WRITEMEM_CMD, vec![0; 5], BadAlignment),
            (DISCOVERY_CMD, vec![0; 4], InvalidHeader),
            (0x1234, vec![], NotImplemented),
        ] {
            assert_eq!(status(&mut c, &request(command, &body)), wanted as u16, "{command:#x} {body:?}");
        }
        let refused = c.refused();
        // Datagrams that are no request get no answer: an answer would hit the owner of a forged sender
        // address.
        let resend = request(PACKETRESEND_CMD, &words(&[0, 0, 0]));
        for datagram in [&[][..], &[KEY], &[KEY; 7], &[0; 8], &[KEY, 1, 0, 2, 0, 0, 0, 0], &resend] {
            assert_eq!(ask(&mut c, CLIENT, datagram), None);
        }
        // The length in the header differs from that of the datagram.
        for change in [-1, 1, 4, 100] {
            let mut bent = request(WRITEMEM_CMD, &words(&[address::WIDTH, 32]));
            bent[5] = bent[5].wrapping_add_signed(change);
            assert_eq!(status(&mut c, &bent), InvalidHeader as u16);
        }
        assert_eq!(status(&mut c, &request(READREG_CMD, &[0; 576])), InvalidHeader as u16);
        assert_eq!(c.refused(), refused + 11);
        assert!(*c.registers.lock() == before);
    }

    /// One client has control until it releases it or falls silent.
    #[test]
    fn control_is_held_and_lost() {
        let mut c = control();
        let (other, take) = ("127.0.0.1:5001", request(WRITEREG_CMD, &words(&[address::PRIVILEGE, 2])));
        assert_eq!(status(&mut c, &take), 0);
        assert_eq!(status(&mut c, &request(WRITEREG_CMD, &words(&[address::ACQUISITION, 1]))), 0);
        assert_eq!(ask(&mut c, other, &take).unwrap().0, Status::AccessDenied as u16);
        let later = |s| Instant::now() + Duration::from_secs(s);
        c.rest(later(2));
        assert_eq!(c.registers.u32(address::ACQUISITION), 1);
        c.rest(later(4));
        assert_eq!((c.registers.u32(address::ACQUISITION), c.registers.u32(address::PRIVILEGE)), (0, 0));
        assert_eq!(ask(&mut c, other, &take).unwrap().0, 0);
        let give = request(WRITEREG_CMD, &words(&[address::PRIVILEGE, 0]));
        assert_eq!(ask(&mut c, other, &give).unwrap().0, 0);
        assert_eq!(status(&mut c, &take), 0);
    }

    /// Random bytes, and valid headers with random bodies: no panic, and an answer is never longer than a
    /// request may be.
    #[test]
    fn a_million_random_datagrams() {
        let mut c = control();
        let from = CLIENT.parse().unwrap();
        for n in 0..1_000_000u64 {
            let mut random = PixelRng::new(2026, Stream::Effect, n, 0, 0);
            let mut byte = || (random.uniform() * 256.0) as u8;
            let length = usize::from(byte()) % 24;
            let mut bytes: Vec<u8> = (0..length).map(|_| byte()).collect();
            if n % 2 == 0 {
                let commands = [DISCOVERY_CMD, READREG_CMD, READMEM_CMD, WRITEREG_CMD, WRITEMEM_CMD];
                let command = commands[usize::from(byte()) % commands.len()];
                bytes = request(command, &bytes);
            }
            let answer = c.answer(Instant::now(), from, &bytes);
            assert!(answer.is_none_or(|a| a.len() <= LONGEST));
        }
        assert!(c.refused() > 400_000);
    }
}
