//! Shared by the commands on regions: a calibration, images, a rectangle.

use super::common::above_0;
use super::correct::{Notes, Plain};
use crate::calibrate::file::Calibration;
use crate::correct::Corrector;
use crate::number::percent;
use crate::scene_variation::{Roi, Variation, of_region, part};
use anyhow::{Result, bail};
use ndarray::Array2;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

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
    /// Exposure of the images, s; what they or their dataset say where not given, else that of the
    /// calibration's darks
    #[arg(long, value_parser = above_0)]
    pub exposure_s: Option<f64>,
    /// Go on although the calibration was made under other settings
    #[arg(long)]
    pub force: bool,
}

/// Parses `x,y,w,h`.
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

/// Corrected images of a region command.
pub struct Seen {
    pub calibration: Calibration,
    /// Mean of the corrected images.
    pub corrected: Array2<f32>,
    /// Dark reference at the exposure of the images.
    pub dark_dn: Array2<f32>,
    pub frames: u64,
    /// Digest that identifies the set of images.
    pub digest: u64,
    pub roi: Roi,
}

/// FNV-1a, 64 bits (Fowler, Noll and Vo, draft-eastlake-fnv).
const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const FNV_PRIME: u64 = 0x100_0000_01b3;

impl RegionArguments {
    pub fn read(&self) -> Result<Seen> {
        let calibration = Calibration::read(&self.calibration)?;
        if calibration.description.is_flat_field() {
            bail!(
                "{} is a flat-field correction: the card of its flats is in K and would be taken for the surface; `radcam calibrate` without \
                 --flat-field makes a K of the pixels alone",
                self.calibration.display()
            );
        }
        let mut first: Option<(f64, Corrector)> = None;
        let mut sum = Array2::<f32>::zeros(calibration.k.dim());
        let mut digest = 0;
        let mut seen: BTreeMap<u64, &Path> = BTreeMap::new();
        let mut notes = Notes::default();
        for path in &self.images {
            let frame = Plain::read(path, &calibration, self.exposure_s, self.force, &mut notes)?;
            if first.is_none() {
                first = Some((frame.exposure_s, Corrector::new(&calibration, frame.exposure_s)?));
            }
            let Some((exposure_s, corrector)) = &first else { continue };
            if (frame.exposure_s / exposure_s - 1.0).abs() > 1e-6 {
                bail!(
                    "{} was exposed for {} s, and {} for {exposure_s} s: images of one exposure are averaged",
                    path.display(),
                    frame.exposure_s,
                    self.images[0].display()
                );
            }
            notes.look(path, &frame.pixels, corrector, (&calibration, frame.exposure_s, self.force))?;
            let (height, width) = frame.pixels.dim();
            let roi = self.roi.unwrap_or(Roi { x: 0, y: 0, width, height });
            clipped(path, &frame.pixels, &calibration.defects, roi, corrector.full_scale_dn())?;
            sum += &corrector.image(&frame.pixels)?;
            let of_frame = |d: u64, dn: &u16| (d ^ u64::from(*dn)).wrapping_mul(FNV_PRIME);
            // Order-independent: the same images in another order give the same digest.
            let of_frame = frame.pixels.iter().fold(FNV_OFFSET, of_frame);
            if let Some(other) = seen.insert(of_frame, path) {
                bail!(
                    "{} and {} are the same image: an average of copies is as noisy as one; give each image once",
                    other.display(),
                    path.display()
                );
            }
            digest ^= of_frame;
        }
        let exposure_s = first.map_or(calibration.dark.exposure_s, |f| f.0);
        let count = self.images.len() as u64;
        let (height, width) = sum.dim();
        Ok(Seen {
            corrected: sum / count as f32,
            dark_dn: calibration.dark.at(exposure_s)?,
            frames: count,
            digest,
            roi: self.roi.unwrap_or(Roi { x: 0, y: 0, width, height }),
            calibration,
        })
    }
}

/// Maximum share of clipped pixels in a region; clipping hides variance.
const CLIPPED: f64 = 1e-3;

/// Refuses a region with pixels at full scale.
fn clipped(
    path: &Path,
    frame: &Array2<u16>,
    defects: &Array2<u8>,
    roi: Roi,
    full_scale_dn: u16,
) -> Result<()> {
    let (region, flags) = (part(frame, roi)?, part(defects, roi)?);
    let clipped = region.iter().zip(flags).filter(|(dn, flag)| **dn >= full_scale_dn && **flag == 0);
    let share = clipped.count() as f64 / region.len().max(1) as f64;
    if share > CLIPPED {
        bail!(
            "{}: {} of the region's pixels are at full scale, {full_scale_dn} DN; take images with less light",
            path.display(),
            percent(share)
        );
    }
    Ok(())
}

impl Seen {
    pub fn variation(&self) -> Result<Variation> {
        Ok(of_region(&self.corrected, self.frames, &self.dark_dn, &self.calibration, self.roi)?)
    }
}
