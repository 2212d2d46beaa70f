//! Connections of the page and of the metrics. Their number and duration are limited, so that idle
//! connections lock nobody out.

use axum::Router;
use axum::body::{Body, to_bytes};
use axum::extract::Request;
use axum::http::StatusCode;
use axum::http::header::CONTENT_LENGTH;
use axum::middleware::{Next, from_fn};
use axum::response::{IntoResponse, Response};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;

/// Time limits for the head of a request and for its body. Browsers send both within milliseconds.
const HEAD_TIME: Duration = Duration::from_secs(10);
const BODY_TIME: Duration = Duration::from_secs(10);
/// Maximum size of a body, bytes: forms are shorter.
const MAX_BODY: usize = 2 << 20;
/// Maximum number of connections of one address, and of all. A browser has 6 per page; a process may have
/// 1024 open files.
const MAX_OF_A_PEER: usize = 128;
const MAX_CONNECTIONS: usize = 256;
/// Pause after a failed accept, as when no file descriptor is free.
const PAUSE: Duration = Duration::from_millis(50);

/// Open connection.
struct Guest {
    number: u64,
    peer: IpAddr,
    /// True once a request of the connection was answered and not refused.
    welcome: Arc<AtomicBool>,
    end: Arc<Notify>,
}

/// Open connections, the oldest first.
#[derive(Default)]
struct Door {
    guests: Vec<Guest>,
    number: u64,
}

impl Door {
    /// Admits a connection. If the limit is reached, the oldest connection without an answer is closed; if
    /// all have an answer, the new one is refused.
    fn enter(&mut self, peer: IpAddr) -> Option<(u64, Arc<AtomicBool>, Arc<Notify>)> {
        let crowded = self.guests.iter().filter(|g| g.peer == peer).count() >= MAX_OF_A_PEER;
        if crowded || self.guests.len() >= MAX_CONNECTIONS {
            let idle = |g: &Guest| !g.welcome.load(Ordering::Relaxed) && (!crowded || g.peer == peer);
            let oldest = self.guests.iter().position(idle)?;
            self.guests.remove(oldest).end.notify_one();
        }
        self.number += 1;
        let guest = Guest { number: self.number, peer, welcome: Arc::default(), end: Arc::default() };
        let told = (guest.number, Arc::clone(&guest.welcome), Arc::clone(&guest.end));
        self.guests.push(guest);
        Some(told)
    }

    fn leave(&mut self, number: u64) {
        self.guests.retain(|g| g.number != number);
    }
}

fn lock(door: &Mutex<Door>) -> MutexGuard<'_, Door> {
    door.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Serves connections until the future is dropped.
pub(crate) async fn serve(listener: TcpListener, router: Router) {
    let door = Arc::new(Mutex::new(Door::default()));
    loop {
        let (stream, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(e) => {
                tracing::debug!(error = %e, "a connection could not be accepted");
                tokio::time::sleep(PAUSE).await;
                continue;
            }
        };
        let entered = lock(&door).enter(peer.ip());
        let Some((number, welcome, end)) = entered else { continue };
        let (router, door) = (router.clone(), Arc::clone(&door));
        tokio::spawn(async move {
            tokio::select! {
                () = converse(stream, router, welcome) => {}
                () = end.notified() => {}
            }
            lock(&door).leave(number);
        });
    }
}

/// Serves the requests of a connection.
async fn converse(stream: TcpStream, router: Router, welcome: Arc<AtomicBool>) {
    let watched = router.layer(from_fn(move |request: Request, next: Next| {
        let welcome = Arc::clone(&welcome);
        async move {
            let answer = match whole(request).await {
                Ok(request) => next.run(request).await,
                Err(refusal) => *refusal,
            };
            if !answer.status().is_client_error() {
                welcome.store(true, Ordering::Relaxed);
            }
            answer
        }
    }));
    let mut builder = http1::Builder::new();
    builder.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME);
    let served = builder.serve_connection(TokioIo::new(stream), TowerToHyperService::new(watched)).await;
    if let Err(e) = served {
        tracing::debug!(error = %e, "a connection ended");
    }
}

/// Reads the request with its whole body.
async fn whole(request: Request) -> Result<Request, Box<Response>> {
    let (head, body) = request.into_parts();
    let refuse = |code: StatusCode, why: &'static str| Err(Box::new((code, why).into_response()));
    let length = head.headers.get(CONTENT_LENGTH).and_then(|v| v.to_str().ok()?.parse::<u64>().ok());
    if length.is_some_and(|length| length > MAX_BODY as u64) {
        return refuse(StatusCode::PAYLOAD_TOO_LARGE, "The request has too many bytes.\n");
    }
    match tokio::time::timeout(BODY_TIME, to_bytes(body, MAX_BODY)).await {
        Ok(Ok(bytes)) => Ok(Request::from_parts(head, Body::from(bytes))),
        Ok(Err(_)) => {
            refuse(StatusCode::PAYLOAD_TOO_LARGE, "The request has too many bytes, or broke off.\n")
        }
        Err(_) => refuse(StatusCode::REQUEST_TIMEOUT, "The request did not come to its end in time.\n"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::routing::get;
    use std::io::{Read, Write};
    use std::net::SocketAddr;
    use std::time::Instant;

    fn server() -> SocketAddr {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        let address = listener.local_addr().unwrap();
        std::thread::spawn(move || {
            let runtime =
                tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
            let router =
                Router::new().route("/", get(|| async { "well" }).post(|body: String| async { body }));
            runtime.block_on(async { serve(TcpListener::from_std(listener).unwrap(), router).await });
        });
        address
    }

    fn ask(address: SocketAddr, request: &str) -> String {
        let mut stream = std::net::TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        let _ = stream.read_to_string(&mut answer);
        answer
    }

    const GET: &str = "GET / HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n";

    /// Half-open connections of several kinds do not lock out a client, and each ends by itself.
    #[test]
    fn half_open_connections_lock_nobody_out() {
        let address = server();
        let starts = [
            "",
            "G",
            "GET / HTTP/1.1\r\n",
            "GET / HTTP/1.1\r\nHost: a\r\n",
            "POST / HTTP/1.1\r\nContent-Length: 9\r\n\r\n",
        ];
        let mut held = Vec::new();
        for n in 0..2 * MAX_CONNECTIONS {
            let mut stream = std::net::TcpStream::connect(address).unwrap();
            let _ = stream.write_all(starts[n % starts.len()].as_bytes());
            held.push(stream);
            if n % 100 == 99 {
                let begun = Instant::now();
                assert!(ask(address, GET).ends_with("well"), "after {n}");
                assert!(begun.elapsed() < Duration::from_secs(2));
            }
        }
        // Missing bodies are refused with a message; missing heads end the connection.
        let begun = Instant::now();
        for mut stream in held {
            stream.set_read_timeout(Some(2 * HEAD_TIME)).unwrap();
            let mut answer = Vec::new();
            let _ = stream.read_to_end(&mut answer);
        }
        assert!(begun.elapsed() < 2 * HEAD_TIME, "{:?}", begun.elapsed());
        assert!(
            ask(address, "POST / HTTP/1.1\r\nHost: a\r\nConnection: close\r\nContent-Length: 4\r\n\r\nbody")
                .ends_with("body")
        );
        assert!(
            ask(address, "POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 99999999\r\n\r\n").contains("413")
        );
    }

    #[test]
    fn the_oldest_that_got_nothing_goes() {
        let mut door = Door::default();
        let peer = |n: u8| IpAddr::from([127, 0, 0, n]);
        let (first, welcome, _) = door.enter(peer(1)).unwrap();
        welcome.store(true, Ordering::Relaxed);
        let (second, _, end) = door.enter(peer(1)).unwrap();
        (2..MAX_OF_A_PEER).for_each(|_| drop(door.enter(peer(1)).unwrap()));
        assert!(door.enter(peer(1)).is_some() && door.guests.len() == MAX_OF_A_PEER);
        let numbers: Vec<u64> = door.guests.iter().map(|g| g.number).collect();
        assert!(numbers.contains(&first) && !numbers.contains(&second));
        drop(end);
        door.guests.iter().for_each(|g| g.welcome.store(true, Ordering::Relaxed));
        assert!(door.enter(peer(1)).is_none() && door.enter(peer(2)).is_some());
        door.leave(first);
        assert!(door.enter(peer(1)).is_some());
    }
}
