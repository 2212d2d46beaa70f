//! The frame path: drawing frames and accumulating their moments.
//!
//! `benches/compare` runs these beside numpy and OpenCV and prints the ratios.

#![allow(missing_docs, clippy::unwrap_used)] // criterion's macros; a bench may stop where it stumbles

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use radcam::statistics::moments::Moments;
use radcam_sim::{Conditions, Sensor, sensors};
use std::hint::black_box;

/// Full signal chain (fixed pattern, Poisson, read noise, conversion) for 12-bit flats, on one core.
fn simulate(c: &mut Criterion) {
    let model = sensors::load("cmos12").unwrap();
    let flux = model.bench.photon_flux_per_s * model.base.quantum_efficiency;
    let sensor = Sensor::new(model).unwrap();
    let region = sensor.region();
    let mut frame = vec![0u16; (region.width * region.height) as usize];
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let mut group = c.benchmark_group("simulate");
    group.throughput(Throughput::Elements(frame.len() as u64));
    for (name, electrons) in [("flat_5000_e", 5000.0), ("flat_5_e", 5.0), ("dark", 0.0)] {
        let lit = sensor.conditions(f64::max(electrons, 1.0) / flux);
        let conditions = Conditions { illumination: if electrons > 0.0 { 1.0 } else { 0.0 }, ..lit };
        let mut n = 0;
        group.bench_function(name, |b| {
            b.iter(|| {
                n += 1;
                one.install(|| sensor.draw(n, &conditions, region, black_box(&mut frame)));
            });
        });
    }
}

/// Mean and variance over 16 frames of a megapixel; the sum of the same bytes shows the memory bandwidth.
fn moments(c: &mut Criterion) {
    let (rows, columns, n) = (1024, 1024, 16);
    let frames: Vec<Vec<u16>> =
        (0..n).map(|f| (0..rows * columns).map(|p| ((p * 31 + f * 7919) % 4096) as u16).collect()).collect();
    let slices: Vec<&[u16]> = frames.iter().map(|f| &f[..]).collect();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let mut group = c.benchmark_group("moments");
    group.throughput(Throughput::Elements((rows * columns * n) as u64));
    for bits in [12, 16] {
        // As in a campaign: the memory of one set is reused for the next.
        let mut moments = Moments::new((rows, columns), bits);
        let mut variance = moments.variance_dn2();
        let mut run = || {
            moments.reset();
            moments.add(black_box(&slices)).unwrap();
            moments.variance_into(black_box(&mut variance));
        };
        group.bench_function(format!("stack_{bits}_bit"), |b| b.iter(&mut run));
        group.bench_function(format!("stack_{bits}_bit_one_core"), |b| b.iter(|| one.install(&mut run)));
        group.bench_function(format!("stack_{bits}_bit_new_memory"), |b| {
            b.iter(|| {
                let mut moments = Moments::new((rows, columns), bits);
                moments.add(black_box(&slices)).unwrap();
                black_box(moments.variance_dn2())
            });
        });
    }
    let mut moments = Moments::new((rows, columns), 12);
    group.bench_function("accumulate_only", |b| b.iter(|| moments.add(black_box(&slices)).unwrap()));
    group.bench_function("read_the_same_bytes", |b| {
        use rayon::prelude::*;
        let sum = |part: &[u16]| part.iter().map(|&x| u32::from(x)).fold(0u32, u32::wrapping_add);
        b.iter(|| {
            let all = slices.par_iter().flat_map(|f| f.par_chunks(65_536));
            black_box(all.map(sum).reduce(|| 0, u32::wrapping_add))
        });
    });
}

/// All noise statistics of a set over 16 frames of a megapixel: 15 covariances, lines, spectrum, tails,
/// codes.
fn statistics(c: &mut Criterion) {
    use radcam::statistics::{layout::Layout, pass::collect_with};
    let (rows, columns, n) = (1024usize, 1024, 16);
    let code = |f: usize, p: usize| 2000 + (((p * 31 + f * 7919) * 2_654_435_761) >> 16) as u16 % 64;
    let frames: Vec<Vec<u16>> = (0..n).map(|f| (0..rows * columns).map(|p| code(f, p)).collect()).collect();
    let slices: Vec<&[u16]> = frames.iter().map(|f| &f[..]).collect();
    let layout = Layout::new(&ndarray::Array2::from_elem((rows, columns), true), 4095);
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let mut group = c.benchmark_group("statistics");
    group.throughput(Throughput::Elements((rows * columns * n) as u64)).sample_size(10);
    let mut passes = Vec::new();
    let mut run = || collect_with(&layout, black_box(&slices), &mut passes).unwrap();
    group.bench_function("all", |b| b.iter(&mut run));
    group.bench_function("all_one_core", |b| b.iter(|| one.install(&mut run)));
}

/// Correction of 5-megapixel frames, and a copy of the same number of bytes.
fn correct(c: &mut Criterion) {
    use radcam::calibrate::dark::DarkReference;
    use radcam::calibrate::file::{Calibration, Description};
    use radcam::correct::{Codes, Corrector};
    use radcam::dataset::CameraInfo;
    use rayon::prelude::*;
    let (rows, columns) = (2048, 2448);
    let plane = |from: f32, to: f32| {
        ndarray::Array2::from_shape_fn((rows, columns), |(y, x)| {
            from + (to - from) * ((y * 31 + x * 17) % 997) as f32 / 997.0
        })
    };
    let info = CameraInfo { width: columns, height: rows, bit_depth: 12, ..Default::default() };
    let calibration = Calibration {
        description: Description::of(info),
        dark: DarkReference {
            exposure_s: 0.01,
            level_dn: plane(60.0, 70.0),
            current_dn_per_s: None,
            std_err_dn: 0.1,
            current_std_err_dn_per_s: f64::NAN,
            var_dn2: 1.0,
        },
        k: plane(0.95, 1.05),
        k_std_err: plane(0.001, 0.001),
        defects: ndarray::Array2::zeros((rows, columns)),
    };
    let corrector = Corrector::new(&calibration, 0.01).unwrap();
    let frame: Vec<u16> = (0..rows * columns).map(|p| (p * 31 % 4096) as u16).collect();
    let (mut codes, mut float) = (vec![0u16; frame.len()], vec![0f32; frame.len()]);
    let to = Codes { scale: 12.0, offset: 100.0 };
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let mut group = c.benchmark_group("correct");
    group.throughput(Throughput::Elements(frame.len() as u64));
    let mut to_u16 = || corrector.to_u16(black_box(&frame), to, black_box(&mut codes)).unwrap();
    group.bench_function("to_u16_one_core", |b| b.iter(|| one.install(&mut to_u16)));
    group.bench_function("to_u16", |b| b.iter(&mut to_u16));
    let mut to_f32 = || corrector.to_f32(black_box(&frame), black_box(&mut float)).unwrap();
    group.bench_function("to_f32_one_core", |b| b.iter(|| one.install(&mut to_f32)));
    group.bench_function("to_f32", |b| b.iter(&mut to_f32));
    let bytes: Vec<u8> = frame.iter().flat_map(|d| d.to_le_bytes()).collect();
    let mut arrived = || {
        let format = radcam::pixel_format::PixelFormat::from_name("Mono12").unwrap();
        corrector.arrived_to_u16(format, black_box(&bytes), to, u16::MAX, black_box(&mut codes)).unwrap()
    };
    group.bench_function("arrived_one_core", |b| b.iter(|| one.install(&mut arrived)));
    group.bench_function("arrived", |b| b.iter(&mut arrived));
    // Memory bandwidth: four bytes read and four written per pixel, in the same pieces.
    let source = vec![1.5f32; frame.len()];
    group.bench_function("copy_4_bytes", |b| {
        b.iter(|| {
            let out = black_box(&mut float).par_chunks_mut(65_536);
            out.zip(black_box(&source).par_chunks(65_536)).for_each(|(to, from)| to.copy_from_slice(from));
        });
    });
}

/// K from 20 configurations of 5 megapixels.
fn pattern(c: &mut Criterion) {
    use radcam::calibrate::{joint::joint, pattern::Options, pattern::paper};
    let (rows, columns) = (2048, 2448);
    let images: Vec<ndarray::Array2<f32>> = (0..20)
        .map(|i| {
            ndarray::Array2::from_shape_fn((rows, columns), |(y, x)| {
                1000.0 + ((y * 31 + x * 17 + i * 7) % 101) as f32 * 0.1
            })
        })
        .collect();
    let mut group = c.benchmark_group("pattern");
    group.throughput(Throughput::Elements((rows * columns) as u64)).sample_size(10);
    group.bench_function("paper", |b| b.iter(|| paper(black_box(&images), Options::default()).unwrap()));
    group.bench_function("joint", |b| b.iter(|| joint(black_box(&images)).unwrap()));
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).measurement_time(std::time::Duration::from_secs(3));
    targets = simulate, moments, statistics, correct, pattern
}
criterion_main!(benches);
