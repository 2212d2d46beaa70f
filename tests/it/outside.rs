//! A generator of its own, which shares nothing with sim/: normal numbers by a mixing function, charge as
//! normal noise of the right variance.

use ndarray::Array2;
use radcam::dataset::{CameraInfo, FrameRow, Kind, Manifest, Writer};
use std::path::Path;

pub const SIZE: usize = 96;
const GAIN: f64 = 0.25;

/// A number of unit variance for a place and a time.
pub fn normal(seed: u64) -> f64 {
    let mix = |mut z: u64| {
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) >> 11
    };
    let unit = |z: u64| (mix(z.wrapping_mul(0x9e37_79b9_7f4a_7c15)) as f64 + 0.5) / (1u64 << 53) as f64;
    (-2.0 * unit(2 * seed + 1).ln()).sqrt() * (std::f64::consts::TAU * unit(2 * seed + 2)).cos()
}

/// A campaign; `act` changes the image (DN above the black level) of a frame: number, signal (DN), image.
pub fn campaign(root: &Path, act: &dyn Fn(u64, f64, &mut Array2<f64>)) {
    let info = CameraInfo { width: SIZE, height: SIZE, bit_depth: 12, ..Default::default() };
    let mut writer = Writer::create(root, &Manifest::new(info), &[]).unwrap();
    let mut plan: Vec<(Kind, f64, f64)> =
        vec![(Kind::Dark, 1e-4, 0.0), (Kind::Dark, 0.02, 0.0), (Kind::Dark, 0.5, 0.0)];
    plan.extend((1..=8).map(|i| (Kind::Flat, 0.0025 * f64::from(i), 1.0)));
    plan.extend([0.05, 0.2, 0.5, 0.8].map(|light| (Kind::Flat, 0.02, light)));
    plan.push((Kind::Dark, 0.02, 0.0));
    let mut frame = 0u64;
    for (set, (kind, exposure_s, light)) in plan.into_iter().enumerate() {
        for index in 0..8 {
            let electrons = (13_600.0 * light / 0.02 + 10.0) * exposure_s;
            let mut image = Array2::from_shape_fn((SIZE, SIZE), |(y, x)| {
                let pixel = (y * SIZE + x) as u64;
                let at = (frame << 20) + pixel;
                let k = 1.0 + 0.005 * normal((1 << 50) + pixel);
                let q = electrons * k + (electrons * k).max(0.0).sqrt() * normal(at);
                GAIN * (q + 7.0 * normal((1 << 45) + at))
            });
            act(frame, GAIN * electrons, &mut image);
            let dn = image.mapv(|v| (v + 80.0).round().clamp(0.0, 4095.0) as u16);
            let row = FrameRow {
                file: format!("frames/{frame:05}.tiff"),
                kind,
                set: set as u32,
                index,
                exposure_s,
                illumination: light,
                configuration: 0,
                temperature_c: None,
                timestamp_s: Some(frame as f64 * 0.04),
            };
            writer.append(row, &dn).unwrap();
            frame += 1;
        }
    }
}
