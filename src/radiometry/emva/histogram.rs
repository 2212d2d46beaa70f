//! Histograms of nonuniformities, plain and accumulated (release 4.0 Linear, section 8.8).

use super::Definitions;

/// Histogram: centres of the bins, and number of pixels in each.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Histogram {
    /// Centre of each bin; lower edge with the reference tool.
    pub bins: Vec<f64>,
    pub counts: Vec<f64>,
    /// Width of a bin.
    pub width: f64,
}

/// Maximum number of bins.
const BINS: i64 = 256;

/// Computes the histogram of integers that are `scale` times the values; bins are whole steps wide (eq. 73 to
/// 75).
pub(super) fn histogram(values: &[i64], scale: f64, definitions: Definitions) -> Histogram {
    let (Some(&min), Some(&max)) = (values.iter().min(), values.iter().max()) else {
        return Histogram { bins: Vec::new(), counts: Vec::new(), width: 1.0 / scale };
    };
    let range = max - min;
    let as_tool = definitions == Definitions::ReferenceTool;
    let width = range / BINS + 1;
    let n = (range / width + 1) as usize;
    let mut counts = vec![0.0; n];
    for v in values {
        counts[((v - min) / width) as usize] += 1.0;
    }
    // numpy's last bin includes its upper edge; no value lies there.
    let middle = if as_tool { 0.0 } else { 0.5 * (width as f64 - 1.0) };
    let bins = (0..n).map(|q| ((min + q as i64 * width) as f64 + middle) / scale).collect();
    Histogram { bins, counts, width: width as f64 / scale }
}

/// Computes the share of the pixels, per cent, that deviate from the mean by so much or more (eq. 77 to 81).
pub(super) fn accumulated(values: &[i64], scale: f64, definitions: Definitions) -> Histogram {
    let n = values.len() as f64;
    let mean = values.iter().sum::<i64>() as f64 / n;
    // Rounded to the whole step; the tool truncates.
    let mean = if definitions == Definitions::ReferenceTool { mean.trunc() } else { mean.round() } as i64;
    let deviations: Vec<i64> = values.iter().map(|v| (v - mean).abs()).collect();
    let mut h = histogram(&deviations, scale, definitions);
    let mut above = 0.0;
    for count in h.counts.iter_mut().rev() {
        above += *count;
        *count = 100.0 * above / n;
    }
    h
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pixel_is_counted_once() {
        let values: Vec<i64> = (0..10_000).map(|i| (i * i) % 5003).collect();
        for definitions in [Definitions::Release4, Definitions::ReferenceTool] {
            let h = histogram(&values, 10.0, definitions);
            assert!(h.bins.len() <= 256 && h.counts.iter().sum::<f64>() == 10_000.0);
            let a = accumulated(&values, 10.0, definitions);
            assert_eq!(a.counts[0], 100.0);
            assert!(a.counts.windows(2).all(|w| w[0] >= w[1]));
        }
        let h = histogram(&[3, 4, 4, 7], 2.0, Definitions::Release4);
        assert_eq!((h.bins, h.counts), (vec![1.5, 2.0, 2.5, 3.0, 3.5], vec![1.0, 2.0, 0.0, 0.0, 1.0]));
        assert!(histogram(&[], 1.0, Definitions::Release4).bins.is_empty());
    }
}
