//! Field shapes that are drawn anew for every frame: a gradient (tilt) and a curvature (bend).

/// Shapes along an axis: half a turn of a cosine over all lines (a gradient), and one turn (a curvature).
pub const SHAPES: usize = 2;

/// Variance of the gradient and of the curvature of frames, DN^2: the mean over the pixels of what each adds
/// to the noise of a pixel. Both are cosines of the discrete cosine transform (Ahmed, Natarajan and Rao 1974,
/// IEEE Trans. Comput. C-23, 90), of mean 0.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fields {
    /// Down the rows.
    pub down: [f64; SHAPES],
    /// Across the columns.
    pub across: [f64; SHAPES],
}

impl Fields {
    /// Multiplies every variance.
    pub fn scale(&mut self, square: f64) {
        self.down.iter_mut().chain(&mut self.across).for_each(|v| *v *= square);
    }

    /// Returns the sum of all variances, DN^2.
    pub fn variance(&self) -> f64 {
        self.of_rows() + self.of_columns()
    }

    /// Returns the sum of their squares, DN^4: the mean over pairs of pixels of the square of their
    /// covariance.
    pub fn squares(&self) -> f64 {
        self.down.iter().chain(&self.across).map(|v| v * v).sum()
    }

    /// Returns the part of the variance that the means of rows have, DN^2.
    pub fn of_rows(&self) -> f64 {
        self.down.iter().sum()
    }

    /// Returns the part of the variance that the means of columns have, DN^2.
    pub fn of_columns(&self) -> f64 {
        self.across.iter().sum()
    }

    /// Returns the covariance of the means of rows `apart` rows apart, DN^2: the mean over all such pairs of
    /// `rows` rows.
    pub fn rows_apart(&self, apart: usize, rows: usize) -> f64 {
        apart_by(&self.down, apart, rows)
    }

    /// Returns the covariance of the means of columns `apart` columns apart, DN^2: the mean over all such
    /// pairs.
    pub fn columns_apart(&self, apart: usize, columns: usize) -> f64 {
        apart_by(&self.across, apart, columns)
    }

    /// Returns the variance of the difference between the halves of a frame, DN^2: the second half of its
    /// rows less the first, or of its columns. A curvature is the same in both.
    pub fn halves(&self, is_of_rows: bool, lines: usize) -> f64 {
        let [gradient, _] = if is_of_rows { self.down } else { self.across };
        // The mean of root 2 cos(a (y + 1/2)) over half of the lines is root 2 / (n sin(a / 2)), a = pi / n.
        let n = lines.max(2) as f64;
        gradient * 8.0 / (n * libm::sin(0.5 * std::f64::consts::PI / n)).powi(2)
    }
}

fn apart_by(variances: &[f64; SHAPES], apart: usize, lines: usize) -> f64 {
    if apart >= lines {
        return 0.0;
    }
    let (n, d) = (lines as f64, apart as f64);
    // Products of cosines d lines apart sum to (n - d) cos(d a) - sin(d a) / sin a, a = pi halves / n.
    let of = |halves: usize| {
        let a = std::f64::consts::PI * halves as f64 / n;
        libm::cos(d * a) - libm::sin(d * a) / libm::sin(a) / (n - d)
    };
    variances.iter().enumerate().filter(|(_, v)| **v != 0.0).map(|(k, v)| v * of(k + 1)).sum()
}

/// Returns the cosine of `halves` half turns over all lines, at one of them; of mean square 1.
pub fn cosine(halves: u32, line: usize, lines: usize) -> f64 {
    let turn = std::f64::consts::PI * f64::from(halves) / lines as f64;
    std::f64::consts::SQRT_2 * libm::cos(turn * (line as f64 + 0.5))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Covariances, halves and powers equal those of the shapes themselves.
    #[test]
    fn formulas_are_those_of_the_shapes() {
        let lines = 48;
        for shape in 0..SHAPES {
            let mut fields = Fields::default();
            fields.down[shape] = 1.0;
            let halves = shape as u32 + 1;
            let at: Vec<f64> = (0..lines).map(|y| cosine(halves, y, lines)).collect();
            for cycles in [0.0, 0.01, 0.013, 0.2] {
                let turn = std::f64::consts::TAU * cycles;
                let sum = |of: fn(f64) -> f64| {
                    at.iter().enumerate().map(|(y, v)| v * of(turn * y as f64)).sum::<f64>() / lines as f64
                };
                let power = sum(f64::cos).powi(2) + sum(f64::sin).powi(2);
                let known = crate::spectrum::cosine_power(halves, lines as f64, turn);
                assert!((known - power).abs() < 1e-12, "{shape} {cycles}");
            }
            for apart in [0, 1, 3, 16] {
                let pairs = (0..lines - apart).map(|y| at[y] * at[y + apart]).sum::<f64>();
                let mean = pairs / (lines - apart) as f64;
                assert!((fields.rows_apart(apart, lines) - mean).abs() < 1e-9, "{shape} {apart}");
            }
            let half = |from: usize| at[from..from + lines / 2].iter().sum::<f64>() / (lines / 2) as f64;
            let halves = (half(lines / 2) - half(0)).powi(2);
            assert!((fields.halves(true, lines) - halves).abs() < 1e-9, "{shape}");
            assert!(fields.halves(false, lines) == 0.0 && fields.of_columns() == 0.0);
        }
    }
}
