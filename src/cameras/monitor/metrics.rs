//! Prometheus endpoint: the last check, and alarms since the start, as OpenMetrics text.

use super::{Alarm, Check};
use axum::Router;
use axum::http::StatusCode;
use axum::http::header::{CONNECTION, CONTENT_TYPE};
use axum::routing::get;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;
use std::net::{SocketAddr, TcpListener};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, PoisonError, RwLock};

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
    /// Text after the last check. Readers never block the monitor.
    text: RwLock<Arc<str>>,
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
        let metrics = Self {
            registry,
            reading: all.0,
            error: all.1,
            alarms: all.2,
            checks: all.3,
            text: RwLock::new(Arc::from("")),
        };
        metrics.refresh();
        metrics
    }
}

fn of(camera: &str, what: &impl serde::Serialize) -> Of {
    let what = serde_json::to_value(what).ok();
    Of { camera: camera.into(), what: what.as_ref().and_then(|w| w.as_str()).unwrap_or("all").into() }
}

impl Metrics {
    /// Updates the metrics with a check and its alarms.
    pub fn take(&self, camera: &str, check: &Check, alarms: &[Alarm]) {
        self.checks.get_or_create(&of(camera, &"all")).inc();
        for (what, reading) in &check.readings {
            self.reading.get_or_create(&of(camera, what)).set(reading.value);
            self.error.get_or_create(&of(camera, what)).set(reading.std_err);
        }
        for alarm in alarms {
            self.alarms.get_or_create(&of(camera, &alarm.what)).inc();
        }
        self.refresh();
    }

    fn refresh(&self) {
        let mut out = String::new();
        // Writing to a string does not fail.
        let _ = encode(&mut out, &self.registry);
        *self.text.write().unwrap_or_else(PoisonError::into_inner) = out.into();
    }

    /// Returns the text after the last check.
    pub fn text(&self) -> Arc<str> {
        self.text.read().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Serves `GET /metrics` at an address until the program ends.
///
/// # Errors
///
/// The address cannot be bound.
pub fn serve(address: SocketAddr, metrics: Arc<Metrics>) -> std::io::Result<SocketAddr> {
    const KIND: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    let bound = listener.local_addr()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let answer = move || {
        let text = metrics.text();
        async move { ([(CONTENT_TYPE, KIND), (CONNECTION, "close")], text.to_string()) }
    };
    let none = || async { (StatusCode::NOT_FOUND, [(CONNECTION, "close")], "There is /metrics.\n") };
    let router = Router::new().route("/metrics", get(answer)).fallback(none);
    std::thread::spawn(move || {
        runtime.block_on(async {
            match tokio::net::TcpListener::from_std(listener) {
                Ok(listener) => crate::http::serve(listener, router).await,
                Err(e) => tracing::error!(error = %e, "metrics"),
            }
        });
    });
    Ok(bound)
}
