//! Printed diagnosis: the verdict, a line for each effect, the sensor's values, the ladder of errors and the
//! next steps. With `--explain` also the evidence for each effect, and all parameters.

use super::common::{item, say_faults, width, wrapped};
use crate::agreement::P_LIMIT;
use crate::diagnosis::{Diagnosis, Missing, Proposal, Size, WEAK};
use crate::inference::Fitted;
use crate::number::{Quantity, chance, percent, six_digits};
use crate::report;

/// Heading and dataset of a printed diagnosis.
pub struct Place<'a> {
    /// First printed line.
    pub title: &'a str,
    /// Argument DATASET of the next commands.
    pub datasets: &'a str,
    /// Also prints parameters and evidence.
    pub explain: bool,
}

/// Prints a diagnosis.
pub fn print(place: &Place<'_>, d: &Diagnosis) {
    println!("{}\n", place.title);
    say_faults(&d.data_faults);
    let verdict = if place.explain { d.verdict.sentence() } else { d.verdict.brief() };
    println!("{}", wrapped(verdict, 2));
    if place.explain {
        d.missing.iter().for_each(explained);
    } else if let Some(law) = d.proposal.as_ref().filter(|law| law.holds() && law.beside.is_empty()) {
        instead_of_names(law, d);
    } else if let (Some(fitted), false) = (&d.fitted, d.missing.is_empty()) {
        table(d, fitted);
    }
    sensor(place, d);
    ladder(place, d);
    d.proposal.iter().for_each(|p| law(place, p));
    if let Some(next) = &d.next_measurement {
        println!("\n{}", wrapped(&format!("next measurement: {next}"), 2));
        println!("    (as a plan for `radcam capture`: --next PLAN.toml)");
    }
    for note in &d.notes {
        println!("{}", item("  note: ", note, 4));
    }
    if let (false, Some(first)) = (place.explain, d.missing.first()) {
        next_commands(place.datasets, first, d.proposal.as_ref().is_some_and(Proposal::holds));
    }
}

/// Prints one line for each effect: its size, its share of the misfit, and the error of an evaluation that
/// ignores it.
fn table(d: &Diagnosis, fitted: &Fitted) {
    let mut rows = vec![["", "size", "of the misfit", "error if ignored"].map(String::from)];
    let nothing = || "nothing".to_string();
    // Small effects without cost share one line.
    let matters = |(k, m): &(usize, &Missing)| {
        *k == 0
            || m.share >= WEAK
            || m.tied_with.is_some()
            || m.effect == "unknown"
            || m.costs(fitted).is_some()
    };
    let (told, traces): (Vec<_>, Vec<_>) = d.missing.iter().enumerate().partition(matters);
    for (_, m) in told {
        let mark = if m.partial { " ~" } else { "" };
        let or = if m.tied_with.is_some() { "or " } else { "" };
        let size = match m.size() {
            Some(Size::Known(size)) => size,
            Some(Size::Open) => "not determined".into(),
            None => String::new(),
        };
        rows.push([
            format!("{or}{}{mark}", m.effect),
            size,
            share(m.share),
            m.costs(fitted).unwrap_or_else(nothing),
        ]);
    }
    if let Some(r) = d.remainder.as_ref().filter(|_| d.missing.iter().all(|m| m.effect != "unknown")) {
        rows.push(["what is left".into(), String::new(), share(r.share), String::new()]);
    }
    let widest = |k: usize| rows.iter().map(|row| row[k].chars().count()).max().unwrap_or(0);
    let [name, size, shares] = [0, 1, 2].map(widest);
    let before = 2 + name + 2 + size + 2 + shares + 2;
    println!();
    for [what, how_large, of_all, costs] in &rows {
        let head = format!("  {what:<name$}  {how_large:<size$}  {of_all:>shares$}");
        if before + costs.chars().count() <= width() {
            println!("{}", format!("{head}  {costs}").trim_end());
        } else {
            println!("{}\n{}", head.trim_end(), wrapped(costs, 6));
        }
    }
    if !traces.is_empty() {
        let names: Vec<&str> = traces.iter().map(|(_, m)| m.effect.as_str()).collect();
        println!("{}", wrapped(&format!("traces, below 1 % each and without cost: {}", names.join(", ")), 2));
    }
    if d.missing.iter().any(|m| m.partial) {
        println!("  ~ the camera behaves mostly like it, and is not quite that");
    }
}

/// Prints the effects that a law replaces.
fn instead_of_names(law: &Proposal, d: &Diagnosis) {
    let names: Vec<&str> =
        d.missing.iter().map(|m| m.effect.as_str()).filter(|id| *id != "unknown").collect();
    if !names.is_empty() {
        let text = format!(
            "in place of {}, which leave an error of {:.3} (the law: {:.3})",
            names.join(", "),
            d.error_after,
            law.error_after
        );
        println!("\n{}", wrapped(&text, 2));
    }
}

/// Formats a share in short form.
fn share(share: f64) -> String {
    percent(share).replace("more than", ">").replace("less than", "<")
}

/// Prints name, parameters and evidence.
fn explained(m: &Missing) {
    println!("\n{}", wrapped(&format!("{} ({})", m.effect, report::heading(m)), 2));
    for (name, q) in m.parameters.iter().filter(|(_, q)| q.unit != "choice") {
        println!("      {name} = {q}");
    }
    for text in &m.evidence {
        println!("{}", item("    - ", text, 6));
    }
}

/// Prints gain, read noise and dark current with the effects in the model.
fn sensor(place: &Place<'_>, d: &Diagnosis) {
    let said = |q: &Option<Quantity>| {
        q.as_ref().map_or("not determined by this campaign".into(), ToString::to_string)
    };
    let by_law = d.proposal.as_ref().filter(|law| law.holds());
    let with = match by_law {
        Some(law) if law.beside.is_empty() => " with this law in the model",
        Some(_) => " with this law and the effects beside it in the model",
        None if d.missing.is_empty() => "",
        None => " with these effects in the model",
    };
    let biased = match d.missing.first() {
        Some(first) if first.effect == "unknown" && by_law.is_none() => {
            " (what has no name may bias it by more than the errors)"
        }
        _ => "",
    };
    println!("\n  the linear sensor{with}, fitted to all statistics{biased}:");
    println!("      system gain   {}", said(&d.sensor.gain_dn_per_e));
    let pixels = match (d.sensor.read_noise_median_e, d.sensor.noisy_pixel_share) {
        (Some(median), Some(noisy)) => {
            let median = six_digits(round_to(median, 4));
            format!(" (RMS over the pixels; median {median}, {} noisy pixels)", percent(noisy))
        }
        _ => String::new(),
    };
    let read_noise =
        if d.sensor.read_noise_dn.is_some() { &d.sensor.read_noise_dn } else { &d.sensor.read_noise_e };
    println!("{}", item("      read noise    ", &format!("{}{pixels}", said(read_noise)), 20));
    if let (Some(ratio), Some(read)) = (d.sensor.dark_noise_over_read_noise, read_noise) {
        let total = Quantity { value: ratio * read.value, std_err: ratio * read.std_err, ..read.clone() };
        let text = format!("{total} (with the noise that pixels share, as EMVA 1288 counts it)");
        println!("{}", item("      dark noise    ", &text, 20));
    }
    println!("      dark current  {}", said(&d.sensor.dark_current_e_per_s));
    if let Some(r) = d.remainder.as_ref().filter(|_| place.explain) {
        let share = percent(r.share);
        println!("  what is left: {share} of the misfit, error {:.3}, p {}", r.error, chance(r.p_value));
        for text in r.largest.iter().take(3) {
            println!("{}", item("    - ", text, 6));
        }
    }
}

/// Prints the error of the model as given and of each later model.
fn ladder(place: &Place<'_>, d: &Diagnosis) {
    let p = if place.explain { "p" } else { "" };
    println!("{}", format!("\n  {:<34} {:>8}  {p:>9}", "model", "error").trim_end());
    for r in &d.ladder {
        let bar = "#".repeat((r.error.ln().max(0.0) * 6.0).round().min(40.0) as usize);
        let added = r.added.as_ref().map_or("starting model".into(), |added| format!("+ {added}"));
        let chance = if place.explain {
            let rejected = if r.p_value < P_LIMIT { "rejected" } else { "" };
            format!("{:>9}  {rejected:<8}  ", chance(r.p_value))
        } else {
            String::new()
        };
        println!("{}", format!("  {added:<34} {:>8.3}  {chance}{bar}", r.error).trim_end());
    }
    if let Some(law) = &d.proposal {
        let what = if law.beside.is_empty() { "starting model + the law" } else { "+ the law" };
        println!("  {what:<34} {:>8.3}", law.error_after);
    }
    let error = "error: RMS of (measured - predicted) / standard error on frames that the fit did not see; about 1 is agreement";
    println!("{}", wrapped(error, 2));
    if place.explain {
        println!("  p: chance of deviations as large if the model is right; below 0.001 it is rejected");
        println!(
            "  starting model: the linear sensor of Healey and Kondepudy 1994, with the effects of --model;"
        );
        println!("  misfit: its deviations above the noise");
    }
}

/// Prints a law for an unnamed effect.
fn law(place: &Place<'_>, p: &Proposal) {
    println!("\n{}", wrapped("the law, as formulas of a custom effect:", 2));
    for (target, formula) in &p.formulas {
        println!("      {target:<9} + {formula}");
    }
    for (name, q) in &p.parameters {
        println!("      {name:<9} = {q}");
    }
    if !p.beside.is_empty() {
        println!("{}", item("    ", &format!("beside {}", p.beside.join(", ")), 4));
    }
    for cause in p.causes.iter().take(if place.explain { usize::MAX } else { 2 }) {
        println!("{}", item("    points to ", cause, 6));
    }
}

/// Prints commands for the next steps.
fn next_commands(datasets: &str, first: &Missing, has_law: bool) {
    let found = if has_law { "the model with the law" } else { "the model with what was found" };
    let mut lines = vec![
        (format!("radcam diagnose {datasets} --explain"), "what shows it, and all values"),
        (format!("radcam diagnose {datasets} -o camera.toml"), found),
    ];
    if has_law {
        let command = format!("radcam effects new NAME --from {datasets}");
        lines.push((command, "a name of your own, by which it is known from now on"));
    }
    if first.effect != "unknown" {
        lines.push((format!("radcam effects {}", first.effect), "what it is and what looks like it"));
    }
    let widest = lines.iter().map(|(command, _)| command.chars().count()).max().unwrap_or(0);
    println!("\n  next:");
    for (command, what) in &lines {
        if widest + what.len() + 6 <= width() {
            println!("    {command:<widest$}  {what}");
        } else {
            println!("    {command}");
        }
    }
}

/// Rounds to `digits` significant digits.
fn round_to(value: f64, digits: i32) -> f64 {
    if value == 0.0 {
        return 0.0;
    }
    let unit = 10f64.powi(value.abs().log10().floor() as i32 + 1 - digits);
    (value / unit).round() * unit
}
