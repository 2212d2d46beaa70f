//! Users' effects in files: formulas with a name and a page, which join the catalogue.

use super::{Described, Effect, Page, custom, find, register, takes};
use crate::text::echo;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Reserved words, used in the place of an effect's name in a model file, in a verdict, and on the command
/// line.
const NO_NAMES: [&str; 5] = ["custom", "unknown", "law", "new", "help"];

/// Maximum number of characters of a name.
const MAX_NAME_CHARACTERS: usize = 60;

/// User's effect: formulas, as a custom effect of a model file has them, with a name and a page.
///
/// ```
/// use radcam_sim::effects::{OwnEffect, considered};
///
/// let own = OwnEffect::from_toml(
///     r#"
///     name = "jitter-of-the-samples"
///     formulas = { variance = "k * (mu / 1000)^2" }
///     parameters = { k = 8.0 }
///     [page]
///     what = "The instant at which a sample is taken jitters."
///     "#,
/// )?;
/// own.register()?;
/// assert!(considered().iter().any(|e| e.id() == "jitter-of-the-samples"));
/// # Ok::<(), String>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OwnEffect {
    /// Identifier: small letters, digits and hyphens.
    pub name: String,
    /// Formula for each target.
    pub formulas: BTreeMap<String, String>,
    /// Parameters, with the values at which a search begins.
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
    /// Lowest and highest value of a parameter.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub bounds: BTreeMap<String, [f64; 2]>,
    /// Units of parameters.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub units: BTreeMap<String, String>,
    /// Page of the effect.
    #[serde(default)]
    pub page: OwnPage,
}

/// Page of a user's effect; empty fields are reported as unknown.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OwnPage {
    /// Cause, in a sentence or two.
    pub what: String,
    /// Statistic that moves, and how.
    pub signature: String,
    /// Differences from effects that look similar.
    pub look_alikes: String,
    /// Remedies, the first one first, separated by semicolons.
    pub remedy: String,
    /// Measurement that separates it from its look-alikes.
    pub measure: String,
    /// Reference.
    pub source: String,
}

impl OwnEffect {
    /// Reads an effect file.
    ///
    /// # Errors
    ///
    /// A line, name, formula or bound cannot be understood; the message names it.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        let own: Self = toml::from_str(text)
            .map_err(|e| crate::text::echo_message(&e.to_string()).trim_end().to_string())?;
        own.check()?;
        Ok(own)
    }

    /// Writes the effect as a file.
    ///
    /// # Errors
    ///
    /// A number does not exist in TOML.
    pub fn to_toml(&self) -> Result<String, String> {
        toml::to_string(self).map_err(|e| e.to_string())
    }

    /// Checks name, formulas, values and bounds; stores nothing.
    ///
    /// # Errors
    ///
    /// One of them cannot be understood; the message names it.
    pub fn check(&self) -> Result<(), String> {
        self.check_name()?;
        let described = self.described();
        described.check()?;
        let known = |name: &&String| self.parameters.contains_key(*name);
        if let Some(name) = self.bounds.keys().chain(self.units.keys()).find(|name| !known(name)) {
            return Err(format!("bounds or units of {}, which is no parameter", echo(name)));
        }
        for (name, value) in &self.parameters {
            let [min, max] = described.bounds_of(name);
            if !(min..=max).contains(value) {
                return Err(format!("parameter {} = {value} is not within {min} to {max}", echo(name)));
            }
        }
        Ok(())
    }

    /// Checks the name alone.
    ///
    /// # Errors
    ///
    /// The name is reserved, has other characters, or too many.
    pub fn check_name(&self) -> Result<(), String> {
        let is_of_name = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        if NO_NAMES.contains(&&*self.name) {
            return Err(format!(
                "name = \"{}\": this word has a meaning of its own; choose another name",
                self.name
            ));
        }
        let fits = (1..=MAX_NAME_CHARACTERS).contains(&self.name.chars().count());
        if !fits || !self.name.chars().all(is_of_name) || self.name.starts_with('-') {
            return Err(format!(
                "name = \"{}\": a name has up to {MAX_NAME_CHARACTERS} small letters, digits and hyphens",
                echo(&self.name)
            ));
        }
        Ok(())
    }

    /// Creates the effect. It is kept until the program ends.
    ///
    /// # Errors
    ///
    /// As [`check`](Self::check).
    pub fn effect(&self) -> Result<&'static dyn Effect, String> {
        self.check()?;
        custom(self.described())
    }

    /// Registers the effect for the lifetime of the program, as [`register`] does.
    ///
    /// # Errors
    ///
    /// As [`check`](Self::check), or another effect has its name.
    pub fn register(&self) -> Result<(), String> {
        let effect = self.effect()?;
        // An effect may lie in two folders, fitted with two strengths; the first is kept.
        let formulas = |known: &'static dyn Effect| known.written().map(|w| w.formulas);
        if find(&self.name).and_then(formulas).is_some_and(|known| known == self.formulas) {
            return Ok(());
        }
        register(effect)
    }

    fn described(&self) -> Described<'_> {
        Described {
            name: &self.name,
            formulas: &self.formulas,
            values: &self.parameters,
            bounds: &self.bounds,
            units: &self.units,
            page: Some(&self.page),
        }
    }
}

/// Builds the page of an effect of formulas.
pub(super) fn page_of(described: &Described<'_>) -> Page {
    let keep = |text: &str| -> &'static str { Box::leak(text.to_string().into_boxed_str()) };
    let or = |text: Option<&String>, otherwise: &'static str| match text.filter(|t| !t.trim().is_empty()) {
        Some(text) => keep(text.trim()),
        None => otherwise,
    };
    let of = described.page;
    let equation: Vec<String> = described.formulas.iter().map(|(t, f)| format!("{t} + {f}")).collect();
    Page {
        what: or(of.map(|p| &p.what), "An effect of the user's own, written as formulas."),
        equation: keep(&equation.join("; ")),
        signature: or(of.map(|p| &p.signature), "the statistics that its formulas change"),
        look_alikes: or(of.map(|p| &p.look_alikes), ""),
        remedy: or(of.map(|p| &p.remedy), ""),
        measure: or(of.map(|p| &p.measure), "the statistic that its formula changes, at more levels"),
        sets: takes::PAIRS,
        source: or(of.map(|p| &p.source), "the user"),
    }
}
