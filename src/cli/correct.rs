//! `radcam correct`

use super::Outcome;
use super::common::{above_0, codes};
use crate::calibrate::file::Calibration;
use crate::correct::{Codes, CorrectError, Corrector};
use crate::dataset::tag::FrameTag;
use crate::dataset::{CameraInfo, Dataset, image, write_whole};
use crate::import::names;
use anyhow::{Context, Result, bail};
use ndarray::Array2;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tiff::encoder::colortype::{Gray16, Gray32Float};

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The calibration file
    calibration: PathBuf,
    /// Frames (TIFF, PNG, FITS) or dataset folders
    #[arg(required = true)]
    input: Vec<PathBuf>,
    /// A TIFF for one frame; a folder for several
    #[arg(short, long)]
    output: PathBuf,
    /// Exposure of plain frames, s; what they or their dataset say where not given, else that of the calibration's darks
    #[arg(long, value_parser = above_0)]
    exposure_s: Option<f64>,
    /// 16-bit codes, SCALE times DN plus OFFSET, instead of 32-bit floats in DN
    #[arg(long, value_name = "SCALE,OFFSET", value_parser = codes)]
    codes: Option<Codes>,
    /// Replace hot, dead and unstable pixels of the calibration by the mean of the nearest sound ones
    #[arg(long)]
    replace_defects: bool,
    /// Correct although the calibration was made under other settings
    #[arg(long)]
    force: bool,
    /// Write over corrected frames that are there
    #[arg(long)]
    overwrite: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let kind = arguments.output.extension().map(|e| e.to_string_lossy().to_lowercase());
    if let Some(kind) = kind.filter(|k| ["png", "jpg", "jpeg", "fits", "fit", "npy", "bmp"].contains(&&**k)) {
        bail!("{}: corrected frames are written as TIFF, not as {kind}", arguments.output.display());
    }
    let calibration = Calibration::read(&arguments.calibration)?;
    let make = |exposure_s| {
        let corrector = Corrector::new(&calibration, exposure_s)?;
        let replacing = arguments.replace_defects;
        Ok::<_, CorrectError>(if replacing { corrector.replacing_defects(&calibration) } else { corrector })
    };
    let codes = arguments.codes;
    let jobs = jobs(arguments)?;
    free(&jobs, arguments)?;
    let total = jobs.len();
    let fault = |e: anyhow::Error, done: usize| match done {
        0 => e,
        n => e.context(format!("{n} of {total} frames are corrected, and then")),
    };
    let mut corrector: Option<(f64, Corrector)> = None;
    for (done, job) in jobs.iter().enumerate() {
        let mut one = || {
            let (frame, exposure_s) = job.read(&calibration, arguments)?;
            if corrector.as_ref().is_none_or(|(at, _)| *at != exposure_s) {
                corrector = Some((exposure_s, make(exposure_s)?));
            }
            let Some((_, corrector)) = &corrector else { return Ok(()) };
            write(
                corrector,
                &frame,
                codes,
                &description(&arguments.calibration, codes, corrector),
                &job.output,
            )
        };
        one().map_err(|e: anyhow::Error| fault(e, done))?;
    }
    let done = total;
    let scale = arguments.codes.map_or("DN above the dark reference, 32-bit floats".into(), |c| {
        format!("16-bit codes, {} per DN, {} at 0 DN", c.scale, c.offset)
    });
    if arguments.json {
        let answer = serde_json::json!({ "output": arguments.output, "frames": done, "value": scale });
        println!("{}", serde_json::to_string_pretty(&answer)?);
    } else {
        println!("{}: {done} frames corrected ({scale})", arguments.output.display());
    }
    Ok(Outcome::Agreement)
}

/// A frame to be corrected, and where it goes.
struct Job {
    input: Input,
    output: PathBuf,
}

enum Input {
    /// A frame of a dataset, by its row.
    Row(Arc<Dataset>, usize),
    Plain(PathBuf),
}

impl Job {
    /// The frame and its exposure.
    fn read(&self, calibration: &Calibration, arguments: &Arguments) -> Result<(Array2<u16>, f64)> {
        match &self.input {
            Input::Row(dataset, row) => {
                let row = &dataset.rows()[*row];
                check(calibration, &dataset.manifest().camera, arguments.force)?;
                Ok((dataset.read(row)?, row.exposure_s))
            }
            Input::Plain(path) => {
                let plain = Plain::read(path, calibration, arguments.exposure_s, arguments.force)?;
                Ok((plain.pixels, plain.exposure_s))
            }
        }
    }

    /// The file that is read.
    fn source(&self) -> PathBuf {
        match &self.input {
            Input::Row(dataset, row) => {
                let file = &dataset.rows()[*row].file;
                dataset.root().join(file.rsplit_once('#').map_or(file.as_str(), |f| f.0))
            }
            Input::Plain(path) => path.clone(),
        }
    }
}

/// Every frame of the inputs.
fn jobs(arguments: &Arguments) -> Result<Vec<Job>> {
    let single = arguments.input.len() == 1 && arguments.input[0].is_file();
    let mut jobs = Vec::new();
    for input in &arguments.input {
        if input.is_dir() {
            let dataset = Arc::new(Dataset::open(input)?);
            for (row, said) in dataset.rows().iter().enumerate() {
                let name = Path::new(&said.file.replace('#', "_")).with_extension("tiff");
                let output = arguments.output.join(name);
                jobs.push(Job { input: Input::Row(Arc::clone(&dataset), row), output });
            }
        } else {
            let name = Path::new(input.file_name().unwrap_or_default()).with_extension("tiff");
            let output = if single { arguments.output.clone() } else { arguments.output.join(name) };
            jobs.push(Job { input: Input::Plain(input.clone()), output });
        }
    }
    Ok(jobs)
}

/// Refuses outputs that are two frames', that are read, or that are there already.
fn free(jobs: &[Job], arguments: &Arguments) -> Result<()> {
    let mut taken = BTreeSet::new();
    let whole = |path: &Path| path.canonicalize().ok();
    let mut read: BTreeSet<PathBuf> = jobs.iter().filter_map(|j| whole(&j.source())).collect();
    read.extend(whole(&arguments.calibration));
    for job in jobs {
        let output = &job.output;
        if !taken.insert(output) {
            bail!(
                "{} would be the output of two frames; correct them into folders of their own",
                output.display()
            );
        }
        if whole(output).is_some_and(|path| read.contains(&path)) {
            bail!("{} is read, and would be overwritten; choose another output", output.display());
        }
        if output.exists() && !arguments.overwrite {
            bail!("{} is there already; --overwrite writes over it", output.display());
        }
    }
    Ok(())
}

fn check(calibration: &Calibration, now: &CameraInfo, force: bool) -> Result<()> {
    let found = calibration.description.camera.differences(now);
    let size = (now.height, now.width) != calibration.k.dim();
    if found.is_empty() || (force && !size) {
        return Ok(());
    }
    let advice = if size { "" } else { "; --force corrects all the same" };
    Err(CorrectError::Settings(found.join("; ") + advice).into())
}

/// A frame outside a dataset, and the exposure under which it was taken.
pub struct Plain {
    pub pixels: Array2<u16>,
    pub exposure_s: f64,
}

impl Plain {
    /// Reads a frame and holds what it, or the dataset in whose folder it lies, says of camera and settings against the calibration. A frame
    /// that says nothing tells its size and its codes.
    pub fn read(
        path: &Path,
        calibration: &Calibration,
        exposure_s: Option<f64>,
        force: bool,
    ) -> Result<Self> {
        let named = || path.display().to_string();
        let pixels = image::read_single(path).with_context(named)?;
        let (height, width) = pixels.dim();
        let tag = FrameTag::read(path);
        let calibrated = &calibration.description.camera;
        let mut now = tag.as_ref().map_or_else(CameraInfo::default, |t| CameraInfo { ..t.camera.clone() });
        (now.width, now.height) = (width, height);
        if now.bit_depth == 0 {
            let stored = image::stored_bits(path).with_context(named)?;
            let largest = pixels.iter().fold(0, |a, b| a | b);
            let up = largest.trailing_zeros();
            if largest > 255 && up >= 2 && !force {
                return Err(CorrectError::Settings(format!(
                    "all codes are multiples of {}: shifted up by {up} bits, as `radcam import` shifts them down",
                    1u32 << up
                )))
                .with_context(named);
            }
            if largest > calibrated.full_scale_dn() {
                now.bit_depth = (u16::BITS - largest.leading_zeros()) as u8;
            } else if stored < calibrated.bit_depth {
                now.bit_depth = stored;
            }
        }
        check(calibration, &now, force).with_context(named)?;
        let text = |p: Option<&std::ffi::OsStr>| p.unwrap_or_default().to_string_lossy().into_owned();
        let by_name =
            || names::facts(&text(path.parent().and_then(Path::file_name)), &text(path.file_name()));
        let said = tag.map(|t| t.exposure_s).or_else(|| by_name().exposure_s);
        if let (Some(given), Some(said)) = (exposure_s, said)
            && (given / said - 1.0).abs() > 1e-6
        {
            tracing::warn!(file = named(), given_s = given, said_s = said, "the frame says another exposure");
        }
        let exposure_s = exposure_s.or(said).unwrap_or_else(|| {
            let exposure_s = calibration.dark.exposure_s;
            // Said of the first of many.
            static SAID: AtomicBool = AtomicBool::new(false);
            if !SAID.swap(true, Ordering::Relaxed) {
                tracing::warn!(
                    file = named(),
                    exposure_s,
                    "says no exposure: that of the calibration's darks is taken; give --exposure-s"
                );
            }
            exposure_s
        });
        Ok(Self { pixels, exposure_s })
    }
}

/// What a corrected image says of itself.
pub(super) fn description(calibration: &Path, codes: Option<Codes>, corrector: &Corrector) -> String {
    serde_json::json!({
        "format": "radcam-corrected/1",
        "calibration": calibration.display().to_string(),
        "value": if codes.is_some() { "scale * DN + offset" } else { "DN above the dark reference" },
        "scale": codes.map(|c| c.scale),
        "offset": codes.map(|c| c.offset),
        "replaced_defects": corrector.replaced(),
    })
    .to_string()
}

fn write(
    corrector: &Corrector,
    frame: &Array2<u16>,
    codes: Option<Codes>,
    description: &str,
    path: &Path,
) -> Result<()> {
    if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    let bytes = match codes {
        None => image::described_bytes::<Gray32Float>(corrector.image(frame)?.view(), description)?,
        Some(codes) => {
            let mut out = Array2::zeros(corrector.shape());
            let frame = frame.as_standard_layout();
            corrector.to_u16(
                frame.as_slice().unwrap_or_default(),
                codes,
                out.as_slice_mut().unwrap_or_default(),
            )?;
            image::described_bytes::<Gray16>(out.view(), description)?
        }
    };
    Ok(write_whole(path, &bytes)?)
}
