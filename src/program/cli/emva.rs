//! `radcam emva`

use super::Outcome;
use super::common::{STOP, after_faults, item, say_faults};
use super::observe::Colour;
use super::progress::Show;
use crate::data_faults::examined;
use crate::dataset::{Dataset, write_whole};
use crate::emva::{Definitions, Evaluation, Limit, Points, evaluate, names, of_dataset, plots};
use crate::number::Quantity;
use crate::report;
use anyhow::Result;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A dataset folder or the descriptor of an EMVA 1288 test: a pair of flats and a pair of darks at each
    /// exposure, and a stack of each
    dataset: PathBuf,
    #[command(flatten)]
    colour: Colour,
    /// Folder for the datasheet (HTML, prints to A4), all numbers (JSON, CSV) and those of each plot (CSV)
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Release of the standard
    #[arg(long, default_value = "4.0", value_parser = ["4.0", "3.1"], conflicts_with = "definitions_of")]
    release: String,
    /// Definitions of the reference tool, PyPI emva1288 1.0.2, in place of the standard's text
    #[arg(long = "as", value_name = "reference-tool", value_parser = ["reference-tool"])]
    definitions_of: Option<String>,
    /// Area of a pixel, um^2, where the dataset does not say it
    #[arg(long, value_name = "UM2", value_parser = super::common::above_0)]
    pixel_area: Option<f64>,
    /// Relative standard error of the light's calibration, where the dataset does not say it (0.03: 3 %)
    #[arg(long, value_name = "SHARE", value_parser = super::common::above_0)]
    irradiance_std: Option<f64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let dataset = arguments.colour.open(&arguments.dataset)?;
    dataset.must_be_monochrome()?;
    let dataset = examined(&dataset, &STOP)?;
    let show = Mutex::new(Show::new("reading"));
    let progress = |done, of| {
        if let Ok(mut show) = show.lock() {
            show.step(done, of);
        }
    };
    let mut points = after_faults(of_dataset(&dataset, &STOP, &progress), dataset.data_faults())?;
    drop(show);
    points.light.pixel_area_um2 = arguments.pixel_area.or(points.light.pixel_area_um2);
    points.light.irradiance_rel_std = arguments.irradiance_std.or(points.light.irradiance_rel_std);
    let definitions = match (&arguments.definitions_of, &*arguments.release) {
        (Some(_), _) => Definitions::ReferenceTool,
        (None, "3.1") => Definitions::Release31,
        _ => Definitions::Release4,
    };
    let evaluation = after_faults(evaluate(&points, definitions), dataset.data_faults())?;
    if let Some(folder) = &arguments.output {
        write(folder, arguments, &dataset, &points, &evaluation)?;
    }
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&evaluation)?);
    } else {
        print(arguments, &evaluation);
    }
    Ok(Outcome::Agreement)
}

/// Writes the folder: `datasheet.html`, `emva.json`, `quantities.csv` and `plots/NAME.csv`.
fn write(
    folder: &Path,
    arguments: &Arguments,
    dataset: &Dataset,
    points: &Points,
    evaluation: &Evaluation,
) -> Result<()> {
    let tables = folder.join("plots");
    super::common::folders_below(folder, "plots".as_ref())?;
    let plots = plots(points, evaluation);
    let command: Vec<String> = std::env::args().collect();
    let head = report::emva::Head {
        camera: &dataset.manifest().camera,
        source: arguments.dataset.display().to_string(),
        command: command.join(" "),
    };
    for plot in &plots {
        write_whole(&tables.join(format!("{}.csv", plot.id)), plot.csv().as_bytes())?;
    }
    write_whole(&folder.join("emva.json"), serde_json::to_string_pretty(evaluation)?.as_bytes())?;
    write_whole(&folder.join("quantities.csv"), table(evaluation)?.as_bytes())?;
    let page = report::emva::html(&head, points, evaluation, &plots);
    write_whole(&folder.join("datasheet.html"), page.as_bytes())?;
    Ok(())
}

/// Formats the quantities as `name,value,std_err,unit,limit`, empty where undefined.
fn table(evaluation: &Evaluation) -> Result<String> {
    let mut out = csv::Writer::from_writer(Vec::new());
    out.write_record(["name", "value", "std_err", "unit", "limit"])?;
    for (name, quantity) in &evaluation.quantities {
        let number =
            |of: fn(&Quantity) -> f64| quantity.as_ref().map(|q| of(q).to_string()).unwrap_or_default();
        let unit = quantity.as_ref().map(|q| q.unit.to_string()).unwrap_or_default();
        let limit = evaluation.limits.get(name).map_or("", |l| words(*l));
        out.write_record([name, &number(|q| q.value), &number(|q| q.std_err), &unit, limit])?;
    }
    Ok(String::from_utf8(out.into_inner()?)?)
}

fn words(limit: Limit) -> &'static str {
    match limit {
        Limit::AtMost => "at most",
        Limit::AtLeast => "at least",
    }
}

fn print(arguments: &Arguments, e: &Evaluation) {
    println!("{}: EMVA 1288, {}", arguments.dataset.display(), e.definitions);
    say_faults(&e.data_faults);
    for (heading, group) in names::GROUPS {
        let there: Vec<_> = group.iter().filter(|(name, ..)| e.quantities.contains_key(*name)).collect();
        if there.is_empty() {
            continue;
        }
        println!("\n{heading}");
        for (name, _, meaning) in there {
            let quantity = e.quantities[*name].as_ref();
            let limit = e.limits.get(*name).map(|l| format!("{} ", words(*l))).unwrap_or_default();
            let value = quantity.map_or("undefined".into(), |q| format!("{limit}{q}"));
            let tool = match e.reference_tool.get(*name) {
                Some(Some(tool)) => format!(" [reference tool: {tool:.5}]"),
                Some(None) => " [reference tool: none]".into(),
                None => String::new(),
            };
            println!("  {name:<20} {value:<26} {meaning}{tool}");
        }
    }
    if let Some(n) = &e.noise {
        println!("\nAll frames by `radcam noise`");
        println!("  {:<20} {:<26} which the standard calls K", "system gain A", n.gain.to_string());
        println!("  {:<20} {}", "read noise", n.read_noise);
        println!(
            "  {:<20} chi-square {:.1} for {} degrees of freedom, Q = {:.4}: {}",
            "line",
            n.chi2,
            n.dof,
            n.q,
            n.line.of_a_line()
        );
    }
    if let Some(general) = &e.general {
        println!("\nGeneral model (release 4.0 General: no electrons, everything in photons)");
        for (name, quantity) in &general.quantities {
            println!("  {name:<20} {}", quantity.as_ref().map_or("undefined".into(), ToString::to_string));
        }
    }
    for note in &e.notes {
        println!("{}", item("\nnote: ", note, 6));
    }
    if let Some(folder) = &arguments.output {
        println!("\n{} written", folder.join("datasheet.html").display());
    }
}
