//! Shapes of the frames of a campaign, common to all statistics: the field of the light, frequencies of rows
//! and columns, and the peaks of their spectra.

use super::line_peak::{self, Axis};
use super::read::Chunk;
use super::{Field, STATISTICS, Statistic, column_spectrum, row_spectrum};
use crate::dataset::{FrameRow, Kind};

/// Returns the field shown by the brightest flats.
pub(super) fn field(chunks: &[Chunk], settings: &[FrameRow], zero_dn: f64) -> Field {
    let flats = chunks.iter().filter(|c| settings[c.set].kind == Kind::Flat);
    let level = |c: &&Chunk| c.summary.frame_means.mean_dn();
    flats
        .max_by(|a, b| level(a).total_cmp(&level(b)))
        .map_or_else(Field::default, |c| Field::of(&c.summary, zero_dn))
}

/// Returns the frequencies at which the row means of flats ripple, in proportion to the signal.
pub(super) fn row_cycles(chunks: &[Chunk], settings: &[FrameRow], zero_dn: f64) -> Vec<f64> {
    let is_lit =
        |c: &&Chunk| settings[c.set].kind == Kind::Flat && c.summary.frame_means.mean_dn() - zero_dn > 0.0;
    let rows = chunks.first().map_or(0, |c| c.summary.rows_dn.len());
    cycles(chunks.iter().filter(is_lit), &row_spectrum::RowSpectrum, rows)
}

/// Returns the frequencies of stripes of columns that move from frame to frame, cycles per column.
pub(super) fn column_cycles(chunks: &[Chunk]) -> Vec<f64> {
    let columns = chunks.first().map_or(0, |c| c.summary.columns_dn.len());
    cycles(chunks.iter(), &column_spectrum::ColumnSpectrum, columns)
}

/// Returns the index of a statistic among all.
fn place(of: &dyn Statistic) -> Option<usize> {
    STATISTICS.iter().position(|s| s.id() == of.id())
}

/// Returns the strongest peaks of the spectra of row means and of column means.
pub(super) fn peaks(chunks: &[Chunk], settings: &[FrameRow], zero_dn: f64) -> [Option<line_peak::Peak>; 2] {
    let spectra: [(Axis, &dyn Statistic); 2] =
        [(Axis::Rows, &row_spectrum::RowSpectrum), (Axis::Columns, &column_spectrum::ColumnSpectrum)];
    spectra.map(|(axis, of)| line_peak::find(chunks, settings, zero_dn, axis, place(of)?))
}

/// Returns the frequencies to start from, the strongest peak of all frames first.
pub(super) fn with_peak(cycles: Vec<f64>, peak: &Option<line_peak::Peak>) -> Vec<f64> {
    let first = peak.as_ref().map(|p| p.cycles);
    let another = cycles.into_iter().filter(|c| first.is_none_or(|f| (c - f).abs() > 0.1 * f));
    first.into_iter().chain(another).collect()
}

/// Returns the peaks of a spectrum of this number of line means, summed over chunks, cycles per line.
fn cycles<'c>(chunks: impl Iterator<Item = &'c Chunk>, of: &dyn Statistic, lines: usize) -> Vec<f64> {
    let place = place(of);
    let mut power: Vec<f64> = Vec::new();
    for c in chunks {
        let Some(own) = place.and_then(|i| c.summary.extra.get(i)) else { continue };
        // Power over the noise of a line weights dim and bright sets by their information.
        let noise = c.summary.var.value.max(1e-12);
        power.resize(own.len(), 0.0);
        power.iter_mut().zip(own).for_each(|(sum, v)| *sum += v / noise);
    }
    if power.len() < 8 { Vec::new() } else { row_spectrum::peaks(&power, lines) }
}
