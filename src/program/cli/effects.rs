//! `radcam effects`

use super::Outcome;
use super::common::{lines_of, may_be_written, no_effect, quoted};
use super::observe::{Colour, Datasets, observe};
use crate::dataset::write_whole;
use crate::diagnosis::{diagnose, searched};
use crate::model::{is_own_file, own_files, page, register_own_effect};
use crate::number::pretty;
use anyhow::{Context, Result, bail};
use radcam_sim::effects::{Effect, OwnEffect, UNBOUNDED, all, find};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct Arguments {
    /// One effect; all of them in a list where not given
    id: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(subcommand)]
    action: Option<Action>,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Turn the law that describes a campaign into an effect of your own, which every later diagnosis knows
    /// by name
    New(New),
}

#[derive(Debug, clap::Args)]
struct New {
    /// Its name: small letters, digits and hyphens
    name: String,
    /// Dataset that shows it; several of one camera are taken together
    #[arg(long, value_name = "DATASET", num_args = 1.., required = true)]
    from: Vec<PathBuf>,
    #[command(flatten)]
    colour: Colour,
    /// Effects that are known already; the paper's model alone where not given
    #[arg(long, value_name = "M.toml|SENSOR")]
    model: Option<PathBuf>,
    /// File; NAME.toml in the folder of your own effects where not given
    #[arg(short, long, value_name = "FILE.toml")]
    output: Option<PathBuf>,
    /// Also write a source of Rust that begins with it, for the catalogue or a program of your own
    #[arg(long, value_name = "FILE.rs")]
    rust: Option<PathBuf>,
    /// Replace files that are there
    #[arg(long)]
    overwrite: bool,
}

/// Returns the folder in which every command looks for the user's own effects.
fn folder() -> Option<PathBuf> {
    // Relative paths must be ignored (XDG Base Directory Specification 0.8).
    let of = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let settings = of("XDG_CONFIG_HOME").or_else(|| of("HOME").map(|home| home.join(".config")));
    settings.map(|folder| folder.join("radcam").join("effects"))
}

/// Registers the user's own effects: those of their folder, and those of the named files and folders. Invalid
/// files in the folder are skipped with a warning.
pub fn register_own(named: &[PathBuf]) -> Result<()> {
    if let Some(folder) = folder().filter(|folder| folder.is_dir()) {
        for path in own_files(&folder)? {
            if let Err(e) = register_own_effect(&path) {
                tracing::warn!("not an effect of your own: {e}");
            }
        }
    }
    for path in named {
        let files = if path.is_file() { vec![path.clone()] } else { own_files(path)? };
        for file in files {
            register_own_effect(&file)?;
        }
    }
    Ok(())
}

/// Generates the Rust source of an effect, with a test. It starts from formulas; `predict` and `draw` are to
/// be replaced when the mechanism is known.
fn source_of(own: &OwnEffect) -> Result<String> {
    let text = own.to_toml().map_err(anyhow::Error::msg)?;
    // One mark more than the longest run of marks in the text.
    let runs = text.split(|c| c != '#').map(str::len);
    let marks = "#".repeat(1 + runs.max().unwrap_or(0));
    let words = own.name.split('-').filter(|word| !word.is_empty());
    let camel: String = words.map(|word| word[..1].to_uppercase() + &word[1..]).collect();
    // Avoid a type name that the source uses, and one that begins with a digit.
    let kind = match format!("{camel}Effect") {
        kind if kind == "OwnEffect" || kind.starts_with(|c: char| c.is_ascii_digit()) => {
            format!("Effect{camel}")
        }
        kind => kind,
    };
    let about = lines_of(&format!("{}: {}.", own.name, own.page.signature), 106, 106);
    let about: Vec<String> = about.iter().map(|line| format!("//! {line}")).collect();
    Ok(include_str!("own_effect.rs.template")
        .replace("{about}", &about.join("\n"))
        .replace("{kind}", &kind)
        .replace("{name}", &own.name)
        .replace("{marks}", &marks)
        .replace("{text}", &text))
}

fn new(of: &New) -> Result<()> {
    // Check before reading the frames, which takes time.
    OwnEffect { name: of.name.clone(), ..Default::default() }.check_name().map_err(anyhow::Error::msg)?;
    let is_own = |e: &&'static dyn Effect| e.written().is_some();
    if let Some(known) = find(&of.name).filter(|known| !(of.overwrite && is_own(known))) {
        let replace = if is_own(&known) { "; --overwrite replaces it" } else { "; choose another name" };
        bail!("there is an effect {} already{replace}", of.name);
    }
    let output = match &of.output {
        Some(path) => path.clone(),
        None => {
            let folder = folder().context("neither HOME nor XDG_CONFIG_HOME is set: name a file by -o")?;
            std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
            folder.join(format!("{}.toml", of.name))
        }
    };
    if !is_own_file(&output) {
        bail!("{}: an effect is read from a file whose name ends in .toml", output.display());
    }
    for path in std::iter::once(&output).chain(&of.rust) {
        may_be_written(path, of.overwrite)?;
    }
    // Unregister the replaced effect, so that the search does not know it.
    radcam_sim::effects::unregister(&of.name);
    let datasets = Datasets { paths: of.from.clone(), colour: of.colour.clone() };
    let effects = super::model::read_effects(of.model.as_deref())?;
    let all = observe(&datasets)?;
    let diagnosis = diagnose(&all, None, searched(&all, &effects), &mut |text| tracing::info!("{text}"));
    let Some(law) = diagnosis.proposal else {
        bail!("no law is proposed for {}: {}", datasets.names(), diagnosis.verdict.sentence());
    };
    let own = law.own_effect(&of.name, &datasets.names());
    own.check().map_err(anyhow::Error::msg)?;
    write_whole(&output, own.to_toml().map_err(anyhow::Error::msg)?.as_bytes())?;
    if let Some(path) = &of.rust {
        write_whole(path, source_of(&own)?.as_bytes())?;
    }
    println!("{}", law.sentence());
    println!("  {} has it as the effect {}", output.display(), own.name);
    if let Some(path) = &of.rust {
        println!("  {} has it as a source of Rust", path.display());
    }
    let is_usual = folder().is_some_and(|folder| output.parent() == Some(folder.as_path()));
    let option = if is_usual {
        String::new()
    } else {
        format!(" --effects {}", quoted(&output.display().to_string()))
    };
    println!("  known by name from now on:  radcam diagnose DATASET{option}");
    Ok(())
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    if let Some(Action::New(of)) = &arguments.action {
        new(of)?;
        return Ok(Outcome::Agreement);
    }
    let Some(id) = &arguments.id else {
        if arguments.json {
            let pages: Vec<_> = all().iter().map(|e| page(*e)).collect();
            println!("{}", serde_json::to_string_pretty(&pages)?);
            return Ok(Outcome::Agreement);
        }
        println!("{:<30} signature", "effect");
        for e in all() {
            let width = 100;
            let mut lines = lines_of(e.page().signature, width - 31, width - 31).into_iter();
            println!("{:<30} {}", e.id(), lines.next().unwrap_or_default());
            lines.for_each(|line| println!("{:31}{line}", ""));
        }
        return Ok(Outcome::Agreement);
    };
    let found = named(id);
    if found.len() > 1 {
        println!("\"{id}\" may be one of these; `radcam effects ID` shows one:");
        for e in &found {
            println!("  {:<28} {}", e.id(), e.page().what);
        }
        return Ok(Outcome::Agreement);
    }
    if let (true, Some(text)) = (found.is_empty(), of_base_model(id)) {
        println!("{text}");
        return Ok(Outcome::Agreement);
    }
    let Some(e) = found.first().copied() else {
        bail!("{}", no_effect(id, all().iter().map(|e| e.id())));
    };
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&page(e))?);
        return Ok(Outcome::Agreement);
    }
    let of = e.page();
    println!("{} (acts on: {})\n", e.id(), e.stage().words());
    for (title, text) in [
        ("what happens", of.what),
        ("equation", of.equation),
        ("signature", of.signature),
        ("look-alikes", of.look_alikes),
        ("remedy", of.remedy),
        ("how to measure", of.measure),
        ("source", of.source),
    ] {
        let text = if text.is_empty() { "not known" } else { text };
        // Each form of an equation on its own lines.
        let forms = text.split("; ").map(|form| lines_of(form, 80, 80));
        let parts: Vec<Vec<String>> =
            if title == "equation" { forms.collect() } else { vec![lines_of(text, 80, 80)] };
        let mut lines = parts.into_iter().flatten();
        println!("  {title:<14} {}", lines.next().unwrap_or_default());
        lines.for_each(|line| println!("  {:14} {line}", ""));
    }
    println!("\n  parameters");
    for p in e.parameters() {
        let range = match p.unit {
            "choice" => String::new(),
            unit if p.max == UNBOUNDED => {
                let least = if p.min == 0.0 { ", not negative" } else { "" };
                format!(" ({}{least})", if unit == "1" { "a ratio" } else { pretty(unit) })
            }
            unit => {
                format!(" ({} to {}{}{})", p.min, p.max, if unit == "1" { "" } else { " " }, pretty(unit))
            }
        };
        let mut lines = lines_of(&format!("{}{range}", p.meaning), 68, 68).into_iter();
        println!("    {:<24} {}", p.name, lines.next().unwrap_or_default());
        lines.for_each(|line| println!("    {:24} {line}", ""));
    }
    Ok(Outcome::Agreement)
}

/// Finds effects by identifier or by common name.
fn named(word: &str) -> Vec<&'static dyn Effect> {
    let lower = word.to_lowercase();
    find(&lower).map_or_else(
        || all().into_iter().filter(|e| e.also_called().contains(&lower.as_str())).collect(),
        |e| vec![e],
    )
}

/// Explains a common name of a property that every camera has and that is not an effect.
fn of_base_model(word: &str) -> Option<String> {
    let of: [(&[&str], &str); 5] = [
        (&["vignetting", "shading", "vignette", "lens shading"], "shading is measured from the flats"),
        (
            &["prnu", "dust", "pattern", "fixed pattern noise", "fpn"],
            "PRNU and dust are measured from the flats",
        ),
        (&["dsnu", "offset pattern"], "DSNU is measured from the darks"),
        (
            &["hot pixels", "hot pixel", "dead pixels", "defect pixels"],
            "defect pixels are found and left out",
        ),
        (
            &["read noise", "noisy pixels", "shot noise", "dark current"],
            "noise of pixels and dark charge are fitted",
        ),
    ];
    let lower = word.to_lowercase();
    let found = of.iter().find(|(words, _)| words.contains(&lower.as_str()))?;
    Some(format!("{word} is part of the base model, which every camera has, and no effect: {}.", found.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The generated source equals the file that the tests compile.
    #[test]
    fn a_source_is_that_which_is_compiled() {
        let mut own = OwnEffect { name: "jitter-of-the-samples".into(), ..Default::default() };
        own.formulas.insert("variance".into(), "k * (mu / 1000)^2".into());
        own.parameters.insert("k".into(), 8.0);
        own.units.insert("k".into(), "DN^2".into());
        own.page.what = "The instant at which a sample is taken \"jitters\".".into();
        own.page.signature = "more noise of single pixels, growing as the square of the signal".into();
        assert_eq!(source_of(&own).unwrap(), include_str!("../../../tests/it/jitter_of_the_samples.rs"));
    }
}
