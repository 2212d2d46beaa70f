//! `radcam correct`

use super::Outcome;
use crate::calibrate::file::Calibration;
use crate::correct::{Codes, CorrectError, Corrector, differences};
use crate::dataset::{CameraInfo, Dataset, image, write_whole};
use anyhow::{Context, Result, bail};
use ndarray::Array2;
use std::path::{Path, PathBuf};
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
    /// Exposure of plain frames, s; that of the calibration's darks where not given. Datasets know theirs
    #[arg(long)]
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
}

/// `scale,offset`.
fn codes(text: &str) -> Result<Codes, String> {
    let numbers: Vec<f32> = text
        .split(',')
        .map(|n| n.trim().parse().map_err(|_| format!("\"{n}\" is not a number")))
        .collect::<Result<_, String>>()?;
    match numbers[..] {
        [scale, offset] if scale > 0.0 && offset.is_finite() => Ok(Codes { scale, offset }),
        _ => Err("write scale,offset with a scale above 0".into()),
    }
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let kind = arguments.output.extension().map(|e| e.to_string_lossy().to_lowercase());
    if let Some(kind) = kind.filter(|k| ["png", "jpg", "jpeg", "fits", "fit", "npy", "bmp"].contains(&&**k)) {
        bail!("{}: corrected frames are written as TIFF, not as {kind}", arguments.output.display());
    }
    let calibration = Calibration::read(&arguments.calibration)?;
    let exposure_s = arguments.exposure_s.unwrap_or(calibration.dark.exposure_s);
    let single = arguments.input.len() == 1 && arguments.input[0].is_file();
    let mut done = 0;
    let make = |exposure_s| {
        let corrector = Corrector::new(&calibration, exposure_s)?;
        let replacing = arguments.replace_defects;
        Ok::<_, CorrectError>(if replacing { corrector.replacing_defects(&calibration) } else { corrector })
    };
    let codes = arguments.codes;
    for input in &arguments.input {
        if input.is_dir() {
            let dataset = Dataset::open(input)?;
            check(&calibration, &dataset.manifest().camera, arguments.force)?;
            for set in dataset.sets() {
                let corrector = make(dataset.settings(set).exposure_s)?;
                for &row in &set.rows {
                    let row = &dataset.rows()[row];
                    let out =
                        arguments.output.join(Path::new(&row.file.replace('#', "_")).with_extension("tiff"));
                    write(
                        &corrector,
                        &dataset.read(row)?,
                        codes,
                        &description(&arguments.calibration, codes, &corrector),
                        &out,
                    )?;
                    done += 1;
                }
            }
        } else {
            let corrector = make(exposure_s)?;
            let frame = image::read(input, 0).with_context(|| input.display().to_string())?;
            let (height, width) = frame.dim();
            // A plain frame tells its size, and nothing else.
            check(&calibration, &CameraInfo { width, height, ..Default::default() }, arguments.force)
                .with_context(|| input.display().to_string())?;
            let name = Path::new(input.file_name().unwrap_or_default()).with_extension("tiff");
            let out = if single { arguments.output.clone() } else { arguments.output.join(name) };
            if out == *input {
                bail!("{} would be overwritten; choose another output", input.display());
            }
            write(&corrector, &frame, codes, &description(&arguments.calibration, codes, &corrector), &out)?;
            done += 1;
        }
    }
    let scale = arguments.codes.map_or("DN above the dark reference, 32-bit floats".into(), |c| {
        format!("16-bit codes, {} per DN, {} at 0 DN", c.scale, c.offset)
    });
    println!("{}: {done} frames corrected ({scale})", arguments.output.display());
    Ok(Outcome::Agreement)
}

pub fn check(calibration: &Calibration, now: &CameraInfo, force: bool) -> Result<()> {
    let found = differences(&calibration.description.camera, now);
    let size = (now.height, now.width) != calibration.k.dim();
    if found.is_empty() || (force && !size) {
        return Ok(());
    }
    let advice = if size { "" } else { "; --force corrects all the same" };
    Err(CorrectError::Settings(found.join("; ") + advice).into())
}

/// What a corrected image says of itself.
fn description(calibration: &Path, codes: Option<Codes>, corrector: &Corrector) -> String {
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
        None => image::described_bytes::<Gray32Float>(&corrector.image(frame)?, description)?,
        Some(codes) => {
            let mut out = Array2::zeros(corrector.shape());
            let frame = frame.as_standard_layout();
            corrector.to_u16(
                frame.as_slice().unwrap_or_default(),
                codes,
                out.as_slice_mut().unwrap_or_default(),
            )?;
            image::described_bytes::<Gray16>(&out, description)?
        }
    };
    Ok(write_whole(path, &bytes)?)
}
