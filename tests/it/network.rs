//! Networks between the programs of a test: two hosts with a link that does damage, and three hosts on one
//! wire.

use crate::support::program;
use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};
use std::ffi::OsStr;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::fd::AsFd;
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

/// Addresses of the camera, its client and another host on the wire of [`Hosts`].
pub const ADDRESSES: [&str; 3] = ["10.78.0.1", "10.78.0.2", "10.78.0.3"];

/// Runs `ip` with arguments between spaces; true where it did as told.
fn ip(arguments: &str) -> bool {
    let status = Command::new("ip").args(arguments.split(' ')).stderr(Stdio::null()).status();
    status.is_ok_and(|s| s.success())
}

/// Names of namespaces that no other test has: tests run at once in one process.
fn names<const N: usize>(ends: [&str; N]) -> [String; N] {
    static MADE: AtomicU32 = AtomicU32::new(0);
    let number = MADE.fetch_add(1, Ordering::Relaxed);
    ends.map(|end| format!("radcam-{}-{number}-{end}", std::process::id()))
}

/// Two namespaces and what lies between them.
pub struct Network {
    child: Child,
    commands: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
    pub names: [String; 2],
}

impl Network {
    /// `None`, with the reason printed, where namespaces cannot be made.
    pub fn new() -> Option<Self> {
        let names = names(["a", "b"]);
        if !ip(&format!("netns add {}", names[0])) || !Path::new("/dev/net/tun").exists() {
            println!("SKIPPED: network namespaces and /dev/net/tun need root and iproute2");
            return None;
        }
        assert!(ip(&format!("netns del {}", names[0])));
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/outside/network.py");
        let mut child = Command::new("python3")
            .arg(script)
            .args(&names)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (commands, answers) = (child.stdin.take(), BufReader::new(child.stdout.take().unwrap()));
        let mut network = Self { child, commands, answers, names };
        assert_eq!(network.answer(), "ready");
        Some(network)
    }

    fn answer(&mut self) -> String {
        let mut line = String::new();
        self.answers.read_line(&mut line).unwrap();
        line.trim_end().into()
    }

    pub fn tell(&mut self, command: &str) -> String {
        writeln!(self.commands.as_mut().unwrap(), "{command}").unwrap();
        self.answer()
    }

    /// radcam at one end: 0 the camera's, 1 the client's.
    pub fn radcam(&self, end: usize) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[end]]).arg(program().get_program());
        command
    }

    /// Another program at the client's end.
    pub fn client(&self, name: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[1], name]);
        command
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        drop(self.commands.take());
        let _ = self.child.wait();
    }
}

/// The camera, its client and another host on one wire: network namespaces on a bridge.
pub struct Hosts([String; 3]);

impl Hosts {
    /// `None`, with the reason printed, where namespaces cannot be made.
    pub fn new() -> Option<Self> {
        let hosts = Self(names(["camera", "client", "other"]));
        if !hosts.0.iter().all(|host| ip(&format!("netns add {host}"))) {
            println!("SKIPPED: network namespaces need root and iproute2");
            return None;
        }
        let [switch, ..] = &hosts.0;
        assert!(ip(&format!("-n {switch} link add wire type bridge")));
        for (host, address) in hosts.0.iter().zip(ADDRESSES) {
            if host != switch {
                let end = &host[host.len() - 6..];
                assert!(ip(&format!("-n {host} link add wire type veth peer name {end} netns {switch}")));
                assert!(ip(&format!("-n {switch} link set {end} master wire up")));
            }
            assert!(ip(&format!("-n {host} addr add {address}/24 dev wire")));
            assert!(ip(&format!("-n {host} link set wire up")) && ip(&format!("-n {host} link set lo up")));
        }
        Some(hosts)
    }

    /// A program on one of them.
    pub fn command(&self, host: usize, name: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.0[host]]).arg(name);
        command
    }

    /// Runs a part of the test on one of them.
    pub fn on<T: Send>(&self, host: usize, part: impl FnOnce() -> T + Send) -> T {
        let namespace = fs::File::open(Path::new("/run/netns").join(&self.0[host])).unwrap();
        let moved = || {
            move_into_link_name_space(namespace.as_fd(), Some(LinkNameSpaceType::Network)).unwrap();
            part()
        };
        std::thread::scope(|threads| threads.spawn(moved).join().unwrap())
    }
}

impl Drop for Hosts {
    fn drop(&mut self) {
        for host in &self.0 {
            ip(&format!("netns del {host}"));
        }
    }
}
