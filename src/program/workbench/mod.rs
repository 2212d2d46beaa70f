//! Workbench: a browser page, served on this machine only, for viewing a campaign, comparing it with a model,
//! and extending the model.
//!
//! The desk holds one campaign, whose statistics are collected once. Every switch of an effect refits the
//! model and compares it with the data, as `radcam compare` does, and is stored as a step in the dataset's
//! folder. Jobs (reading, searching, capturing, calibrating) run in the background, one at a time. Pages are
//! rendered on the server; htmx 2.0.11 replaces parts of them, uPlot 1.6.32 makes figures interactive, and no
//! external resources are loaded.

mod actions;
mod desk;
mod guard;
mod job;
mod live;
mod pages;
mod pixels;
mod steps;

use crate::camera::{Camera, StreamOptions};
use axum::Router;
use axum::http::header;
use axum::response::IntoResponse;
use axum::routing::{get, post};
use desk::{Data, Desk};
use job::Job;
use live::{Live, lock};
use radcam_sim::EffectValues;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock};
use tokio::net::TcpListener;
use tokio::sync::watch;

/// Options of the workbench.
pub struct Options {
    /// Dataset folder, EMVA 1288 descriptor or table. With a camera: the folder of the capture, which need
    /// not exist.
    pub dataset: Option<PathBuf>,
    /// Other campaigns for comparison.
    pub others: Vec<PathBuf>,
    /// Row and column of the evaluated pixel of every 2 x 2 cell, for colour mosaics.
    pub plane: Option<[u8; 2]>,
    /// History of `radcam monitor`, as its `--store`.
    pub history: Option<String>,
    /// Camera.
    pub camera: Option<Box<dyn Camera>>,
    /// Stream options of the camera.
    pub stream: StreamOptions,
    /// Initial effects of the model.
    pub effects: Vec<EffectValues>,
    /// Address of the server; port 0 selects a free one.
    pub address: SocketAddr,
}

/// State shared by all request handlers.
pub struct Shared {
    token: String,
    port: u16,
    /// Accepted values of the Host header.
    hosts: Vec<String>,
    dataset: Option<PathBuf>,
    others: Vec<PathBuf>,
    plane: Option<[u8; 2]>,
    history: Option<String>,
    effects: Vec<EffectValues>,
    desk: Mutex<Desk>,
    job: Mutex<Option<Arc<Job>>>,
    runs: Mutex<Vec<actions::Run>>,
    live: OnceLock<Arc<Live>>,
    /// Revision counters: of the model, and of everything that a page shows.
    changed: watch::Sender<(u64, u64)>,
}

impl Shared {
    /// Notifies the pages that the model or the campaign changed.
    fn model_changed(&self) {
        self.changed.send_modify(|c| *c = (c.0 + 1, c.1 + 1));
    }

    /// Notifies the pages of progress or a new result.
    fn status_changed(&self) {
        self.changed.send_modify(|c| c.1 += 1);
    }

    fn desk(&self) -> std::sync::MutexGuard<'_, Desk> {
        lock(&self.desk)
    }

    fn live(&self) -> Option<&Arc<Live>> {
        self.live.get()
    }
}

/// Server that is bound but not yet serving.
pub struct Workbench {
    listener: std::net::TcpListener,
    shared: Arc<Shared>,
    address: SocketAddr,
}

impl Workbench {
    /// Binds the address, starts the camera thread and begins to read the campaign.
    ///
    /// # Errors
    ///
    /// The address is in use, or the system has no random numbers.
    pub fn open(options: Options) -> Result<Self, String> {
        let fault = |e: std::io::Error| format!("{}: {e}", options.address);
        let listener = std::net::TcpListener::bind(options.address).map_err(fault)?;
        listener.set_nonblocking(true).map_err(fault)?;
        let address = listener.local_addr().map_err(fault)?;
        let port = address.port();
        let mut hosts = vec![format!("127.0.0.1:{port}"), format!("localhost:{port}"), address.to_string()];
        hosts.dedup();
        let data = if options.dataset.is_some() { Data::Reading } else { Data::None };
        let shared = Arc::new(Shared {
            token: guard::token()?,
            port,
            hosts,
            dataset: options.dataset,
            others: options.others,
            plane: options.plane,
            history: options.history,
            effects: options.effects,
            desk: Mutex::new(Desk::new(data)),
            job: Mutex::new(None),
            runs: Mutex::new(Vec::new()),
            live: OnceLock::new(),
            changed: watch::channel((0, 0)).0,
        });
        if let Some(camera) = options.camera {
            let told = shared.clone();
            let _ =
                shared.live.set(Live::start(camera, options.stream, Arc::new(move || told.status_changed())));
        }
        actions::read_campaign(&shared);
        Ok(Self { listener, shared, address })
    }

    /// Returns the address with its token, for a browser.
    pub fn url(&self) -> String {
        format!("http://{}/?token={}", self.address, self.shared.token)
    }

    /// Serves requests until `end` is set.
    ///
    /// # Errors
    ///
    /// The server cannot be started.
    pub fn serve(self, end: &std::sync::atomic::AtomicBool) -> Result<(), String> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(4)
            .enable_all()
            .build()
            .map_err(|e| e.to_string())?;
        let router = router(self.shared.clone());
        runtime.block_on(async {
            let listener = TcpListener::from_std(self.listener).map_err(|e| e.to_string())?;
            tokio::select! {
                () = crate::http::serve(listener, router) => Ok::<(), String>(()),
                () = ended(end) => Ok(()),
            }
        })?;
        if let Some(job) = &*lock(&self.shared.job) {
            job.stop.store(true, std::sync::atomic::Ordering::Relaxed);
        }
        if let Some(live) = self.shared.live() {
            live.end();
        }
        // Jobs end with the program.
        runtime.shutdown_timeout(std::time::Duration::from_millis(300));
        Ok(())
    }
}

async fn ended(end: &std::sync::atomic::AtomicBool) {
    while !end.load(std::sync::atomic::Ordering::Relaxed) {
        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
    }
}

fn router(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/", get(pages::model::page))
        .route("/data", get(pages::data::page))
        .route("/camera", get(pages::camera::page))
        .route("/runs", get(pages::runs::page))
        .route("/history", get(pages::history::page))
        .route("/save", get(pages::save::page))
        .route("/status", get(pages::status))
        .route("/cell", get(pages::model::cell))
        .route("/events", get(actions::events))
        .route("/model/add", post(actions::add))
        .route("/model/switch", post(actions::switch))
        .route("/model/remove", post(actions::remove))
        .route("/model/try", post(actions::try_own))
        .route("/model/own", post(actions::add_own))
        .route("/model/undo", post(actions::undo))
        .route("/model/search", post(actions::search))
        .route("/job/cancel", post(actions::cancel))
        .route("/operator", post(actions::operator))
        .route("/camera/set", post(actions::set_camera))
        .route("/camera/capture", post(actions::capture))
        .route("/camera/next", post(actions::take_next))
        .route("/runs/read", post(actions::read_runs))
        .route("/save/calibration", post(actions::calibrate))
        .route("/save/report.html", get(actions::report))
        .route("/save/model.toml", get(actions::model_file))
        .route("/save/next.toml", get(actions::next_file))
        .route("/pixels", get(pixels::pixels))
        .route("/thumbnail", get(pixels::thumbnail))
        .route("/live", get(pixels::live))
        .route("/style.css", get(|| asset("text/css", STYLE)))
        .route("/workbench.js", get(|| asset("text/javascript", include_str!("assets/workbench.js"))))
        .route("/viewer.js", get(|| asset("text/javascript", include_str!("assets/viewer.js"))))
        .route("/figures.js", get(|| asset("text/javascript", crate::report::SCRIPTS[1])))
        .route("/uPlot.js", get(|| asset("text/javascript", crate::report::SCRIPTS[0])))
        .route("/htmx.js", get(|| asset("text/javascript", include_str!("assets/htmx/htmx.min.js"))))
        .fallback(|| async { (axum::http::StatusCode::NOT_FOUND, "There is no such page.\n") })
        .layer(axum::middleware::from_fn_with_state(shared.clone(), guard::guard))
        .with_state(shared)
}

const STYLE: &str = include_str!("assets/workbench.css");

async fn asset(kind: &'static str, text: &'static str) -> impl IntoResponse {
    let text = if kind == "text/css" { [crate::report::STYLE, text].concat() } else { text.to_string() };
    ([(header::CONTENT_TYPE, format!("{kind}; charset=utf-8"))], text)
}

/// Runs blocking work on another thread, so that pages still respond.
async fn aside<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, String> {
    tokio::task::spawn_blocking(work).await.map_err(|e| format!("the work ended early: {e}"))
}
