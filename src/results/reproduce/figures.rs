//! Data of the paper's four figures.

use super::{ReproduceError, Setup};
use crate::bench::BenchState;
use crate::budget;
use crate::calibrate::dark::DarkReference;
use crate::calibrate::file::{Calibration, Description};
use crate::calibrate::pattern::{FixedPattern, Options};
use crate::correct::Corrector;
use crate::dataset::CameraInfo;
use crate::noise::{Estimate, NoiseReport};
use crate::scene_variation::{Roi, Variation, of_region};
use crate::statistics::median::median_of;
use ndarray::Array2;
use radcam_sim::Scene;

/// Relative light of the seven levels of Fig. 3: a 20-fold range.
const LEVELS: [f64; 7] = [0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0];
/// Squares of the chart used in Fig. 3.
const SQUARES: [usize; 4] = [0, 1, 2, 4];

/// Data of all four figures.
#[derive(Debug, Clone)]
pub struct Figures {
    /// Fig. 1.
    pub slopes: Slopes,
    /// Fig. 2.
    pub line: NoiseReport,
    /// Fig. 3.
    pub surfaces: Vec<Surface>,
    /// Fig. 4.
    pub budget: Vec<budget::Level>,
}

/// Fig. 1: values of one pixel against its window mean, one point per configuration.
#[derive(Debug, Clone)]
pub struct Slopes {
    /// Row and column.
    pub at: (usize, usize),
    /// (mean of the window, value of the pixel, kept), DN.
    pub points: Vec<(f64, f64, bool)>,
    /// K of that pixel.
    pub k: f64,
}

/// One curve of Fig. 3.
#[derive(Debug, Clone)]
pub struct Surface {
    /// Name of the square.
    pub name: String,
    /// (mu_D, sigma_D^2 - sigma_CN^2, its error) at each level, DN and DN^2.
    pub points: Vec<(f64, f64, f64)>,
    /// V_s of the parabola through all of them.
    pub scene_variation: f64,
}

impl Slopes {
    /// Selects the pixel with the clearest outlier.
    pub(super) fn of(images: &[Array2<f32>], pattern: &FixedPattern, options: Options) -> Self {
        let light: Vec<_> =
            images.iter().map(|e| crate::calibrate::window::mean(e.view(), options.window)).collect();
        let slope = |i: usize, at: (usize, usize)| f64::from(images[i][at]) / f64::from(light[i][at]);
        let mut sorted = Vec::new();
        let mut best = ((0, 0), 0.0, 1.0);
        for (at, _) in images[0].indexed_iter() {
            let m: Vec<f64> = (0..images.len()).map(|i| slope(i, at)).collect();
            let middle = median_of(&m, &mut sorted);
            let far = m.iter().map(|m| (m - middle).abs()).fold(0.0, f64::max);
            if far > best.1 {
                best = (at, far, middle);
            }
        }
        let (at, _, middle) = best;
        let points = (0..images.len())
            .map(|i| {
                let kept = (slope(i, at) - middle).abs() <= options.p * pattern.pooled_sd;
                (f64::from(light[i][at]), f64::from(images[i][at]), kept)
            })
            .collect();
        Self { at, points, k: pattern.k[at].into() }
    }
}

/// Computes Fig. 3: V_s of each square at each level from one image, the parabolas, and their chi-square per
/// degree of freedom.
pub(super) fn surfaces(
    setup: &mut Setup,
    dark: DarkReference,
    pattern: FixedPattern,
    line: &Estimate,
) -> Result<(Vec<Surface>, f64), ReproduceError> {
    let fault = |e: &dyn std::fmt::Display| ReproduceError::Calibration(e.to_string());
    let body = setup.camera.sensor().model().camera.clone();
    let bench = setup.camera.sensor().model().bench.clone();
    let info = CameraInfo {
        width: body.width as usize,
        height: body.height as usize,
        bit_depth: body.bit_depth,
        ..Default::default()
    };
    let mut description = Description::of(info);
    let (gain, constant) = (&line.gain_dn_per_e, &line.constant_noise_var_dn2);
    description.gain_dn_per_e = Some(gain.value);
    description.constant_noise_var_dn2 = Some(constant.value);
    description.noise_covariance = Some([gain.std_err.powi(2), line.covariance, constant.std_err.powi(2)]);
    description.offset_dn = Some(0.0);
    let exposure_s = dark.exposure_s;
    let dark_dn = dark.level_dn.clone();
    let calibration = Calibration::new(description, dark, pattern, &[]);
    let corrector = Corrector::new(&calibration, exposure_s).map_err(|e| fault(&e))?;
    let mut seen: Vec<Vec<Variation>> = vec![Vec::new(); SQUARES.len()];
    for illumination in LEVELS {
        let state = BenchState { illumination, configuration: 0, scene: Scene::Chart };
        let image = setup.average(state, 1)?.mean_dn().mapv(|dn| dn as u16);
        let corrected = corrector.image(&image).map_err(|e| fault(&e))?;
        for (square, seen) in SQUARES.into_iter().zip(&mut seen) {
            let r = bench.square_region(&body, square);
            // 100 x 100 pixels in the middle, as in the paper.
            let roi = Roi {
                x: (r.x + r.width / 2 - 50) as usize,
                y: (r.y + r.height / 2 - 50) as usize,
                width: 100,
                height: 100,
            };
            seen.push(of_region(&corrected, 1, &dark_dn, &calibration, roi).map_err(|e| fault(&e))?);
        }
    }
    let (mut chi2, mut dof) = (0.0, 0.0);
    let surfaces = SQUARES
        .into_iter()
        .zip(&seen)
        .map(|(square, levels)| {
            let weight = |v: &Variation| v.repeat_std_err.powi(-2);
            let sum: f64 = levels.iter().map(weight).sum();
            let v_s = levels.iter().map(|v| weight(v) * v.scene_variation.value).sum::<f64>() / sum;
            chi2 += levels.iter().map(|v| weight(v) * (v.scene_variation.value - v_s).powi(2)).sum::<f64>();
            dof += levels.len() as f64 - 1.0;
            Surface {
                name: bench.chart[square].name.clone(),
                points: levels
                    .iter()
                    .map(|v| {
                        let square = v.mean_dn * v.mean_dn;
                        (v.mean_dn, v.scene_variation.value * square, v.repeat_std_err * square)
                    })
                    .collect(),
                scene_variation: v_s,
            }
        })
        .collect();
    Ok((surfaces, chi2 / dof))
}

impl Figures {
    /// Returns the largest mean and the largest scene variance of Fig. 3.
    pub fn reach(&self) -> (f64, f64) {
        let all = self.surfaces.iter().flat_map(|s| &s.points);
        all.fold((0.0, 0.0), |(x, y), p| (f64::max(x, p.0), f64::max(y, p.1)))
    }
}
