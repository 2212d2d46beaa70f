//! Simulated frames of a camera, and their expected statistics.

#![allow(clippy::needless_range_loop)] // lanes are indexed: the shape that vectorises

use crate::effects::{Drawing, Effect, Memory, Stage};
use crate::maps::Maps;
use crate::model::{Model, ModelError};
use crate::poisson::{Site, poisson_lanes};
use crate::region::Region;
use crate::rng::{Keys, LANES, floor, integer_bits, noise_lanes};
use crate::scene::{Scene, light_map};
use ndarray::Array2;
use rayon::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};

/// Conditions of one frame, beside the model and the frame's number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conditions {
    /// Exposure time T, s.
    pub exposure_s: f64,
    /// Light relative to the bench's unit; 0 is dark.
    pub illumination: f64,
    /// Position of card and lamp (Section V of the paper).
    pub configuration: u32,
    /// Scene before the camera.
    pub scene: Scene,
    /// Temperature of the sensor, degrees Celsius.
    pub temperature_c: f64,
    /// Gain above nominal, dB.
    pub gain_db: f64,
    /// Black level, DN.
    pub black_level_dn: f64,
    /// Time since the camera was switched on, s.
    pub time_s: f64,
}

/// Expected statistics of each pixel, (rows, columns).
#[derive(Debug, Clone)]
pub struct Expected {
    /// Mean, DN (eq. 22, plus the black level).
    pub mean_dn: Array2<f64>,
    /// Temporal variance, DN^2 (eq. 26 to 28).
    pub var_dn2: Array2<f64>,
}

type LightKey = (Scene, u32);

/// A camera ready to draw: a model with its maps.
pub struct Sensor {
    model: Model,
    maps: Maps,
    /// Light map used last; a bench stands still for many frames.
    light: Mutex<Option<(LightKey, Arc<Array2<f32>>)>>,
    /// Images that effects keep from the frame drawn last.
    memory: Mutex<Memory>,
    /// Setting of light and exposure of the frame drawn last, and its number.
    setting: Mutex<(Option<Setting>, u64)>,
    /// The model's effects with their values, in the order of the chain.
    effects: Vec<(&'static dyn Effect, Vec<f64>)>,
}

/// Constants of one frame, the same for every pixel.
#[derive(Clone, Copy)]
struct Scalars {
    seed: u64,
    keys: Keys,
    frame: u64,
    light_e: f64,
    dark_e: f64,
    read_noise_dn: f64,
    gain_dn_per_e: f64,
    black_level_dn: f64,
    full_scale_dn: f64,
}

/// One row (or less) of the maps.
#[derive(Clone, Copy)]
struct Row<'a> {
    first_pixel: u32,
    uniformity: &'a [f32],
    dark_current: &'a [f32],
    offset_dn: &'a [f32],
    light: &'a [f32],
    /// Read noise over its root mean square, if pixels differ in it.
    read: Option<&'a [f32]>,
}

/// Read-noise factors of pixels that are alike.
const ALIKE: [f32; LANES] = [1.0; LANES];

/// Returns `width` pixels of row `y` of a map, from column `x`.
fn span(map: &Array2<f32>, y: usize, x: usize, width: usize) -> &[f32] {
    let from = y * map.ncols() + x;
    &map.as_slice().expect("maps are made in row-major order")[from..from + width]
}

/// Simulates the chain of eq. (20) for one row: light and dark to charge, charge to voltage, voltage to code.
#[inline(always)]
fn draw_row(s: &Scalars, row: Row<'_>, out: &mut [u16]) {
    let (uniformity, uniformity_rest) = row.uniformity.as_chunks::<LANES>();
    let (light, light_rest) = row.light.as_chunks::<LANES>();
    let (dark, dark_rest) = row.dark_current.as_chunks::<LANES>();
    let (offset, offset_rest) = row.offset_dn.as_chunks::<LANES>();
    let (blocks, rest) = out.as_chunks_mut::<LANES>();
    let mut first_pixel = row.first_pixel;
    let (read, read_rest) = row.read.unwrap_or(&[]).as_chunks::<LANES>();
    let maps = uniformity.iter().zip(light).zip(dark).zip(offset).enumerate();
    for (out, (i, (((uniformity, light), dark), offset))) in blocks.iter_mut().zip(maps) {
        let read = read.get(i).unwrap_or(&ALIKE);
        *out = draw_block(s, first_pixel, uniformity, light, dark, offset, read);
        first_pixel = first_pixel.wrapping_add(LANES as u32);
    }
    if !rest.is_empty() {
        let padded = |rest: &[f32]| {
            let mut lanes = [0.0; LANES];
            lanes[..rest.len()].copy_from_slice(rest);
            lanes
        };
        let [k, l, d, o] = [uniformity_rest, light_rest, dark_rest, offset_rest].map(padded);
        let read = if row.read.is_some() { padded(read_rest) } else { ALIKE };
        rest.copy_from_slice(&draw_block(s, first_pixel, &k, &l, &d, &o, &read)[..rest.len()]);
    }
}

/// Simulates eq. (20) for [`LANES`] consecutive pixels.
#[inline(always)]
fn draw_block(
    s: &Scalars,
    first_pixel: u32,
    uniformity: &[f32; LANES],
    light: &[f32; LANES],
    dark: &[f32; LANES],
    offset_dn: &[f32; LANES],
    read: &[f32; LANES],
) -> [u16; LANES] {
    let mut mean_e = [0.0; LANES];
    for i in 0..LANES {
        mean_e[i] = s.light_e * f64::from(light[i] * uniformity[i]) + s.dark_e * f64::from(dark[i]);
    }
    let noise = noise_lanes(&s.keys, s.frame, first_pixel);
    let charge = poisson_lanes(&mean_e, &noise, Site { seed: s.seed, frame: s.frame, first_pixel });
    let mut codes = [0u16; LANES];
    for i in 0..LANES {
        let volt_dn = charge[i] * s.gain_dn_per_e
            + (noise.read[i] * (s.read_noise_dn * f64::from(read[i]))
                + (s.black_level_dn + f64::from(offset_dn[i])));
        // V in (n - 1/2, n + 1/2] gives n (eq. 4), so n = ceil(V - 1/2) = -floor(1/2 - V), clipped to
        // 0 .. 2^b - 1 (eq. 5).
        let rounded = -floor(0.5 - volt_dn);
        let above = if rounded > 0.0 { rounded } else { 0.0 };
        let clipped = if above < s.full_scale_dn { above } else { s.full_scale_dn };
        codes[i] = integer_bits(clipped) as u16;
    }
    codes
}

/// Band of rows of a frame: the unit of work of one thread.
struct Band<'a> {
    sensor: &'a Sensor,
    light: &'a Array2<f32>,
    scalars: Scalars,
    region: Region,
    /// First row, counted from the top of the region.
    first_row: usize,
    out: &'a mut [u16],
}

impl pulp::NullaryFnOnce for Band<'_> {
    type Output = ();

    /// Inlined into a function compiled for the vector unit of the machine at hand.
    #[inline(always)]
    fn call(self) {
        let Self { sensor, light, scalars, region, first_row, out } = self;
        let width = region.width as usize;
        for (i, out) in out.chunks_mut(width).enumerate() {
            let y = region.y as usize + first_row + i;
            let x = region.x as usize;
            let row = Row {
                first_pixel: y as u32 * sensor.model.camera.width + region.x,
                uniformity: span(&sensor.maps.uniformity, y, x, width),
                dark_current: span(&sensor.maps.dark_current, y, x, width),
                offset_dn: span(&sensor.maps.offset_dn, y, x, width),
                light: span(light, y, x, width),
                read: sensor.maps.read_noise.as_ref().map(|map| span(map, y, x, width)),
            };
            draw_row(&scalars, row, out);
        }
    }
}

/// Key of a setting: exposure, illumination, scene and configuration.
type Setting = (u64, u64, Scene, u32);

impl std::fmt::Debug for Sensor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Sensor").field("model", &self.model).finish_non_exhaustive()
    }
}

impl Sensor {
    /// Checks the model and draws its maps.
    ///
    /// # Errors
    ///
    /// The model is invalid; the message says what is wrong.
    pub fn new(model: Model) -> Result<Self, ModelError> {
        model.check()?;
        let maps = Maps::new(&model);
        let mut effects = model
            .effects
            .iter()
            .map(|e| e.effect().and_then(|effect| Ok((effect, e.values(effect)?))))
            .collect::<Result<Vec<_>, _>>()?;
        effects.sort_by_key(|(e, p)| e.stage_with(p));
        Ok(Self {
            model,
            maps,
            light: Mutex::new(None),
            memory: Mutex::default(),
            setting: Mutex::default(),
            effects,
        })
    }

    /// Returns the model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Returns the per-pixel maps.
    pub fn maps(&self) -> &Maps {
        &self.maps
    }

    /// Returns the whole sensor.
    pub fn region(&self) -> Region {
        Region { x: 0, y: 0, width: self.model.camera.width, height: self.model.camera.height }
    }

    /// Returns the conditions at which the camera starts: the card at illumination 1, nominal gain and black
    /// level.
    pub fn conditions(&self, exposure_s: f64) -> Conditions {
        Conditions {
            exposure_s,
            illumination: 1.0,
            configuration: 0,
            scene: Scene::Card,
            temperature_c: self.model.base.dark_reference_c,
            gain_db: 0.0,
            black_level_dn: self.model.base.black_level_dn,
            time_s: 0.0,
        }
    }

    fn light(&self, scene: Scene, configuration: u32) -> Arc<Array2<f32>> {
        let key = (scene, configuration);
        let mut kept = self.light.lock().unwrap_or_else(PoisonError::into_inner);
        match &*kept {
            Some((known, map)) if *known == key => Arc::clone(map),
            _ => {
                let map = Arc::new(light_map(&self.model, scene, configuration));
                *kept = Some((key, Arc::clone(&map)));
                map
            }
        }
    }

    /// Returns the number of the setting of light and exposure. Successive frames of the same setting share
    /// it.
    fn setting(&self, c: &Conditions) -> u64 {
        let key = (c.exposure_s.to_bits(), c.illumination.to_bits(), c.scene, c.configuration);
        let mut known = self.setting.lock().unwrap_or_else(PoisonError::into_inner);
        if known.0 != Some(key) {
            *known = (Some(key), known.1 + 1);
        }
        known.1
    }

    fn scalars(&self, frame: u64, c: &Conditions) -> Scalars {
        let base = &self.model.base;
        let gain_dn_per_e = self.model.gain_dn_per_e(c.gain_db);
        let warmth = libm::exp2((c.temperature_c - base.dark_reference_c) / base.dark_doubling_k);
        Scalars {
            seed: base.seed,
            keys: Keys::new(base.seed),
            frame,
            light_e: self.model.bench.photon_flux_per_s
                * base.quantum_efficiency
                * c.illumination
                * (1.0 + self.model.bench.lamp_drift_per_h * c.time_s / 3600.0)
                * c.exposure_s,
            dark_e: base.dark_current_e_per_s * warmth * c.exposure_s,
            read_noise_dn: base.read_noise_e * gain_dn_per_e,
            gain_dn_per_e,
            black_level_dn: c.black_level_dn,
            full_scale_dn: f64::from(self.model.full_scale_dn()),
        }
    }

    /// Draws frame number `frame` of `region` into `out`, row by row, `width * height` codes in DN.
    ///
    /// A pixel's code depends on (seed, frame, pixel) and the conditions alone: not on the region, the number
    /// of threads or earlier draws. Effects with memory (image lag, temporal filter) are the exception: their
    /// previous frame is the one drawn last.
    ///
    /// # Panics
    /// The region leaves the sensor, or `out` has another length: faults of the caller.
    pub fn draw(&self, frame: u64, conditions: &Conditions, region: Region, out: &mut [u16]) {
        let all = self.region();
        let (width, height) = (region.width as usize, region.height as usize);
        assert!(
            u64::from(region.x) + u64::from(region.width) <= u64::from(all.width)
                && u64::from(region.y) + u64::from(region.height) <= u64::from(all.height),
            "region {region:?} leaves the sensor {all:?}"
        );
        assert_eq!(out.len(), width * height, "length of the frame");
        if out.is_empty() {
            return;
        }
        let light = self.light(conditions.scene, conditions.configuration);
        let scalars = self.scalars(frame, conditions);
        if !self.model.effects.is_empty() {
            self.draw_with_effects(conditions, &scalars, &light, region, out);
            return;
        }
        let arch = pulp::Arch::new();
        // Bands of about 16,000 pixels: large enough to share, small enough to share evenly.
        let rows_per_band = (16_384 / width).clamp(1, height);
        out.par_chunks_mut(width * rows_per_band).enumerate().for_each(|(band, out)| {
            arch.dispatch(Band {
                sensor: self,
                light: &light,
                scalars,
                region,
                first_row: band * rows_per_band,
                out,
            });
        });
    }

    /// Runs the chain stage by stage, with every effect at its stage.
    fn draw_with_effects(
        &self,
        conditions: &Conditions,
        s: &Scalars,
        light: &Array2<f32>,
        region: Region,
        out: &mut [u16],
    ) {
        let effects = &self.effects;
        let exposure_s = conditions.exposure_s.max(1e-12);
        let rate = ndarray::Zip::from(light)
            .and(&self.maps.uniformity)
            .map_collect(|&l, &k| s.light_e / exposure_s * f64::from(l * k));
        let expected = ndarray::Zip::from(&rate)
            .and(&self.maps.dark_current)
            .map_collect(|&r, &d| r * exposure_s + s.dark_e * f64::from(d));
        let mut memory = self.memory.lock().unwrap_or_else(PoisonError::into_inner);
        let dark_e_per_s = self.maps.dark_current.mapv(|d| s.dark_e / exposure_s * f64::from(d));
        let mut d = Drawing {
            image: expected,
            rate_e_per_s: &rate,
            dark_e_per_s: &dark_e_per_s,
            exposure_s,
            illumination: conditions.illumination,
            setting: self.setting(conditions),
            time_s: conditions.time_s,
            frame: s.frame,
            seed: s.seed,
            full_scale_dn: s.full_scale_dn,
            offset_dn: s.black_level_dn,
            gain_dn_per_e: s.gain_dn_per_e,
            read_noise_dn: s.read_noise_dn,
            memory: &mut memory,
        };
        let run = |d: &mut Drawing<'_>, from: Stage, to: Stage| {
            effects
                .iter()
                .filter(|(e, p)| (from..=to).contains(&e.stage_with(p)))
                .for_each(|(e, p)| e.draw(p, d));
        };
        run(&mut d, Stage::Light, Stage::Light);
        // Shot noise; the read noise is drawn here and added later.
        let mut read = Array2::<f64>::zeros(d.image.raw_dim());
        let all = d.image.as_slice_mut().unwrap_or_default().par_chunks_mut(LANES);
        all.zip(read.as_slice_mut().unwrap_or_default().par_chunks_mut(LANES)).enumerate().for_each(
            |(block, (charge, read))| {
                let first_pixel = (block * LANES) as u32;
                let mut mean_e = [0.0; LANES];
                mean_e[..charge.len()].copy_from_slice(charge);
                let noise = noise_lanes(&s.keys, s.frame, first_pixel);
                let site = Site { seed: s.seed, frame: s.frame, first_pixel };
                charge.copy_from_slice(&poisson_lanes(&mean_e, &noise, site)[..charge.len()]);
                read.copy_from_slice(&noise.read[..read.len()]);
            },
        );
        run(&mut d, Stage::Charge, Stage::Transfer);
        if let Some(map) = &self.maps.read_noise {
            read.zip_mut_with(map, |v, &m| *v *= f64::from(m));
        }
        d.image.scaled_add(self.model.base.read_noise_e, &read);
        run(&mut d, Stage::Read, Stage::Read);
        d.image *= s.gain_dn_per_e;
        run(&mut d, Stage::Amplifier, Stage::Amplifier);
        d.image.zip_mut_with(&self.maps.offset_dn, |v, &o| *v += f64::from(o));
        run(&mut d, Stage::Converter, Stage::Converter);
        let code = |v: f64| libm::ceil(v - 0.5).clamp(0.0, s.full_scale_dn);
        d.image += s.black_level_dn;
        d.image.mapv_inplace(code);
        // Firmware receives and outputs whole codes.
        for (e, p) in effects.iter().filter(|(e, p)| e.stage_with(p) == Stage::Firmware) {
            e.draw(p, &mut d);
            d.image.mapv_inplace(code);
        }
        let (x, y) = (region.x as usize, region.y as usize);
        let part = d.image.slice(ndarray::s![y..y + region.height as usize, x..x + region.width as usize]);
        out.iter_mut().zip(part).for_each(|(o, &v)| *o = code(v) as u16);
    }

    /// Returns the expected mean and temporal variance of every pixel of the whole sensor (eq. 22 and 26 to
    /// 28).
    ///
    /// The result holds while the noise is wider than about half a step and nothing clips.
    pub fn predict(&self, conditions: &Conditions) -> Expected {
        let s = self.scalars(0, conditions);
        let light = self.light(conditions.scene, conditions.configuration);
        let maps = &self.maps;
        let mut mean_e = Array2::zeros(light.raw_dim());
        ndarray::Zip::from(&mut mean_e)
            .and(&*light)
            .and(&maps.uniformity)
            .and(&maps.dark_current)
            .for_each(|mean, &l, &k, &d| *mean = s.light_e * f64::from(l * k) + s.dark_e * f64::from(d));
        let rounding = 1.0 / 12.0;
        let read = self.model.constant_noise_var_dn2(conditions.gain_db) - rounding;
        let mut var_dn2 = mean_e.mapv(|e| s.gain_dn_per_e * s.gain_dn_per_e * e + rounding + read);
        if let Some(map) = &maps.read_noise {
            var_dn2.zip_mut_with(map, |v, &m| *v += read * (f64::from(m).powi(2) - 1.0));
        }
        let mut mean_dn = mean_e;
        mean_dn.zip_mut_with(&maps.offset_dn, |m, &offset| {
            *m = *m * s.gain_dn_per_e + s.black_level_dn + f64::from(offset);
        });
        Expected { mean_dn, var_dn2 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensors;

    fn small(name: &str, width: u32, height: u32) -> Sensor {
        let mut model = sensors::load(name).unwrap();
        (model.camera.width, model.camera.height) = (width, height);
        Sensor::new(model).unwrap()
    }

    fn frame(sensor: &Sensor, n: u64, conditions: &Conditions, region: Region) -> Vec<u16> {
        let mut out = vec![0; (region.width * region.height) as usize];
        sensor.draw(n, conditions, region, &mut out);
        out
    }

    #[test]
    fn pixels_do_not_depend_on_threads_order_or_region() {
        let sensor = small("cmos12", 333, 201);
        let c = sensor.conditions(0.006);
        let whole = frame(&sensor, 9, &c, sensor.region());
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let _ = frame(&sensor, 3, &c, sensor.region());
        assert_eq!(one.install(|| frame(&sensor, 9, &c, sensor.region())), whole);
        let region = Region { x: 101, y: 57, width: 77, height: 31 };
        let part = frame(&sensor, 9, &c, region);
        for row in 0..31 {
            let from = (57 + row) * 333 + 101;
            assert_eq!(part[row * 77..][..77], whole[from..][..77], "row {row}");
        }
    }

    /// Mean and variance of 400 frames against eq. (22) and (28): pooled over pixels within 5 sigma, and the
    /// pixels' standardised means scatter as a chi-square.
    #[test]
    fn drawn_statistics_are_the_predicted_ones() {
        for (name, exposure_s, illumination) in
            [("xc77", 1.0 / 30.0, 0.7), ("cmos12", 0.008, 0.5), ("cmos12", 0.02, 0.0), ("ccd16", 0.8, 0.02)]
        {
            let sensor = small(name, 64, 48);
            let conditions = Conditions { illumination, ..sensor.conditions(exposure_s) };
            let expected = sensor.predict(&conditions);
            let n = 400;
            let pixels = 64 * 48;
            let mut sum = vec![0.0; pixels];
            let mut square = vec![0.0; pixels];
            for f in 0..n {
                let out = frame(&sensor, f, &conditions, sensor.region());
                for ((s, q), (&x, mu)) in
                    sum.iter_mut().zip(&mut square).zip(out.iter().zip(&expected.mean_dn))
                {
                    let d = f64::from(x) - mu;
                    *s += d;
                    *q += d * d;
                }
            }
            let (n, m) = (n as f64, pixels as f64);
            let (mut chi2, mut ratio) = (0.0, 0.0);
            for ((s, q), var) in sum.iter().zip(&square).zip(&expected.var_dn2) {
                chi2 += s * s / n / var;
                ratio += (q - s * s / n) / (n - 1.0) / var;
            }
            let z_mean = (chi2 - m) / (2.0 * m).sqrt();
            let z_var = (ratio / m - 1.0) / (2.0 / ((n - 1.0) * m)).sqrt();
            assert!(z_mean.abs() < 5.0, "{name}: mean {z_mean} sigma");
            assert!(z_var.abs() < 5.0, "{name}: variance {z_var} sigma");
        }
    }

    #[test]
    fn the_maps_have_the_spread_of_the_model() {
        let sensor = small("xc77", 640, 480);
        let k = &sensor.maps().uniformity;
        let n = k.len() as f64;
        let mean = k.iter().map(|&v| f64::from(v)).sum::<f64>() / n;
        let sd = (k.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / n).sqrt();
        assert!((mean - 1.0).abs() < 1e-7);
        // Five standard errors of a standard deviation.
        assert!((sd / sensor.model().base.sigma_k - 1.0).abs() < 5.0 / (2.0 * n).sqrt());
    }

    #[test]
    fn codes_are_rounded_as_in_equation_4_and_clipped_as_in_5() {
        let mut model = sensors::load("cmos12").unwrap();
        (model.camera.width, model.camera.height) = (32, 2);
        model.camera.bit_depth = 4;
        (model.base.read_noise_e, model.base.offset_spread_dn) = (0.0, 0.0);
        let sensor = Sensor::new(model).unwrap();
        for (black_level_dn, code) in [(0.0, 0), (0.5, 0), (0.50001, 1), (14.5, 14), (14.6, 15), (90.0, 15)] {
            let dark = Conditions { illumination: 0.0, black_level_dn, ..sensor.conditions(1e-9) };
            assert!(frame(&sensor, 0, &dark, sensor.region()).iter().all(|&d| d == code), "{black_level_dn}");
        }
        let flood = Conditions { illumination: 1e6, ..sensor.conditions(1.0) };
        assert!(frame(&sensor, 0, &flood, sensor.region()).iter().all(|&d| d == 15));
    }

    #[test]
    fn dark_current_doubles_with_temperature() {
        let sensor = small("cmos12", 64, 48);
        let at = |temperature_c| {
            let c = Conditions { illumination: 0.0, temperature_c, ..sensor.conditions(5.0) };
            sensor.predict(&c).mean_dn.mean().unwrap() - sensor.conditions(1.0).black_level_dn
        };
        let offset = sensor.maps().offset_dn.mean().unwrap() as f64;
        let doubling = sensor.model().base.dark_doubling_k;
        assert!(((at(40.0 + doubling) - offset) / (at(40.0) - offset) - 2.0).abs() < 1e-6);
    }
}
