//! `radcam correct`

use super::Outcome;
use super::common::{above_0, codes, folders_below};
use crate::calibrate::file::Calibration;
use crate::correct::{Codes, CorrectError, Corrector};
use crate::dataset::tag::{CORRECTED, FrameTag, is_corrected};
use crate::dataset::{CameraInfo, Dataset, MAX_EXPOSURE_S, image, write_whole};
use crate::import::{BOTTOM_UP, Facts, ROW_ORDER, facts, pixel_format, region_of};
use crate::number::{percent, six_digits};
use crate::output::folder_of;
use crate::reduction;
use crate::statistics::code_step::{Occurring, Stretch};
use anyhow::{Context, Result, bail};
use ndarray::{Array2, Axis};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tiff::encoder::colortype::{Gray16, Gray32Float};

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The calibration file
    calibration: PathBuf,
    /// Frames (TIFF, PNG, FITS, HDF5 of one frame) or dataset folders
    #[arg(required = true)]
    input: Vec<PathBuf>,
    /// A TIFF for one frame; a folder for several
    #[arg(short, long)]
    output: PathBuf,
    /// Exposure of plain frames, s; what they or their dataset say where not given, else that of the
    /// calibration's darks
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
    if arguments.calibration.is_dir() {
        bail!(
            "{}: a folder; the calibration file comes first, then the frames",
            arguments.calibration.display()
        );
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
    let mut notes = Notes::default();
    for (done, job) in jobs.iter().enumerate() {
        let mut one = || {
            let (frame, exposure_s) = job.read(&calibration, arguments, &mut notes)?;
            if corrector.as_ref().is_none_or(|(at, _)| *at != exposure_s) {
                let made = make(exposure_s).with_context(|| job.source().display().to_string())?;
                corrector = Some((exposure_s, made));
            }
            let Some((_, corrector)) = &corrector else { return Ok(()) };
            notes.look(&job.source(), &frame, corrector, (&calibration, exposure_s, arguments.force))?;
            let text = description(&arguments.calibration, codes, corrector);
            job.make_folder(&arguments.output)?;
            let cut = write(corrector, &frame, codes, &text, &job.output)?;
            notes.cut(&job.source(), cut);
            Ok(())
        };
        one().map_err(|e: anyhow::Error| fault(e, done))?;
    }
    let done = total;
    let scale = arguments.codes.map_or("DN above the dark reference, 32-bit floats".into(), |c| {
        format!("16-bit codes, {} per DN, {} at 0 DN", c.scale, c.offset)
    });
    if arguments.json {
        let answer = serde_json::json!({ "output": arguments.output, "frames": done, "value": scale, "notes": notes.texts() });
        println!("{}", serde_json::to_string_pretty(&answer)?);
    } else {
        let how = calibration.description.correction();
        println!("{}: {done} frames corrected, {how} ({scale})", arguments.output.display());
    }
    Ok(Outcome::Agreement)
}

/// Frame to be corrected, with its output path.
struct Job {
    input: Input,
    output: PathBuf,
}

enum Input {
    /// Row of a frame in a dataset.
    Row(Arc<Dataset>, usize),
    Plain(PathBuf),
}

impl Job {
    /// Reads the frame and its exposure.
    fn read(
        &self,
        calibration: &Calibration,
        arguments: &Arguments,
        notes: &mut Notes,
    ) -> Result<(Array2<u16>, f64)> {
        match &self.input {
            Input::Row(dataset, row) => {
                let row = &dataset.rows()[*row];
                let now = CameraInfo {
                    temperature_c: row.temperature_c.or(dataset.manifest().camera.temperature_c),
                    ..dataset.manifest().camera.clone()
                };
                check(calibration, &now, arguments.force)
                    .with_context(|| dataset.root().display().to_string())?;
                if let Some(given) = arguments.exposure_s.filter(|e| (e / row.exposure_s - 1.0).abs() > 1e-6)
                {
                    notes.say(
                        dataset.root(),
                        "exposure of rows",
                        format!("frames of a dataset have the exposure that it states; --exposure-s {given} is for plain frames"),
                    );
                }
                notes.compare(dataset.root(), &calibration.description.camera, &now);
                Ok((dataset.read(row)?, row.exposure_s))
            }
            Input::Plain(path) => {
                let plain = Plain::read(path, calibration, arguments.exposure_s, arguments.force, notes)?;
                Ok((plain.pixels, plain.exposure_s))
            }
        }
    }

    /// Creates the output folders below the folder named by the user.
    fn make_folder(&self, root: &Path) -> Result<()> {
        let folder = folder_of(&self.output);
        match folder.strip_prefix(root) {
            Ok(below) => folders_below(root, below),
            Err(_) => Ok(std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?),
        }
    }

    /// Returns the input file.
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

/// Lists all frames of the inputs.
fn jobs(arguments: &Arguments) -> Result<Vec<Job>> {
    let output = &arguments.output;
    let folder = output.is_dir() || output.to_string_lossy().ends_with(std::path::is_separator);
    let single = arguments.input.len() == 1 && !arguments.input[0].is_dir() && !folder;
    let is_tiff =
        output.extension().is_some_and(|e| ["tif", "tiff"].iter().any(|k| e.eq_ignore_ascii_case(k)));
    if !single && !folder && is_tiff {
        bail!("{}: several frames go into a folder; name one", output.display());
    }
    let mut jobs = Vec::new();
    for input in &arguments.input {
        if input.is_dir() {
            if !input.join("dataset.toml").exists() {
                bail!(
                    "{0}: a folder without dataset.toml; give its images, such as {0}/*.tif, or make it a dataset with `radcam import`",
                    input.display()
                );
            }
            let dataset = Arc::new(reduction::open(input)?);
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

/// Refuses an output that two frames share, that is also an input, or that exists already.
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
        crate::output::must_be_file_or_new(output).with_context(|| output.display().to_string())?;
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
    let calibrated = &calibration.description.camera;
    let mut found = calibrated.differences(now);
    // Without a stated row order the top row comes first by default, but the frames of the calibration may
    // differ.
    if row_order_of(now) == Some(BOTTOM_UP) && row_order_of(calibrated).is_none() {
        found.push(format!(
            "its rows run from the bottom to the top ({ROW_ORDER}), and the calibration does not state how its own do"
        ));
    }
    let size = (now.height, now.width) != calibration.k.dim();
    if found.is_empty() || (force && !size) {
        return Ok(());
    }
    let advice = if size { "" } else { "; --force corrects all the same" };
    Err(CorrectError::Settings(found.join("; ") + advice).into())
}

/// Notes on frames, such as facts that the calibration states and the frames do not. For many frames with the
/// same kind of note, the first is named.
#[derive(Debug, Default)]
pub struct Notes {
    texts: Vec<String>,
    kinds: BTreeSet<String>,
}

impl Notes {
    fn say(&mut self, file: &Path, kind: &str, text: String) {
        if self.kinds.insert(kind.to_string()) {
            tracing::warn!("{}: {text}", file.display());
            self.texts.push(format!("{}: {text}", file.display()));
        }
    }

    /// Notes settings of a frame that cannot be compared with the calibration, and a different temperature.
    fn compare(&mut self, file: &Path, calibrated: &CameraInfo, now: &CameraInfo) {
        for text in unknown(calibrated, now) {
            self.say(file, &text.clone(), text);
        }
        if row_order_of(calibrated) == Some(BOTTOM_UP) && row_order_of(now).is_none() {
            let text = format!(
                "does not state how its rows run ({ROW_ORDER}): taken from the bottom to the top as those of the calibration"
            );
            self.say(file, "row order", text);
        }
        if let (Some(was), Some(is)) = (calibrated.temperature_c, now.temperature_c)
            && (is - was).abs() > FAR_C
        {
            self.say(
                file,
                "temperature",
                format!("taken at {is} °C, and the calibration at {was} °C: the dark current differs"),
            );
        }
    }

    /// Compares a frame with the dark reference at its exposure and with the range of the codes.
    ///
    /// # Errors
    ///
    /// The frame is darker than the dark reference, unless `force` accepts that.
    pub fn look(
        &mut self,
        file: &Path,
        frame: &Array2<u16>,
        corrector: &Corrector,
        (calibration, exposure_s, force): (&Calibration, f64, bool),
    ) -> Result<()> {
        let error_dn = calibration.dark.std_err_at(exposure_s);
        if error_dn > calibration.dark_noise_dn(corrector.dark_dn()) {
            self.say(
                file,
                "dark",
                format!(
                    "at {} s the dark reference of a pixel is known to {error_dn:.1} DN only: take darks near this exposure",
                    six_digits(exposure_s)
                ),
            );
        }
        let mut codes: Vec<u16> = frame.iter().copied().collect();
        let full = corrector.full_scale_dn();
        let share = codes.iter().filter(|d| **d >= full).count() as f64 / codes.len().max(1) as f64;
        if share > CLIPPED {
            self.say(
                file,
                "clipped",
                format!(
                    "{} of the pixels are at full scale, {full} DN: their corrected values are too low",
                    percent(share)
                ),
            );
        }
        let half = codes.len() / 2;
        let median = if codes.is_empty() { 0.0 } else { f32::from(*codes.select_nth_unstable(half).1) };
        if !force {
            corrector
                .is_lit(calibration, exposure_s, median.into())
                .with_context(|| file.display().to_string())?;
        }
        Ok(())
    }

    /// Notes output codes that clip the corrected values.
    fn cut(&mut self, file: &Path, cut: Cut) {
        for (share, code, advice) in
            [(cut.low, 0, "a larger OFFSET"), (cut.high, u16::MAX, "a smaller SCALE")]
        {
            if share > CLIPPED {
                let text = format!("{} of the corrected pixels are cut off at code {code}", percent(share));
                self.say(file, advice, format!("{text}; --codes SCALE,OFFSET with {advice} keeps them"));
            }
        }
    }

    pub fn texts(&self) -> &[String] {
        &self.texts
    }
}

/// Returns the properties of camera and settings that one side does not state and that cannot be compared.
pub fn unknown(calibrated: &CameraInfo, now: &CameraInfo) -> Vec<String> {
    let (here, there) = (calibrated.unstated(now), now.unstated(calibrated));
    let here = (!here.is_empty())
        .then(|| format!("does not state {}: taken to be as in the calibration", here.join(", ")));
    let there = (!there.is_empty())
        .then(|| format!("the calibration does not state {}: taken to be as here", there.join(", ")));
    here.into_iter().chain(there).collect()
}

/// Share of clipped pixels above which a note is made; usual sensors have fewer hot pixels.
const CLIPPED: f64 = 1e-3;
/// Temperature difference above which a note is made, °C. Dark current doubles in some 6 to 8 °C.
const FAR_C: f64 = 3.0;

/// Frame outside a dataset, with its exposure.
pub struct Plain {
    pub pixels: Array2<u16>,
    pub exposure_s: f64,
}

impl Plain {
    /// Reads a frame and compares camera and settings with the calibration. The facts come from the frame,
    /// its name, or the dataset of its folder. A frame without stated facts is checked by its size and codes.
    pub fn read(
        path: &Path,
        calibration: &Calibration,
        exposure_s: Option<f64>,
        force: bool,
        notes: &mut Notes,
    ) -> Result<Self> {
        let named = || path.display().to_string();
        if is_corrected(path) {
            bail!("{}: was corrected already ({CORRECTED}); give the raw frame", path.display());
        }
        let mut pixels = image::read_single(path).with_context(named)?;
        let calibrated = &calibration.description.camera;
        let (mut now, said) = match FrameTag::read(path) {
            Some(tag) => (tag.camera, Some(tag.exposure_s)),
            None => {
                let (mut facts, _) = facts(path)?;
                if let Some(why) = facts.processed.as_ref().filter(|_| !force) {
                    bail!("{}: {why}; give the raw frame, or --force", path.display());
                }
                let doubt = facts.doubts.iter().find(|d| d.starts_with("exposure_s"));
                if let Some(doubt) = doubt.filter(|_| exposure_s.is_none()) {
                    bail!("{}: {doubt}; give --exposure-s", path.display());
                }
                for text in &facts.overruled {
                    notes.say(path, text, text.clone());
                }
                // A calibration of whole frames includes their overscan.
                if pixels.dim() != calibration.k.dim() && !force {
                    let region = region_of(&facts, pixels.dim()).map_err(anyhow::Error::msg);
                    if let Some(region) = region.with_context(named)? {
                        pixels = region.of(&pixels).to_owned();
                    }
                }
                turn(&mut pixels, &mut facts, calibrated, path, notes)?;
                let format = facts.mosaic.as_ref().map(|p| pixel_format(p, calibrated.bit_depth));
                let camera = CameraInfo { pixel_format: format.unwrap_or_default(), ..facts.camera_info() };
                (camera, facts.exposure_s)
            }
        };
        (now.height, now.width) = pixels.dim();
        if now.bit_depth == 0 {
            let stored = image::stored_bits(path).with_context(named)?;
            let largest = pixels.iter().fold(0, |a, b| a | b);
            let up = largest.trailing_zeros();
            // Codes stored in the upper bits: the noise of any unshifted frame fills single codes.
            let is_upper = u32::from(calibrated.bit_depth) + up == u32::from(stored);
            if largest > 255 && up >= 2 && (is_upper || !force) {
                if !is_upper {
                    return Err(CorrectError::Settings(format!(
                        "all codes are multiples of {}: shifted up by {up} bits, and frames of the calibration's {} bits would be by {} in {stored} \
                         bits; import such frames with others of theirs, or --force takes the codes as they are",
                        1u32 << up,
                        calibrated.bit_depth,
                        stored.saturating_sub(calibrated.bit_depth)
                    )))
                    .with_context(named);
                }
                pixels.mapv_inplace(|code| code >> up);
                notes.say(
                    path,
                    "shifted",
                    format!("all codes are multiples of {}: shifted down by {up} bits", 1u32 << up),
                );
            }
            let (most, full) = (pixels.iter().max().copied().unwrap_or(0), calibrated.full_scale_dn());
            if most > full && !force {
                return Err(CorrectError::Settings(format!(
                    "holds {most} DN, and the largest code of the calibration's {} bits is {full} DN: codes stretched to more bits, or a \
                     calibration of frames so dim that `radcam import` took them for fewer bits (--bit-depth)",
                    calibrated.bit_depth
                )))
                .with_context(named);
            }
            // Stretched dark frames pass the range check above: their codes fit into the calibration's bits.
            if let Some(found) = stretch(&pixels).filter(|_| stored > calibrated.bit_depth && !force) {
                return Err(CorrectError::Settings(format!(
                    "codes count in steps of {}: those of fewer bits, stretched to more, and the calibration is of codes in steps of 1; \
                     `radcam import` takes them back",
                    six_digits(found.step)
                )))
                .with_context(named);
            }
            if stored < calibrated.bit_depth {
                now.bit_depth = stored;
            }
        }
        check(calibration, &now, force).with_context(named)?;
        notes.compare(path, calibrated, &now);
        if let (Some(given), Some(said)) = (exposure_s, said)
            && (given / said - 1.0).abs() > 1e-6
        {
            notes.say(
                path,
                "exposure",
                format!("states an exposure of {said} s, and the {given} s given are taken"),
            );
        }
        let exposure_s = exposure_s.or(said).unwrap_or_else(|| {
            let exposure_s = calibration.dark.exposure_s;
            notes.say(
                path,
                "no exposure",
                format!(
                    "states no exposure: the {exposure_s} s of the calibration's darks are taken; give --exposure-s"
                ),
            );
            exposure_s
        });
        // A bias frame has an exposure of 0.
        if !(0.0..=MAX_EXPOSURE_S).contains(&exposure_s) {
            bail!(
                "{}: states an exposure of {exposure_s} s, which cannot be; give --exposure-s",
                path.display()
            );
        }
        Ok(Self { pixels, exposure_s })
    }
}

/// Flips the rows of a frame whose stated row order differs from the calibration's.
///
/// # Errors
///
/// A mosaic is refused: flipping would change its colour pattern.
fn turn(
    pixels: &mut Array2<u16>,
    facts: &mut Facts,
    calibrated: &CameraInfo,
    path: &Path,
    notes: &mut Notes,
) -> Result<()> {
    let Some((own, known)) = facts.row_order().zip(row_order_of(calibrated)).filter(|(a, b)| a != b) else {
        return Ok(());
    };
    if facts.mosaic.is_some() {
        return Err(CorrectError::Settings(format!(
            "its rows are {own} and the calibration's are {known} ({ROW_ORDER}), and turned its colour pattern would be another; write it in the \
             order of the calibration"
        )))
        .with_context(|| path.display().to_string());
    }
    pixels.invert_axis(Axis(0));
    *pixels = pixels.as_standard_layout().to_owned();
    facts.bottom_up = facts.bottom_up.map(|up| !up);
    notes.say(
        path,
        "turned",
        format!("its rows are {own} and the calibration's are {known} ({ROW_ORDER}): turned"),
    );
    Ok(())
}

/// Returns the order of a camera's rows, if it is stated.
fn row_order_of(camera: &CameraInfo) -> Option<&str> {
    camera.features.get(ROW_ORDER).and_then(|order| order.as_str())
}

/// Returns the step of codes that were stretched to more bits.
fn stretch(pixels: &Array2<u16>) -> Option<Stretch> {
    let mut occurring = Occurring::default();
    occurring.add(pixels.as_standard_layout().as_slice().unwrap_or_default());
    occurring.stretch()
}

/// Returns the description stored in a corrected image.
pub(super) fn description(calibration: &Path, codes: Option<Codes>, corrector: &Corrector) -> String {
    serde_json::json!({
        "format": CORRECTED,
        "calibration": calibration.display().to_string(),
        "value": if codes.is_some() { "scale * DN + offset" } else { "DN above the dark reference" },
        "scale": codes.map(|c| c.scale),
        "offset": codes.map(|c| c.offset),
        "replaced_defects": corrector.replaced(),
    })
    .to_string()
}

/// Shares of pixels clipped at code 0 and at the largest code.
#[derive(Debug, Clone, Copy, Default)]
struct Cut {
    low: f64,
    high: f64,
}

fn write(
    corrector: &Corrector,
    frame: &Array2<u16>,
    codes: Option<Codes>,
    description: &str,
    path: &Path,
) -> Result<Cut> {
    let mut cut = Cut::default();
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
            let share =
                |code: u16| out.iter().filter(|c| **c == code).count() as f64 / out.len().max(1) as f64;
            cut = Cut { low: share(0), high: share(u16::MAX) };
            image::described_bytes::<Gray16>(out.view(), description)?
        }
    };
    write_whole(path, &bytes)?;
    Ok(cut)
}
