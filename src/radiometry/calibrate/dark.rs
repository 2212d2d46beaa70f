//! Dark reference (Section V.A, eq. 43): level of each pixel without light, at any exposure.

use ndarray::{Array2, Zip};

/// Mean of dark frames of one exposure.
#[derive(Debug, Clone)]
pub struct DarkMean {
    /// Exposure, s.
    pub exposure_s: f64,
    /// Frames averaged, s of the paper.
    pub frames: u64,
    /// Mean of each pixel, (rows, columns), DN.
    pub mean_dn: Array2<f64>,
    /// Temporal variance of each pixel, (rows, columns), DN^2.
    pub var_dn2: Array2<f64>,
}

/// Dark level of each pixel as a line in the exposure: offset plus dark current.
#[derive(Debug, Clone)]
pub struct DarkReference {
    /// Exposure at which `level_dn` holds, s.
    pub exposure_s: f64,
    /// D_D at that exposure, (rows, columns), DN, black level included.
    pub level_dn: Array2<f32>,
    /// Dark current of each pixel, (rows, columns), DN per second; `None` if the darks have one exposure.
    pub current_dn_per_s: Option<Array2<f32>>,
    /// Standard error of `level_dn`, pooled over pixels, DN.
    pub std_err_dn: f64,
    /// Standard error of `current_dn_per_s`, pooled over pixels, DN per second; NaN if unknown.
    pub current_std_err_dn_per_s: f64,
    /// Temporal variance at the exposure nearest to `exposure_s`, pooled over pixels, DN^2.
    pub var_dn2: f64,
}

/// Error: no dark reference.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DarkError {
    /// No dark frames.
    #[error("a dark reference needs dark frames, and there are none")]
    None,
    /// Images of different sizes.
    #[error("dark frames of {0:?} and {1:?} px (rows, columns) cannot be put together")]
    Size((usize, usize), (usize, usize)),
    /// No dark at this exposure, and no dark-current fit to interpolate from.
    #[error(
        "the dark reference holds at {measured_s} s, and {wanted_s} s is asked for; take darks at two or more \
         exposures, or at this one"
    )]
    Exposure {
        /// Measured exposure, s.
        measured_s: f64,
        /// Requested exposure, s.
        wanted_s: f64,
    },
}

impl DarkReference {
    /// Fits offset and dark current of every pixel to means at one or more exposures, for use at
    /// `exposure_s`.
    ///
    /// Exposures have the same weights for all pixels: frames over the pooled temporal variance.
    ///
    /// # Errors
    ///
    /// If there are no darks at this exposure, nor at enough others.
    pub fn fit(darks: &[DarkMean], exposure_s: f64) -> Result<Self, DarkError> {
        let first = darks.first().ok_or(DarkError::None)?;
        let shape = first.mean_dn.dim();
        if let Some(other) = darks.iter().find(|d| d.mean_dn.dim() != shape) {
            return Err(DarkError::Size(shape, other.mean_dn.dim()));
        }
        let pooled = |d: &DarkMean| d.var_dn2.mean().unwrap_or(0.0).max(1.0 / 12.0);
        let weights: Vec<f64> = darks.iter().map(|d| d.frames as f64 / pooled(d)).collect();
        let sum: f64 = weights.iter().sum();
        let middle_s = darks.iter().zip(&weights).map(|(d, w)| w * d.exposure_s).sum::<f64>() / sum;
        let spread: f64 =
            darks.iter().zip(&weights).map(|(d, w)| w * (d.exposure_s - middle_s).powi(2)).sum();
        let nearest = darks
            .iter()
            .min_by(|a, b| (a.exposure_s - exposure_s).abs().total_cmp(&(b.exposure_s - exposure_s).abs()))
            .unwrap_or(first);
        let var_dn2 = pooled(nearest);

        let mut mean = Array2::<f64>::zeros(shape);
        for (d, w) in darks.iter().zip(&weights) {
            mean.scaled_add(w / sum, &d.mean_dn);
        }
        if spread <= 1e-12 * sum * middle_s * middle_s {
            // One exposure: the reference is valid only there.
            return Ok(Self {
                exposure_s: first.exposure_s,
                level_dn: mean.mapv(|m| m as f32),
                current_dn_per_s: None,
                std_err_dn: sum.sqrt().recip(),
                current_std_err_dn_per_s: f64::NAN,
                var_dn2,
            });
        }
        let mut current = Array2::<f64>::zeros(shape);
        for (d, w) in darks.iter().zip(&weights) {
            current.scaled_add(w * (d.exposure_s - middle_s) / spread, &d.mean_dn);
        }
        let reach = exposure_s - middle_s;
        let level_dn = Zip::from(&mean).and(&current).map_collect(|&m, &c| (m + c * reach) as f32);
        Ok(Self {
            exposure_s,
            level_dn,
            current_dn_per_s: Some(current.mapv(|c| c as f32)),
            std_err_dn: (1.0 / sum + reach * reach / spread).sqrt(),
            current_std_err_dn_per_s: spread.sqrt().recip(),
            var_dn2,
        })
    }

    /// Standard error of D_D at an exposure, DN: an upper bound, since level and current are not independent.
    /// An unknown error of the current is taken as that of a level at `exposure_s`, over `exposure_s`.
    pub fn std_err_at(&self, exposure_s: f64) -> f64 {
        let level = if self.std_err_dn.is_finite() { self.std_err_dn } else { 0.0 };
        let known = Some(self.current_std_err_dn_per_s).filter(|e| e.is_finite());
        let current = known.unwrap_or_else(|| level / self.exposure_s.max(f64::MIN_POSITIVE));
        level + current * (exposure_s - self.exposure_s).abs()
    }

    /// D_D at an exposure, (rows, columns), DN.
    ///
    /// # Errors
    ///
    /// If the dark reference does not extend to this exposure.
    pub fn at(&self, exposure_s: f64) -> Result<Array2<f32>, DarkError> {
        let reach = exposure_s - self.exposure_s;
        match &self.current_dn_per_s {
            _ if reach.abs() <= 1e-6 * self.exposure_s => Ok(self.level_dn.clone()),
            Some(current) => {
                Ok(Zip::from(&self.level_dn).and(current).map_collect(|&l, &c| l + c * reach as f32))
            }
            None => {
                // To a nanosecond: smaller differences are arithmetic.
                let tidy = |s: f64| (s * 1e9).round() / 1e9;
                Err(DarkError::Exposure { measured_s: tidy(self.exposure_s), wanted_s: tidy(exposure_s) })
            }
        }
    }
}

/// Computes the number s of dark frames for a reference with an error of at most `error_dn`, with noise of
/// variance `var_dn2`: the variance of the mean is sigma_N^2 / s (after eq. 43).
///
/// ```
/// // Half a step's third, in the paper's camera: 1.156 DN^2 in the dark.
/// assert_eq!(radcam::calibrate::dark::frames_needed(1.156, 1.0 / 3.0), 11);
/// ```
pub fn frames_needed(var_dn2: f64, error_dn: f64) -> u64 {
    (var_dn2 / (error_dn * error_dn)).ceil().max(1.0) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::{Conditions, Sensor, sensors};

    fn dark(sensor: &Sensor, exposure_s: f64, frames: u64, first: u64) -> DarkMean {
        let region = sensor.region();
        let shape = (region.height as usize, region.width as usize);
        let mut moments = crate::statistics::moments::Moments::new(shape, sensor.model().camera.bit_depth);
        let c = Conditions { illumination: 0.0, ..sensor.conditions(exposure_s) };
        for f in 0..frames {
            let mut dn = vec![0; shape.0 * shape.1];
            sensor.draw(first + f, &c, region, &mut dn);
            moments.add(&[&dn]).unwrap();
        }
        DarkMean { exposure_s, frames, mean_dn: moments.mean_dn(), var_dn2: moments.variance_dn2() }
    }

    /// Offset and dark current of every pixel are recovered: the pixels' deviations have the stated size.
    #[test]
    fn every_pixels_dark_line_is_found() {
        let mut model = sensors::load("cmos12").unwrap();
        (model.camera.width, model.camera.height) = (80, 60);
        model.base.hot_pixel_fraction = 0.0;
        let sensor = Sensor::new(model).unwrap();
        let darks = [dark(&sensor, 0.01, 64, 0), dark(&sensor, 1.0, 64, 100), dark(&sensor, 4.0, 64, 200)];
        let reference = DarkReference::fit(&darks, 0.02).unwrap();
        for (exposure_s, tolerance) in [(0.02, 0.06), (2.0, 0.06)] {
            let c = Conditions { illumination: 0.0, ..sensor.conditions(exposure_s) };
            let truth = sensor.predict(&c).mean_dn;
            let found = reference.at(exposure_s).unwrap();
            let off = Zip::from(&found).and(&truth).map_collect(|&f, &t| f64::from(f) - t);
            let rms = off.mapv(|x| x * x).mean().unwrap().sqrt();
            if exposure_s == 0.02 {
                // 4800 pixels: 5 sigma of a root mean square is 0.05.
                assert!(
                    (rms / reference.std_err_dn - 1.0).abs() < tolerance,
                    "{rms} {}",
                    reference.std_err_dn
                );
            } else {
                assert!(rms < 0.5, "{rms}");
            }
            assert!(off.mean().unwrap().abs() < 5.0 * rms / 4800f64.sqrt());
        }
    }

    #[test]
    fn one_exposure_is_not_taken_for_another() {
        let flat = |exposure_s, value| DarkMean {
            exposure_s,
            frames: 4,
            mean_dn: Array2::from_elem((3, 4), value),
            var_dn2: Array2::from_elem((3, 4), 1.0),
        };
        let reference = DarkReference::fit(&[flat(0.1, 64.0)], 0.1).unwrap();
        assert_eq!(reference.at(0.1).unwrap()[(1, 1)], 64.0);
        assert!((reference.std_err_dn - 0.5).abs() < 1e-12);
        let message = reference.at(0.5).unwrap_err().to_string();
        assert!(message.contains("0.1 s") && message.contains("0.5 s"), "{message}");
        let two = DarkReference::fit(&[flat(0.1, 64.0), flat(1.1, 74.0)], 0.6).unwrap();
        assert!((two.at(2.1).unwrap()[(0, 0)] - 84.0).abs() < 1e-4);
        assert_eq!(DarkReference::fit(&[], 0.1).unwrap_err(), DarkError::None);
    }
}
