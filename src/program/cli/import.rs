//! `radcam import`

use super::Outcome;
use super::common::{STOP, plane};
use super::progress::Show;
use crate::dataset::{planes_in_words, write_whole};
use crate::import::{
    Found, MOSAIC, Map, MapSet, PATTERNS, ReadOptions, Survey, few, list, mosaic, mosaics_at_odds,
    must_be_free, propose, stated_mosaic, survey, write,
};
use anyhow::{Context, Result, bail};
use std::io::{BufRead, IsTerminal, Write};
use std::path::PathBuf;
use std::sync::atomic::Ordering;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Image files (TIFF and its stacks, PNG, FITS, NumPy arrays, HDF5 and NeXus), or folders of them
    #[arg(required_unless_present = "map", value_name = "FILE|FOLDER")]
    inputs: Vec<PathBuf>,
    /// The new dataset folder
    #[arg(short, long, value_name = "DATASET")]
    output: PathBuf,
    /// Which files make which sets, as this command wrote it and you completed it
    #[arg(long, value_name = "MAP.toml", conflicts_with = "inputs")]
    map: Option<PathBuf>,
    /// Copy the files (the default)
    #[arg(long, conflicts_with = "link")]
    copy: bool,
    /// Make hard links in place of copies: no space, and the same file system
    #[arg(long)]
    link: bool,
    /// Bits of a code; else the fewest of 8, 10, 12, 14, 16 that hold the largest code
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u8).range(1..=16))]
    bit_depth: Option<u8>,
    /// Of raw Bayer frames: row and column, 0 or 1, of the one pixel of every 2 x 2 cell that is kept; 0,0 is
    /// R of RGGB
    #[arg(long, value_name = "ROW,COLUMN", value_parser = plane, conflicts_with = "map")]
    plane: Option<[u8; 2]>,
    /// Axis of NumPy arrays and HDF5 datasets that counts the frames: 0, 1 or 2; else the first, and for
    /// NumPy a question where the pixels speak for another
    #[arg(long, value_name = "AXIS", value_parser = clap::value_parser!(u8).range(0..=2), conflicts_with = "map")]
    frames_axis: Option<u8>,
    /// Dataset of frames in HDF5 files, such as /entry/data/data; else the only one that can be
    #[arg(long, value_name = "PATH", conflicts_with = "map")]
    hdf5_dataset: Option<String>,
    /// Leave out files that cannot be read or are of another size than most; else nothing is imported
    #[arg(long, conflicts_with = "map")]
    leave_out_damaged: bool,
    /// Print where each value comes from
    #[arg(long)]
    explain: bool,
    /// Keep raw Bayer frames whole: their colour pattern (RGGB, BGGR, GRBG, GBRG); or mono, where the sensor
    /// has no colour filter
    #[arg(long, value_name = "PATTERN", value_parser = pattern, conflicts_with_all = ["map", "plane"])]
    pattern: Option<String>,
    /// Do not ask
    #[arg(short, long)]
    yes: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Parses a colour pattern, or `mono`.
fn pattern(text: &str) -> Result<String, String> {
    let known = PATTERNS.into_iter().chain(["mono"]).find(|p| p.eq_ignore_ascii_case(text));
    known.map(Into::into).ok_or_else(|| format!("write {} or mono", PATTERNS.join(", ")))
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let root = &arguments.output;
    must_be_free(root)?;
    let go_on = || !STOP.load(Ordering::Relaxed);
    let map = match &arguments.map {
        Some(path) => {
            let text = crate::input::settings(path).with_context(|| path.display().to_string())?;
            Map::from_toml(&text).with_context(|| path.display().to_string())?
        }
        None => {
            if let Some(dataset) = arguments.inputs.iter().find(|p| p.join("dataset.toml").exists()) {
                bail!("{} is a dataset already", dataset.display());
            }
            found(arguments, &go_on)?
        }
    };
    if !arguments.json {
        print!("{}", table(&map));
        if arguments.explain {
            print!("{}", explained(&map));
        }
    }
    for note in map.notes.iter().chain(&map.guessed()) {
        tracing::warn!("{note}");
    }
    let missing = map.missing();
    // The user has written or checked the map.
    let sure = arguments.yes || arguments.map.is_some();
    let declined = missing.is_empty() && !sure && !asked(root)?;
    if !missing.is_empty() || declined {
        let path = match &arguments.map {
            Some(path) => path.clone(),
            None => {
                let path = PathBuf::from(format!("{}.map.toml", root.display()));
                if path.exists() {
                    bail!("{} is there already; give it with --map, or remove it", path.display());
                }
                write_whole(&path, with_gaps(&map)?.as_bytes())?;
                path
            }
        };
        let again = format!("radcam import --map {0} -o {1}", path.display(), root.display());
        if declined {
            bail!("nothing was imported; change {} and run: {again}", path.display());
        }
        bail!(
            "names and headers do not say: {}{}; write it into {} and run: {again}",
            missing[..missing.len().min(LISTED)].join("; "),
            match missing.len().saturating_sub(LISTED) {
                0 => String::new(),
                more => format!("; and {more} more"),
            },
            path.display()
        );
    }
    let mut show = Show::new("import");
    let dataset = write(&map, root, arguments.link, |done, of| {
        show.step(done, of);
        go_on()
    })?;
    drop(show);
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&map)?);
    } else {
        let (frames, sets) = (dataset.rows().len(), dataset.sets().len());
        println!("\n{}: {frames} frames in {sets} sets; next: radcam noise, radcam diagnose", root.display());
    }
    Ok(Outcome::Agreement)
}

/// Maximum number of open questions in a message; the map has all.
const LISTED: usize = 12;

/// Surveys the files and sorts them into sets.
fn found(arguments: &Arguments, go_on: &impl Fn() -> bool) -> Result<Map> {
    let listing = list(&arguments.inputs)?;
    listing.notes.iter().for_each(|note| tracing::warn!("{note}"));
    if listing.files.is_empty() {
        bail!(
            "no image files there: radcam reads TIFF, PNG, BMP, FITS, HDF5 (.h5, .hdf5, .nxs) and NumPy arrays (.npy)"
        );
    }
    let options = ReadOptions {
        frames_axis: arguments.frames_axis.map(usize::from),
        hdf5_dataset: arguments.hdf5_dataset.clone(),
    };
    let mut show = Show::new("read");
    let Survey { frames, damaged, notes } = survey(&listing.files, &options, |done, of| {
        show.step(done, of);
        go_on()
    })?;
    drop(show);
    notes.iter().for_each(|note| tracing::warn!("{note}"));
    if !damaged.is_empty() {
        // One sentence names all files with the same fault.
        let mut of_reason: Vec<(&str, Vec<&PathBuf>)> = Vec::new();
        for (path, why) in &damaged {
            match of_reason.iter_mut().find(|(reason, _)| reason == why) {
                Some((_, paths)) => paths.push(path),
                None => of_reason.push((why, vec![path])),
            }
        }
        let said = |(why, paths): &(&str, Vec<&PathBuf>)| match paths.as_slice() {
            [one] => format!("{}: {why}", one.display()),
            many => {
                format!("{}: {why}", few(&many.iter().map(|p| p.display().to_string()).collect::<Vec<_>>()))
            }
        };
        let all = few(&of_reason.iter().map(said).collect::<Vec<_>>());
        if !arguments.leave_out_damaged || frames.is_empty() {
            let rest = if frames.is_empty() { "" } else { "; --leave-out-damaged imports the others" };
            bail!("{all}{rest}");
        }
        tracing::warn!("left out, {} files: {all}", damaged.len());
    }
    let pattern = kept_whole(&frames, arguments)?;
    Ok(Map {
        plane: arguments.plane,
        pattern,
        frames_axis: arguments.frames_axis,
        hdf5_dataset: arguments.hdf5_dataset.clone(),
        ..propose(&frames, arguments.bit_depth)?
    })
}

/// Returns the pattern under which frames of a colour camera are kept whole, if any.
fn kept_whole(found: &[Found], arguments: &Arguments) -> Result<Option<String>> {
    if arguments.plane.is_some() {
        return Ok(None);
    }
    if let (None, Some([one, other])) = (&arguments.pattern, mosaics_at_odds(found)) {
        bail!(
            "{}: the colour pattern is {}, and of {} it is {}: import them apart, or say which with --pattern",
            one.0.display(),
            one.1,
            other.0.display(),
            other.1
        );
    }
    match (&arguments.pattern, stated_mosaic(found)) {
        (Some(given), said) => {
            let given = Some(given.clone()).filter(|p| p != "mono");
            if let Some(said) = said.filter(|s| Some(s) != given.as_ref()) {
                tracing::warn!("headers say the colour pattern {said}, and --pattern counts");
            }
            Ok(given)
        }
        (None, Some(said)) if PATTERNS.contains(&said.as_str()) => bail!(
            "colour: headers say {said}, and the four pixels of a cell see four lights. Take one colour with {}; or keep the frames whole with \
             --pattern {said}, for `calibrate` and `correct`",
            planes_in_words(&said)
        ),
        (None, Some(said)) => bail!(
            "colour: headers say the pattern {said}, which radcam does not know; take one colour with --plane 0,0, 0,1, 1,0 or 1,1, or \
             give --pattern"
        ),
        (None, None) => {
            let apart = mosaic(found);
            if apart > MOSAIC {
                bail!(
                    "the four pixels of a 2 x 2 cell differ by {:.0} % of the signal: raw Bayer frames of a colour camera? Take one colour \
                     with --plane 0,0, 0,1, 1,0 or 1,1; or keep them whole with --pattern RGGB, BGGR, GRBG or GBRG; --pattern mono: the \
                     sensor has no colour filter",
                    100.0 * apart
                );
            }
            Ok(None)
        }
    }
}

/// Formats the map as a file, with a line for every missing exposure.
fn with_gaps(map: &Map) -> Result<String> {
    let text = toml::to_string(map)?;
    let mut sets = map.sets.iter();
    let mut open = false;
    let mut out = String::new();
    for line in text.lines() {
        out += line;
        out.push('\n');
        if line == "[[set]]" {
            open = sets.next().is_some_and(|s| s.exposure_s.is_none());
        } else if open && line.starts_with("kind = ") {
            out += "# exposure_s =   # seconds\n";
            open = false;
        }
    }
    Ok(out)
}

/// Lists the source of each value of each set.
fn explained(map: &Map) -> String {
    let of_set = |(k, set): (usize, &MapSet)| {
        let lines = set.from.iter().chain(&set.guessed).chain(&set.doubts);
        format!("\nset {k}\n{}", lines.map(|line| format!("  {line}\n")).collect::<String>())
    };
    let settings =
        map.features.iter().map(|(name, value)| format!("  {name} = {value}\n")).collect::<String>();
    let all =
        if settings.is_empty() { String::new() } else { format!("\nsettings of all frames\n{settings}") };
    all + &map.sets.iter().enumerate().map(of_set).collect::<String>()
}

/// Asks the user to confirm the table; fails if standard input is not a terminal.
fn asked(root: &std::path::Path) -> Result<bool> {
    if !std::io::stdin().is_terminal() {
        bail!("nobody can be asked whether this table is right: give --yes, or check the sets in a MAP file");
    }
    print!("\nImport these into {}? [Y/n] ", root.display());
    std::io::stdout().flush()?;
    let mut answer = String::new();
    std::io::stdin().lock().read_line(&mut answer)?;
    Ok(matches!(answer.trim().to_lowercase().as_str(), "" | "y" | "yes"))
}

/// Formats the sets as a table for checking.
fn table(map: &Map) -> String {
    let mut out = format!(
        "{:>4}  {:<16} {:>6}  {:>12}  {:>6}  {:>10}  first file\n",
        "set", "kind", "frames", "exposure", "light", "mean"
    );
    for (k, set) in map.sets.iter().enumerate() {
        let kind = format!("{}{}", set.kind, if set.kind_by_mean { " (by its mean)" } else { "" });
        let exposure = set.exposure_s.map_or("?".into(), |s| format!("{} s", crate::number::six_digits(s)));
        let light = set.illumination.map_or("1".into(), |v| v.to_string());
        let mean = set.mean_dn.map_or(String::new(), |m| format!("{m:.1} DN"));
        let first = set.files.first().map_or("", String::as_str);
        out += &format!(
            "{k:>4}  {kind:<16} {:>6}  {exposure:>12}  {light:>6}  {mean:>10}  {first}\n",
            set.files.len()
        );
    }
    let gain = map.gain_db.map_or(String::new(), |g| format!(", gain {g} dB"));
    let scale = map.scale().words().map_or(String::new(), |words| format!(", {words}"));
    let plane =
        map.plane.map_or(String::new(), |[y, x]| format!(", row {y} and column {x} of every 2 x 2 cell"));
    let pattern = map.pattern.as_ref().map_or(String::new(), |p| format!(", colour mosaic {p}"));
    let timed = map.sets.iter().all(|s| s.times_s.is_some());
    let times = if timed { "" } else { ", without times: drifts are looked for in the order of the names" };
    out + &format!("\n{} bits{gain}{scale}{plane}{pattern}{times}\n", map.bit_depth)
}
