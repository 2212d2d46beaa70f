//! What the verbs on regions share: a calibration, images, a rectangle.

use super::correct::check;
use crate::calibrate::file::Calibration;
use crate::correct::Corrector;
use crate::dataset::{CameraInfo, image};
use crate::scene_variation::{Roi, Variation, of_region};
use anyhow::{Context, Result};
use ndarray::Array2;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct RegionArguments {
    /// The calibration file
    pub calibration: PathBuf,
    /// Raw images of one still scene; several are averaged
    #[arg(required = true)]
    pub images: Vec<PathBuf>,
    /// The region: first column, first row, width, height, px; the whole image where not given
    #[arg(long, value_name = "X,Y,W,H", value_parser = roi)]
    pub roi: Option<Roi>,
    /// Exposure of the images, s; that of the calibration's darks where not given
    #[arg(long)]
    pub exposure_s: Option<f64>,
}

/// `x,y,w,h`.
fn roi(text: &str) -> Result<Roi, String> {
    let numbers: Vec<usize> = text
        .split(',')
        .map(|n| n.trim().parse().map_err(|_| format!("\"{n}\" is not a whole number of pixels")))
        .collect::<Result<_, String>>()?;
    match numbers[..] {
        [x, y, width, height] => Ok(Roi { x, y, width, height }),
        _ => Err("write x,y,width,height in pixels".into()),
    }
}

/// Images ready to be looked at.
pub struct Seen {
    pub calibration: Calibration,
    /// Mean of the images, corrected.
    pub corrected: Array2<f32>,
    /// Dark reference at their exposure.
    pub dark_dn: Array2<f32>,
    pub frames: u64,
    pub roi: Roi,
}

impl RegionArguments {
    pub fn read(&self) -> Result<Seen> {
        let calibration = Calibration::read(&self.calibration)?;
        let exposure_s = self.exposure_s.unwrap_or(calibration.dark.exposure_s);
        let corrector = Corrector::new(&calibration, exposure_s)?;
        let mut sum = Array2::<f32>::zeros(corrector.shape());
        for path in &self.images {
            let named = || path.display().to_string();
            let frame = image::read(path, 0).with_context(named)?;
            let (height, width) = frame.dim();
            let now = CameraInfo { width, height, ..Default::default() };
            check(&calibration, &now, false).with_context(named)?;
            sum += &corrector.image(&frame)?;
        }
        let (height, width) = sum.dim();
        let frames = self.images.len() as u64;
        Ok(Seen {
            corrected: sum / frames as f32,
            dark_dn: calibration.dark.at(exposure_s)?,
            frames,
            roi: self.roi.unwrap_or(Roi { x: 0, y: 0, width, height }),
            calibration,
        })
    }
}

impl Seen {
    pub fn variation(&self) -> Result<Variation> {
        Ok(of_region(&self.corrected, self.frames, &self.dark_dn, &self.calibration, self.roi)?)
    }
}
