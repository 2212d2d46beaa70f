//! `radcam noise`

use super::common::{STOP, after_faults, can_be_written, say_faults};
use super::observe::{Colour, Datasets};
use super::{Outcome, progress::Show};
use crate::dataset::write_whole;
use crate::noise::NoiseReport;
use crate::number::{with_error, with_unit};
use crate::report;
use anyhow::Result;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A dataset folder, an EMVA 1288 descriptor, or a table (CSV with mean_dn and var_dn2)
    dataset: PathBuf,
    #[command(flatten)]
    colour: Colour,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Also write a page with the photon-transfer plot
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    can_be_written(&arguments.report)?;
    let datasets = Datasets { paths: vec![arguments.dataset.clone()], colour: arguments.colour.clone() };
    let report = estimate(&datasets)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print(&datasets.names(), &report);
    }
    if let Some(path) = &arguments.report {
        let subtitle = datasets.names();
        let page = report::noise::html("Gain and constant noise", &subtitle, &report, None);
        write_whole(path, page.as_bytes())?;
    }
    Ok(if report.consistent() { Outcome::Agreement } else { Outcome::Disagreement })
}

/// Estimates the noise by Section IV from any source.
pub fn estimate(datasets: &Datasets) -> Result<NoiseReport> {
    let mut show = Show::new("noise");
    let source = datasets.open()?.examined(&STOP)?;
    after_faults(source.noise_with(&STOP, &mut |done, of| show.step(done, of)), source.data_faults())
}

fn print(title: &str, r: &NoiseReport) {
    let used = r.levels.iter().filter(|l| l.used).count();
    println!("{title}: {used} of {} levels used\n", r.levels.len());
    say_faults(&r.data_faults);
    println!("  photon transfer, from mean and variance alone (`radcam diagnose` fits all statistics):");
    for (name, q) in [
        ("system gain A", &r.gain_dn_per_e),
        ("constant noise", &r.constant_noise_var_dn2),
        ("read noise", &r.read_noise_e),
    ] {
        println!("  {name:<16} {}", q);
    }
    if let Some(shared) = &r.shared_noise_rel {
        let size = with_unit(100.0 * shared.value, 100.0 * shared.std_err, "%");
        let of_pixels = shared.value.abs() < 1.0;
        let what = if of_pixels { "A is off by as much, see the first note" } else { "see the first note" };
        println!("  {:<16} {size} of the variance: {what}", "shared noise");
    }
    println!(
        "  {:<16} {} DN ({})",
        "zero level",
        with_error(r.offset_dn.value, r.offset_dn.std_err),
        r.offset_source
    );
    if r.dof == 0 {
        println!("  {:<16} none: two levels fit any line", "chi-square");
    } else {
        let verdict = r.line().of_a_line();
        println!(
            "  {:<16} {:.2} for {} degrees of freedom, Q = {:.4}: {verdict}",
            "chi-square", r.chi2, r.dof, r.q
        );
    }

    println!("\n  {:<12} {:<24} {:<24} {:>9} {:>4}  Q", "estimator", "A (DN/e⁻)", "σ_C² (DN²)", "χ²", "dof");
    for e in &r.estimators {
        let (a, c) = (&e.gain_dn_per_e, &e.constant_noise_var_dn2);
        println!(
            "  {:<12} {:<24} {:<24} {:>9.2} {:>4}  {:.4}",
            e.method.name(),
            with_error(a.value, a.std_err),
            with_error(c.value, c.std_err),
            e.chi2,
            e.dof,
            e.q
        );
    }
    println!("\n  {:>4} {:<5} {:>10}  {:<22} {:>7}", "set", "kind", "mean (DN)", "variance (DN²)", "z");
    for l in &r.levels {
        let kind = l.kind.to_string();
        let variance = with_error(l.var_dn2, l.var_std_err_dn2);
        let note = l.excluded_because.as_ref().map(|why| format!("  not used: {why}")).unwrap_or_default();
        println!("  {:>4} {kind:<5} {:>10.2}  {variance:<22} {:>+7.2}{note}", l.set, l.mean_dn, l.z);
    }
    for note in &r.notes {
        println!("{}", super::common::item("\n  note: ", note, 4));
    }
}
