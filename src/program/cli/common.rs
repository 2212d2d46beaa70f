//! Shared by several commands: logs, interruption, cameras by name, plans by name.

use crate::bench::{self, Illuminator};
use crate::camera::{Camera, sim};
use crate::capture::PLAN_FILE;
use crate::correct::Codes;
use crate::data_faults::DataFault;
use crate::plan::{Plan, SetPlan};
use anyhow::{Context, Result, bail};
use radcam_sim::Model;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Set by Ctrl-C or SIGTERM. A second signal ends the program at once. The first ends it after [`GRACE`], or
/// later if the command has called [`heard`].
pub static STOP: AtomicBool = AtomicBool::new(false);

/// Exit code of a run interrupted by Ctrl-C; shell convention: 128 plus the signal number.
pub const INTERRUPTED: u8 = 130;

pub fn start_logging(verbose: u8) {
    use std::io::IsTerminal;
    let level = match verbose {
        0 => "warn",
        1 => "info",
        _ => "debug",
    };
    let filter = tracing_subscriber::EnvFilter::try_from_env("RADCAM_LOG").unwrap_or_else(|_| {
        tracing_subscriber::EnvFilter::new(format!("radcam={level},radcam_aravis={level}"))
    });
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .without_time()
        .with_target(false)
        .init();
}

/// Deadline for a command to react to a signal. Blocking waits for a camera or a file system, and long sums,
/// miss it.
const GRACE: Duration = Duration::from_millis(600);
/// Extra time for a command that has reacted, to write its results (a named choice; a second signal ends it
/// at once).
const TO_FINISH: Duration = Duration::from_secs(10);

/// Set by [`heard`].
static HEARD: AtomicBool = AtomicBool::new(false);

/// Records that a command has reacted to the signal and is about to end, so that files and summaries are
/// completed.
pub fn heard() {
    HEARD.store(true, Ordering::SeqCst);
}

pub fn catch_interrupts() {
    let handler = || {
        if STOP.swap(true, Ordering::SeqCst) {
            std::process::exit(INTERRUPTED.into());
        }
        std::thread::spawn(|| {
            std::thread::sleep(GRACE);
            if HEARD.load(Ordering::SeqCst) {
                std::thread::sleep(TO_FINISH);
            }
            eprintln!("radcam: interrupted");
            std::process::exit(INTERRUPTED.into());
        });
    };
    if let Err(e) = ctrlc::set_handler(handler) {
        tracing::debug!(error = %e, "Ctrl-C will end the program at once");
    }
}

/// Loads a sensor by name or a model file, with another seed if given.
pub fn load_model(name: &str, seed: Option<u64>) -> Result<Model> {
    sim::model(name, seed).map_err(anyhow::Error::msg)
}

/// Loads a plan by name or from a file. With `resume`, loads the plan of the campaign; a plan named again
/// must match it.
pub fn load_plan(name: Option<&str>, resume: bool, root: &Path) -> Result<Plan> {
    if !resume {
        return plan_of(name.unwrap_or("standard"));
    }
    let stored = root.join(PLAN_FILE);
    if !stored.exists() {
        bail!(
            "{}: no capture was begun here (no {PLAN_FILE}), so none can be continued; leave --resume out",
            root.display()
        );
    }
    let text = crate::input::settings(&stored).with_context(|| stored.display().to_string())?;
    let plan = Plan::from_toml(&text).with_context(|| stored.display().to_string())?;
    let Some(name) = name else { return Ok(plan) };
    let given = plan_of(name)?;
    // A started campaign stores exposures in seconds, rounded to the camera's steps; they are not compared.
    let same = |a: &SetPlan, b: &SetPlan| {
        (a.kind, a.frames, a.configuration) == (b.kind, b.frames, b.configuration)
            && a.illumination == b.illumination
    };
    if plan.sets.len() != given.sets.len() || !plan.sets.iter().zip(&given.sets).all(|(a, b)| same(a, b)) {
        bail!(
            "{} was begun with another plan than {name}; leave --plan out to go on with its own",
            root.display()
        );
    }
    Ok(plan)
}

fn plan_of(name: &str) -> Result<Plan> {
    if let Some(plan) = Plan::named(name) {
        return Ok(plan);
    }
    if !Path::new(name).exists() {
        bail!("no plan \"{name}\": neither a file nor one of quick, standard, emva1288");
    }
    let text = crate::input::settings(name.as_ref()).with_context(|| name.to_string())?;
    Plan::from_toml(&text).with_context(|| name.to_string())
}

/// Opens a camera by name, with its bench.
pub fn open_camera(name: &str, plan: &Plan) -> Result<(Box<dyn Camera>, Box<dyn Illuminator>)> {
    let mut camera = crate::camera::open(name)?;
    let bench = bench::of(&mut *camera, plan);
    Ok((camera, bench))
}

/// Checks that files can be written, before anything is computed.
pub fn can_be_written<'a>(paths: impl IntoIterator<Item = &'a PathBuf>) -> Result<()> {
    for path in paths {
        let folder = path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if path.is_dir() && !path.is_symlink() {
            bail!("{} is a folder; name a file", path.display());
        }
        crate::output::must_be_file_or_new(path).with_context(|| path.display().to_string())?;
        tempfile::tempfile_in(folder).with_context(|| format!("{} cannot be written", path.display()))?;
    }
    Ok(())
}

/// Creates the folders of a relative path below an output folder; refuses links.
pub fn folders_below(root: &Path, relative: &Path) -> Result<()> {
    let made = crate::output::folders_below(root, relative);
    made.map_err(|(path, e)| anyhow::Error::new(e).context(path.display().to_string()))
}

/// Refuses to overwrite a file unless requested.
pub fn may_be_written(path: &PathBuf, overwrite: bool) -> Result<()> {
    if path.exists() && !overwrite {
        bail!("{} is there already; --overwrite writes over it", path.display());
    }
    can_be_written([path])
}

/// Parses a finite number above 0.
pub fn above_0(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("write a number above 0".into()),
    }
}

/// Parses a time in seconds above 0.
pub fn seconds(text: &str) -> Result<Duration, String> {
    let known = above_0(text).ok().and_then(|s| Duration::try_from_secs_f64(s).ok());
    // The limit allows the time to be added to a clock.
    known
        .filter(|d| *d <= Duration::from_secs(1_000_000_000))
        .ok_or("write a number of seconds above 0, no more than 1e9".into())
}

/// Returns the message for an unknown effect, with similar names.
pub fn no_effect<'a>(id: &str, known: impl Iterator<Item = &'a str>) -> String {
    let plain = |text: &str| text.to_lowercase().replace(['_', ' '], "-");
    let wanted = plain(id);
    let near = |known: &&str| {
        known.contains(&*wanted)
            || wanted.contains(*known)
            || strsim::levenshtein(&wanted, known) <= 1 + wanted.len() / 6
    };
    let near: Vec<&str> = known.filter(near).collect();
    if near.is_empty() {
        format!("no effect \"{id}\"; `radcam effects` lists them")
    } else {
        format!("no effect \"{id}\"; is it {}?", near.join(" or "))
    }
}

/// Returns the columns of the terminal, clamped to a readable width; 100 for a file or a pipe.
pub fn width() -> usize {
    use std::io::IsTerminal;
    const USUAL: usize = 100;
    const READABLE: std::ops::RangeInclusive<usize> = 60..=120;
    let terminal = std::io::stdout().is_terminal().then(terminal_size::terminal_size).flatten();
    let columns = terminal.map_or(USUAL, |(terminal_size::Width(columns), _)| usize::from(columns));
    columns.clamp(*READABLE.start(), *READABLE.end())
}

/// Breaks a text into lines of the terminal's width, each indented by `indent` spaces.
pub fn wrapped(text: &str, indent: usize) -> String {
    item(&" ".repeat(indent), text, indent)
}

/// Breaks a text into lines, with a head such as `  note: ` before the first and `indent` spaces before the
/// others.
pub fn item(head: &str, text: &str, indent: usize) -> String {
    let last_line = head.rsplit('\n').next().unwrap_or(head);
    let first = width().saturating_sub(last_line.chars().count());
    let lines = lines_of(text, first, width().saturating_sub(indent));
    format!("{head}{}", lines.join(&format!("\n{}", " ".repeat(indent))))
}

/// Breaks a text into lines with a maximum length for the first and for the others. A value stays on one line
/// with its error and unit.
pub fn lines_of(text: &str, first: usize, others: usize) -> Vec<String> {
    /// Signs and units that must not begin a line.
    const BELONG: [&str; 12] = ["±", "%", "DN", "DN²", "DN/e⁻", "DN/s", "e⁻", "e⁻/s", "s", "1/s", "Hz", "px"];
    let belongs = |before: &str, word: &str| {
        let word = word.trim_end_matches(|c: char| ",;:.)".contains(c));
        before == "±" || (BELONG.contains(&word) && before.ends_with(|c: char| c.is_ascii_digit()))
    };
    let mut parts: Vec<String> = Vec::new();
    let mut before = "";
    for word in text.split_whitespace() {
        match parts.last_mut().filter(|_| belongs(before, word)) {
            Some(part) => *part += &format!(" {word}"),
            None => parts.push(word.into()),
        }
        before = word;
    }
    let mut lines: Vec<String> = vec![String::new()];
    for part in parts {
        let most = if lines.len() == 1 { first } else { others };
        match lines.last_mut() {
            Some(line) if line.is_empty() => *line = part,
            Some(line) if line.chars().count() + 1 + part.chars().count() <= most => {
                *line += &format!(" {part}")
            }
            _ => lines.push(part),
        }
    }
    lines
}

/// Quotes a path or another word for a shell.
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "/._-+=:,@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.into();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}

/// Parses `row,column` of a 2 x 2 cell.
pub fn plane(text: &str) -> Result<[u8; 2], String> {
    let numbers: Vec<&str> = text.split(',').map(str::trim).collect();
    match numbers[..] {
        [y @ ("0" | "1"), x @ ("0" | "1")] => Ok([u8::from(y == "1"), u8::from(x == "1")]),
        _ => Err("write 0,0, 0,1, 1,0 or 1,1".into()),
    }
}

pub fn duration(seconds: f64) -> String {
    match seconds.round() as u64 {
        s @ 0..=99 => format!("{s} s"),
        s @ 100..=5999 => format!("{} min", (s + 30) / 60),
        s => format!("{} h {} min", s / 3600, s % 3600 / 60),
    }
}

/// Parses `scale,offset`.
pub fn codes(text: &str) -> Result<Codes, String> {
    let numbers: Vec<f32> = text
        .split(',')
        .map(|n| n.trim().parse().map_err(|_| format!("\"{n}\" is not a number")))
        .collect::<Result<_, String>>()?;
    match numbers[..] {
        [scale, offset] if scale > 0.0 && scale.is_finite() && offset.is_finite() => {
            Ok(Codes { scale, offset })
        }
        _ => Err("write scale,offset with a scale above 0".into()),
    }
}

/// Prints the data faults.
pub fn say_faults(faults: &[DataFault]) {
    for fault in faults {
        println!("{}", item("  ", &fault.to_string(), 4));
    }
}

/// Adds the preceding data faults to an error.
pub fn after_faults<T, E: Into<anyhow::Error>>(result: Result<T, E>, faults: &[DataFault]) -> Result<T> {
    result.map_err(|e| {
        let texts: Vec<&str> = faults.iter().map(|f| f.text.as_str()).collect();
        if texts.is_empty() {
            e.into()
        } else {
            anyhow::anyhow!("{:#}; before that: {}", e.into(), texts.join("; "))
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A value is never separated from its error and unit, and no line exceeds its columns.
    #[test]
    fn values_stay_with_their_units() {
        let text = "gain 0.5010 ± 0.0016 DN/e⁻, 28 % more signal, in 3 s (of 12 DN).";
        for columns in 22..60 {
            let lines = lines_of(text, columns - 4, columns);
            assert_eq!(lines.join(" "), text);
            assert!(lines.iter().all(|line| line.chars().count() <= columns), "{lines:?}");
            for value in ["0.5010 ± 0.0016 DN/e⁻,", "28 %", "3 s", "12 DN)."] {
                assert!(lines.iter().any(|line| line.contains(value)), "{lines:?}");
            }
        }
        assert_eq!(lines_of("", 10, 10), [""]);
    }
}
