//! Section IV on a table of statistics.

use super::levels::{Zero, table_points};
use super::{NoiseError, NoiseReport, estimate};
use crate::agreement::Agreement;
use crate::dataset::table::Table;
use crate::number::Quantity;

/// Source of the zero of tables whose means count from the black level.
pub(super) const TABLE_ZERO: &str = "table: black level removed";
/// Source of the zero of tables whose means contain the black level.
pub(super) const TABLE_WITH_BLACK_LEVEL: &str = "table: where the variances meet zero";

/// Evaluates Section IV on a table of statistics.
///
/// # Errors
///
/// If no line can be fitted, with the reason.
pub fn of_table(table: &Table) -> Result<NoiseReport, NoiseError> {
    let report = estimate(
        table_points(table),
        &Zero { dn: 0.0, std_err_dn: f64::NAN, source: TABLE_ZERO, moved_dn: 0.0 },
    );
    let Some(black_dn) = black_level_of(table) else { return report };
    let zero = Zero {
        dn: black_dn.value,
        std_err_dn: black_dn.std_err,
        source: TABLE_WITH_BLACK_LEVEL,
        moved_dn: 0.0,
    };
    let mut points = table_points(table);
    points.iter_mut().for_each(|p| {
        p.mean_dn -= black_dn.value;
        p.pairs.iter_mut().for_each(|pair| pair.0 -= black_dn.value);
    });
    let mut report = estimate(points, &zero)?;
    report.notes.push(black_level_in_words(&black_dn));
    Ok(report)
}

/// Estimates the black level that the means of a table contain, DN: the line of the variances (Healey and
/// Kondepudy 1994, eq. 41) meets zero there, and no variance is below zero. `None` if the line leaves a
/// constant noise, or the levels are not on a line.
pub(crate) fn black_level_of(table: &Table) -> Option<Quantity> {
    let zero = Zero { dn: 0.0, std_err_dn: f64::NAN, source: TABLE_ZERO, moved_dn: 0.0 };
    let report = estimate(table_points(table), &zero).ok()?;
    let (gain, constant) = (&report.gain_dn_per_e, &report.constant_noise_var_dn2);
    let is_line = report.line() != Agreement::Fails && gain.value > 0.0;
    let dn = -constant.value / gain.value;
    (is_line && report.constant_noise_is_negative())
        .then(|| Quantity::new(dn, constant.std_err / gain.value, "DN"))
}

/// Formats the black level of a table.
pub(crate) fn black_level_in_words(black_dn: &Quantity) -> String {
    format!(
        "the variances meet zero at a mean of {black_dn}: that much black level is in the means, and is taken off. The read noise is in it \
         too, and is not told: rows without light tell both"
    )
}
