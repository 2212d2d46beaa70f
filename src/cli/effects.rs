//! `radcam effects`

use super::Outcome;
use super::common::{lines_of, no_effect};
use crate::model::page;
use crate::number::pretty;
use anyhow::{Result, bail};
use radcam_sim::effects::{Effect, all, find};

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// One effect; all of them in a list where not given
    id: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
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
        // The forms of an equation each on lines of their own.
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

/// The effect of this identifier, or those that people call so.
fn named(word: &str) -> Vec<&'static dyn Effect> {
    let lower = word.to_lowercase();
    find(&lower).map_or_else(
        || all().into_iter().filter(|e| e.also_called().contains(&lower.as_str())).collect(),
        |e| vec![e],
    )
}

/// Properties that every camera has and that are no effect, by the words that people have for them.
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
