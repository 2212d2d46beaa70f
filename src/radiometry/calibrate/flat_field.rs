//! Flat-field correction: K contains the light of the flats, so that an even scene gives an even image.
//!
//! A frame I becomes (I - D) / (F - D) times the mean of F - D (Seibert, Boone and Lindfors 1998, Proc. SPIE
//! 3336, 348), which is eq. (51) of Healey and Kondepudy with K = (F - D) / mean (F - D): it contains lens
//! shading, lamp and card with the response of the pixels.

use super::defects::Defect;
use super::pattern::FixedPattern;
use ndarray::{Array2, Zip, s};

/// Prefix of the estimator's name of such a K in a calibration file.
pub(super) const NAME: &str = "flat-field";

/// Adds the light of the flats (mean images above the dark reference) to a K without smooth light; for a
/// mosaic in each plane, whose mean over the sound pixels is 1. The relative error of a pixel is kept. Pixels
/// without a response keep K = 1.
pub(super) fn with_light(
    pattern: &mut FixedPattern,
    images: &[Array2<f32>],
    defects: &[Defect],
    mosaic: bool,
) {
    let flags = super::flags_of(defects, pattern.k.dim());
    for (y, x, period) in super::colour::places(mosaic) {
        let plane = s![y..;period, x..;period];
        let flags = flags.slice(plane);
        let mut map = Array2::<f32>::zeros(flags.dim());
        for image in images.iter().map(|image| image.slice(plane)) {
            let sound = image.iter().zip(&flags).filter(|(_, f)| **f == 0).map(|(v, _)| f64::from(*v));
            let (n, sum) = sound.fold((0.0, 0.0), |(n, sum), v| (n + 1.0, sum + v));
            if n > 0.0 && sum > 0.0 {
                let per_mean = (n / sum / images.len() as f64) as f32;
                map.scaled_add(per_mean, &image);
            }
        }
        let (mut k, mut std_err) = (pattern.k.slice_mut(plane), pattern.std_err.slice_mut(plane));
        Zip::from(&mut k).and(&mut std_err).and(&map).and(&flags).for_each(|k, e, &light, &f| {
            if f & super::defects::NO_RESPONSE == 0 && light > 0.0 {
                (*k, *e) = (light, *e / *k * light);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::defects::{DEAD, HOT};

    /// Light that falls over the image and is twice as strong in some colours, with individual responses of
    /// the pixels: K is their product, with a mean of 1 over the sound pixels of each colour. A dead pixel
    /// keeps K = 1; a hot one has its response.
    #[test]
    fn light_and_response_stand_in_k() {
        let own = |y: usize, x: usize| 1.0 + 0.01 * ((7 * y + 3 * x) % 5) as f32;
        let light = |y: usize, x: usize| 800.0 * (1.0 - 0.05 * y as f32) * if x % 2 == 1 { 2.0 } else { 1.0 };
        let image = Array2::from_shape_fn((8, 8), |(y, x)| own(y, x) * light(y, x));
        let mut pattern = FixedPattern {
            k: Array2::from_shape_fn((8, 8), |(y, x)| own(y, x)),
            std_err: Array2::from_elem((8, 8), 0.002),
            kept: Array2::ones((8, 8)),
            pooled_sd: 0.0,
            mean_before: 1.0,
            level_dn: 1000.0,
        };
        pattern.k[(2, 3)] = 1.0;
        let defect = |y, x, flags| Defect { y, x, flags, dark_excess_dn: 0.0, k: 1.0, variance_ratio: 1.0 };
        let defects = [defect(2, 3, DEAD), defect(5, 5, HOT)];
        let images = [image.clone(), image.mapv(|v| 0.5 * v)];
        with_light(&mut pattern, &images, &defects, true);
        assert_eq!(pattern.k[(2, 3)], 1.0);
        for (y, x) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let sound: Vec<(usize, usize)> = (y..8)
                .step_by(2)
                .flat_map(|row| (x..8).step_by(2).map(move |column| (row, column)))
                .filter(|at| *at != (2, 3) && *at != (5, 5))
                .collect();
            let mean = |of: &dyn Fn((usize, usize)) -> f32| {
                sound.iter().map(|at| f64::from(of(*at))).sum::<f64>() / sound.len() as f64
            };
            assert!((mean(&|at| pattern.k[at]) - 1.0).abs() < 1e-5);
            let of_image = mean(&|at| image[at]);
            for at in sound {
                let expected = f64::from(image[at]) / of_image;
                assert!((f64::from(pattern.k[at]) - expected).abs() < 1e-5, "{at:?}");
                let share = f64::from(pattern.std_err[at]) / expected;
                assert!((share - 0.002 / f64::from(own(at.0, at.1))).abs() < 1e-6, "{at:?}");
            }
        }
        assert!(pattern.k[(5, 5)] != own(5, 5));
    }
}
