//! Commands of the program, one file each: parse, call the library, print.
//!
//! Results go to standard output, progress and logs to standard error. Exit codes: 0 done and in agreement, 1
//! done and the answer is a disagreement, 2 failed.

#![allow(clippy::print_stdout, clippy::print_stderr)] // printing is what a command line is for

// All output of the commands goes through `terminal`: these macros shadow the standard ones.
macro_rules! print {
    ($($text:tt)*) => { $crate::cli::terminal::out(format_args!($($text)*)) };
}
macro_rules! println {
    () => { $crate::cli::terminal::out(format_args!("\n")) };
    ($($text:tt)*) => {{
        $crate::cli::terminal::out(format_args!("{}\n", format_args!($($text)*)))
    }};
}
macro_rules! eprintln {
    ($($text:tt)*) => {{
        $crate::cli::terminal::err(format_args!("{}\n", format_args!($($text)*)))
    }};
}

mod common;
mod findings;
mod observe;
mod progress;
mod region;
mod secret;
mod terminal;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use common::{INTERRUPTED, STOP};
use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::atomic::Ordering;

/// Answer of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Outcome {
    Agreement,
    Disagreement,
}

/// Radiometric camera calibration and noise estimation for machine vision.
#[derive(Debug, Parser)]
#[command(name = "radcam", version, propagate_version = true, max_term_width = 100)]
#[command(
    after_help = "Exit codes: 0 done and in agreement; 1 done, and the answer is a disagreement; 2 it could not \
                        be done; 130 interrupted.\nLogs go to standard error: -v, -vv, or RADCAM_LOG=debug."
)]
struct Arguments {
    /// More log output (-vv: still more)
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,

    /// Folder or file of effects of your own, beside ~/.config/radcam/effects; may be given several times
    #[arg(long = "effects", global = true, value_name = "DIR|FILE")]
    own_effects: Vec<std::path::PathBuf>,

    #[command(subcommand)]
    verb: Verb,
}

macro_rules! verbs {
    ($($module:ident $verb:ident $about:literal)*) => {
        $(mod $module;)*

        #[derive(Debug, Subcommand)]
        enum Verb {
            $(#[doc = $about] $verb($module::Arguments)),*
        }

        impl Verb {
            fn run(&self) -> anyhow::Result<Outcome> {
                match self {
                    $(Self::$verb(arguments) => $module::run(arguments)),*
                }
            }
        }
    };
}

// Each command is one file with `Arguments` and `run`, and one line here: module, name, text of
// `radcam --help`.
verbs! {
    cameras Cameras "List the cameras that answer, and the simulated ones"
    capture Capture "Capture a plan with a camera into a dataset folder"
    simulate Simulate "Capture a plan with a simulated camera in this process"
    serve Serve "Serve a simulated camera over GigE Vision"
    investigate Investigate "From a camera to a verdict: capture, diagnose, and the measurement that distinguishes the closest candidates"
    import Import "Import image files into a dataset folder"
    noise Noise "Estimate gain and constant noise (Section IV of Healey and Kondepudy)"
    emva Emva "Evaluate a camera by EMVA 1288, with standard errors"
    plan_calibration PlanCalibration "Plan a calibration: how many configurations, frames and darks it needs"
    calibrate Calibrate "Make a calibration file: dark reference, fixed pattern K, defects (Section V)"
    correct Correct "Correct frames by a calibration (eq. 51)"
    stream Stream "Correct a camera's frames as they come; write them, or offer them as a camera"
    upload Upload "Write a calibration into a camera's own flat-field and defect memory"
    monitor Monitor "Check from time to time whether a camera is still the one that was calibrated"
    reduce Reduce "Reduce a campaign, or parts of it, to a file of statistics that noise, compare and diagnose take"
    merge Merge "Merge the statistics of parts of a campaign to those of the whole"
    scene Scene "Scene variation of a region: a property of the surface, independent of the light (Section VI)"
    surface Surface "Learn surfaces and identify them by their scene variation"
    budget Budget "Parts of a region's variance against intensity (Fig. 4)"
    reproduce Reproduce "Run the paper's experiments again and compare its numbers with ours (Section VII)"
    compare Compare "Compare a model with a campaign: where it fails, and by how much"
    report Report "Write everything about a campaign as one page: verdict, evidence, curves, images, numbers"
    workbench Workbench "Open a campaign or a camera in the browser: look, compare, add what is missing, save"
    diagnose Diagnose "Name the physical effect that a campaign shows and the model lacks"
    model Model "Make, show, change and fit model files"
    effects Effects "What each effect is, how it shows, and what to do about it"
    demo Demo "Serve, capture, measure and report a camera, all in one"
    completions Completions "Print the completions of a shell"
    man Man "Write the manual pages"
}

/// Text printed when the program is called without arguments.
const FIRST_STEPS: &str = "\
radcam measures what a camera does to light, and names what its model lacks.

  radcam demo                                  see it work, without a camera
  radcam investigate --camera ID -o DIR        your camera: from capture to a verdict
  radcam import FOLDER -o DATASET              your own TIFF, PNG or FITS files
  radcam diagnose DATASET                      which effect a campaign shows
  radcam calibrate DATASET -o CAL.tiff         dark reference and fixed pattern, for `radcam correct`

`radcam cameras` lists cameras, `radcam --help` every command, `radcam COMMAND --help` one.";

/// Builds the command line. Negative numbers are accepted as values.
fn command() -> clap::Command {
    fn lenient(command: clap::Command) -> clap::Command {
        command.allow_negative_numbers(true).mut_subcommands(lenient)
    }
    lenient(Arguments::command())
}

/// Sets a panic hook for failed output, because `println!` panics. A closed pipe, as with `| head`, ends the
/// program silently; any other failure ends it with the reason.
fn quiet_when_nobody_reads() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        let text = info.payload().downcast_ref::<String>();
        let printing = |t: &&String| t.starts_with("failed printing to std");
        if let Some(text) = text.filter(printing) {
            if text.contains("Broken pipe") {
                std::process::exit(0);
            }
            eprintln!("radcam: {text}");
            std::process::exit(2);
        }
        usual(info);
    }));
}

/// Runs the program with the arguments of the process.
pub fn main() -> ExitCode {
    ExitCode::from(run(std::env::args_os()))
}

/// Runs the program with these arguments, the first of which is its name. Returns the exit code.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    quiet_when_nobody_reads();
    if arguments.len() == 1 {
        println!("{FIRST_STEPS}");
        return 2;
    }
    let parsed = command().try_get_matches_from(arguments);
    let arguments = match parsed.and_then(|matches| Arguments::from_arg_matches(&matches)) {
        Ok(arguments) => arguments,
        // Help and version.
        Err(e) if !e.use_stderr() => e.exit(),
        Err(e) => {
            terminal::err(format_args!("{}", e.render()));
            return 2;
        }
    };
    common::start_logging(arguments.verbose);
    common::catch_interrupts();
    let outcome = effects::register_own(&arguments.own_effects).and_then(|()| arguments.verb.run());
    match outcome {
        Ok(Outcome::Agreement) => 0,
        Ok(Outcome::Disagreement) => 1,
        Err(error) => {
            // A closed reader (`| head`) is not an error.
            if error
                .downcast_ref::<std::io::Error>()
                .is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
            {
                return 0;
            }
            eprintln!("radcam: {}", once(&error));
            if STOP.load(Ordering::Relaxed) { INTERRUPTED } else { 2 }
        }
    }
}

/// Formats an error with its causes, without causes that the text contains already.
fn once(error: &anyhow::Error) -> String {
    let said = error.chain().fold(String::new(), |mut said, cause| {
        let cause = cause.to_string();
        if said.is_empty() {
            said = cause;
        } else if !said.contains(&cause) {
            said = format!("{said}: {cause}");
        }
        said
    });
    in_part(&said)
}

/// Shortens overlong words and lines in a message. Values from files are usually shortened where they are
/// named; this is the fallback.
fn in_part(message: &str) -> String {
    /// Limit above the length of usual paths, characters.
    const MAX_WORD: usize = 400;
    /// Limit above the longest list of questions, characters.
    const MAX_LINE: usize = 4000;
    let cut = |text: &str, most: usize| {
        let characters = text.chars().count();
        if characters <= most {
            return text.to_string();
        }
        let part = |from: usize, n: usize| text.chars().skip(from).take(n).collect::<String>();
        format!("{}...{}", part(0, most / 10), part(characters - most / 10, most / 10))
    };
    let words = |line: &str| line.split(' ').map(|word| cut(word, MAX_WORD)).collect::<Vec<_>>().join(" ");
    message.lines().map(|line| cut(&words(line), MAX_LINE)).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::once;

    #[test]
    fn a_cause_is_said_once() {
        let io = || std::io::Error::other("no space");
        let said = crate::dataset::DatasetError::Io { path: "x".into(), source: io() };
        assert_eq!(once(&said.into()), "x: no space");
        assert_eq!(once(&anyhow::Error::new(io()).context("pilot")), "pilot: no space");
    }
}
