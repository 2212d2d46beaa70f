//! `radcam workbench`

use super::Outcome;
use super::common::{STOP, load_model};
use super::observe::Colour;
use crate::camera;
use crate::camera::StreamOptions;
use crate::monitor::store::Store;
use crate::workbench::{Options, Workbench};
use anyhow::{Result, bail};
use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A dataset folder, an EMVA 1288 descriptor or a table; with --camera the folder that is captured into.
    /// More datasets stand beside the first
    #[arg(value_name = "DATASET")]
    datasets: Vec<PathBuf>,
    #[command(flatten)]
    colour: Colour,
    /// A camera for the live picture and for captures
    #[arg(long, value_name = "CAMERA")]
    camera: Option<String>,
    /// The history that `radcam monitor --store` keeps, as a page; @FILE or env:NAME hold an address with a
    /// password
    #[arg(long, value_name = "URL")]
    history: Option<String>,
    /// Effects that the model begins with
    #[arg(long, value_name = "M.toml|SENSOR")]
    model: Option<PathBuf>,
    /// Port of the page; a free one where not given
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Open the page in the browser
    #[arg(long)]
    open: bool,
    /// Serve the page on another interface than this machine's own
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<IpAddr>,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    if arguments.datasets.is_empty() && arguments.camera.is_none() && arguments.history.is_none() {
        bail!("name a dataset, a camera with --camera, or a history with --history");
    }
    let history = arguments.history.as_deref().map(super::secret::database).transpose()?;
    if let Some(url) = &history {
        // Opened once here: errors appear at once, and a mistyped name creates no new file.
        let file = url.strip_prefix("sqlite:").unwrap_or(url);
        if !file.contains("://") && !std::path::Path::new(file).exists() {
            bail!("{file}: there is no such history; `radcam monitor --store {file}` begins one");
        }
        Store::open(url)?;
    }
    let address = arguments.listen.unwrap_or(Ipv4Addr::LOCALHOST.into());
    if address.is_unspecified() {
        bail!("--listen {address}: name the address of one interface, by which the browser will call");
    }
    if !address.is_loopback() {
        tracing::warn!(
            "{address} is not this machine's own: whoever reads the network sees the page and its token, since nothing is encrypted"
        );
    }
    let effects = match &arguments.model {
        Some(path) => load_model(&path.to_string_lossy(), None)?.effects,
        None => Vec::new(),
    };
    let camera = arguments.camera.as_deref().map(camera::open).transpose()?;
    let mut datasets = arguments.datasets.iter().cloned();
    let options = Options {
        dataset: datasets.next(),
        others: datasets.collect(),
        plane: arguments.colour.plane,
        history,
        camera,
        stream: StreamOptions::default(),
        effects,
        address: SocketAddr::new(address, arguments.port),
    };
    let workbench = Workbench::open(options).map_err(anyhow::Error::msg)?;
    let url = workbench.url();
    println!("{url}\nThe page is there until Ctrl-C.");
    // Keep the file until the workbench ends; the browser may read it late.
    let _page = arguments.open.then(|| open_in_browser(&url));
    workbench.serve(&STOP).map_err(anyhow::Error::msg)?;
    Ok(Outcome::Agreement)
}

/// Opens the page through a file that only the user can read. The address holds the token, and every user of
/// the machine can read command lines.
fn open_in_browser(url: &str) -> Option<tempfile::NamedTempFile> {
    let open = || {
        let mut page = tempfile::Builder::new().prefix("radcam-").suffix(".html").tempfile()?;
        let text = format!(
            "<!doctype html><meta charset=\"utf-8\"><meta name=\"referrer\" content=\"no-referrer\"><title>radcam</title>\
             <meta http-equiv=\"refresh\" content=\"0;url={url}\"><a href=\"{url}\">Open the workbench</a>"
        );
        page.write_all(text.as_bytes())?;
        std::process::Command::new("xdg-open").arg(page.path()).spawn()?;
        Ok(page)
    };
    open()
        .inspect_err(|e: &std::io::Error| {
            tracing::warn!("the browser could not be opened (xdg-open: {e}); open the address by hand");
        })
        .ok()
}
