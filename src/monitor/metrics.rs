//! What Prometheus reads: the last check, and alarms since the start, as OpenMetrics text.

use super::{Alarm, Check};
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Of {
    camera: String,
    what: String,
}

type Value = Gauge<f64, AtomicU64>;

/// Metrics of one monitor.
#[derive(Debug)]
pub struct Metrics {
    registry: Registry,
    reading: Family<Of, Value>,
    error: Family<Of, Value>,
    alarms: Family<Of, Counter>,
    checks: Family<Of, Counter>,
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix("radcam");
        let all = (
            Family::<Of, Value>::default(),
            Family::<Of, Value>::default(),
            Family::<Of, Counter>::default(),
            Family::<Of, Counter>::default(),
        );
        registry.register("reading", "Value of the last check, in the unit of the quantity", all.0.clone());
        registry.register("reading_std_err", "Its standard error", all.1.clone());
        registry.register("alarms", "Changes that were found", all.2.clone());
        registry.register("checks", "Checks that were taken", all.3.clone());
        Self { registry, reading: all.0, error: all.1, alarms: all.2, checks: all.3 }
    }
}

fn of(camera: &str, what: &impl serde::Serialize) -> Of {
    let what = serde_json::to_value(what).ok();
    Of { camera: camera.into(), what: what.as_ref().and_then(|w| w.as_str()).unwrap_or("all").into() }
}

impl Metrics {
    /// Takes a check and what it found.
    pub fn take(&self, camera: &str, check: &Check, alarms: &[Alarm]) {
        self.checks.get_or_create(&of(camera, &"all")).inc();
        for (what, reading) in &check.readings {
            self.reading.get_or_create(&of(camera, what)).set(reading.value);
            self.error.get_or_create(&of(camera, what)).set(reading.std_err);
        }
        for alarm in alarms {
            self.alarms.get_or_create(&of(camera, &alarm.what)).inc();
        }
    }

    /// The text.
    pub fn text(&self) -> String {
        let mut out = String::new();
        // Writing to a string does not fail.
        let _ = encode(&mut out, &self.registry);
        out
    }
}

/// Answers `GET /metrics` at an address until the program ends.
///
/// # Errors
///
/// Where the address cannot be bound.
pub fn serve(address: SocketAddr, metrics: Arc<Mutex<Metrics>>) -> std::io::Result<SocketAddr> {
    let listener = TcpListener::bind(address)?;
    let bound = listener.local_addr()?;
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let mut stream = stream;
            let wait = Some(Duration::from_secs(2));
            let _ = (stream.set_read_timeout(wait), stream.set_write_timeout(wait));
            let mut request = Vec::new();
            let mut part = [0; 1024];
            // A request's head may come in pieces; nobody needs 16 KiB of it.
            while !request.windows(4).any(|w| w == b"\r\n\r\n") && request.len() < 16 << 10 {
                match stream.read(&mut part) {
                    Ok(n) if n > 0 => request.extend_from_slice(&part[..n]),
                    _ => break,
                }
            }
            let found = request.starts_with(b"GET /metrics");
            let text = if found {
                metrics.lock().unwrap_or_else(PoisonError::into_inner).text()
            } else {
                String::new()
            };
            let status = if found { "200 OK" } else { "404 Not Found" };
            let head = format!(
                "HTTP/1.1 {status}\r\nContent-Type: application/openmetrics-text; version=1.0.0; charset=utf-8\r\nContent-Length: {}\r\n\
                 Connection: close\r\n\r\n",
                text.len()
            );
            let _ = stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(text.as_bytes()));
        }
    });
    Ok(bound)
}
