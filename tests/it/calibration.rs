//! Sections V to VII through the program and the library: from a pilot to surfaces that are recognised.

use crate::frame_headers::{Drawn, Folder};
use crate::rewritten::Campaign;
use crate::support::{expect, refused, small};
use radcam::bench::{BenchState, Illuminator};
use radcam::calibrate::file::{Calibration, Description};
use radcam::calibrate::pattern::Options;
use radcam::calibrate::{Estimator, of_dataset};
use radcam::camera::corrected::Corrected;
use radcam::camera::{Camera, StreamOptions};
use radcam::correct::{Codes, Corrector};
use radcam::dataset::{CameraInfo, Dataset};
use radcam::frame::Frame;
use radcam::number::Quantity;
use radcam::scene_variation::{Roi, Variation, of_region};
use radcam::surfaces::Library;
use radcam_sim::{Conditions, Model, Scene, Sensor, Texture};
use std::fs;
use std::path::Path;
use std::time::Duration;

/// A small industrial camera before a card of grain and spots and a lamp with a 10 % gradient.
fn hard() -> Model {
    let mut model = small("cmos12", 120, 90);
    model.bench.gradient = 0.10;
    model.bench.card = Texture {
        grain: 0.004,
        grain_length_px: 0.3,
        spot_fraction: 0.02,
        spot_depth: 0.3,
        ..Texture::default()
    };
    model
}

fn write(model: &Model, path: &Path) -> String {
    fs::write(path, model.to_toml().unwrap()).unwrap();
    path.to_str().unwrap().into()
}

/// The residual of K over a part of the frame, both with mean 1.
fn rms(k: &ndarray::Array2<f32>, truth: &ndarray::Array2<f32>, part: impl Fn(usize, usize) -> bool) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for ((at, &k), &t) in k.indexed_iter().zip(truth) {
        if part(at.0, at.1) {
            sum += f64::from(k - t).powi(2);
            n += 1.0;
        }
    }
    (sum / n).sqrt()
}

/// On a simulated sensor with 2 % spots, grain and a 10 % gradient: `joint` reaches 1.1 times the limit
/// (grain and noise over the root of n1), edges included, its errors are true within 5 %, and `paper` stands
/// beside it.
#[test]
fn k_reaches_the_limit_of_card_and_noise() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let model = hard();
    let file = write(&model, &dir.path().join("camera.toml"));
    let (n1, n2) = (16, 12);
    let mut plan = String::from("format = \"radcam-plan/1\"\n");
    for exposure_s in [0.005, 0.5] {
        plan += &format!("[[set]]\nkind = \"dark\"\nframes = 60\nexposure_s = {exposure_s}\n");
    }
    for k in 0..n1 {
        plan += &format!(
            "[[set]]\nkind = \"flat\"\nframes = {n2}\nexposure_s = 0.005\nillumination = 1.0\nconfiguration = {k}\n"
        );
    }
    fs::write(at("plan.toml"), plan).unwrap();
    expect(0, &["simulate", &file, "--plan", &at("plan.toml"), "-o", &at("c")]);
    let dataset = Dataset::open(Path::new(&at("c"))).unwrap();
    let of = |estimator| of_dataset(&dataset, estimator, None, "").unwrap().calibration;
    let (joint, paper) = (of(Estimator::Joint), of(Estimator::Paper(Options::default())));

    let sensor = Sensor::new(model.clone()).unwrap();
    let truth = &sensor.maps().uniformity;
    // What the card's grain looks like after the aperture, from a card without spots and light without shape.
    let mut bare = model.clone();
    (bare.bench.gradient, bare.bench.shading, bare.bench.card.spot_fraction) = (0.0, 0.0, 0.0);
    (bare.base.sigma_k, bare.base.dark_current_spread, bare.base.hot_pixel_fraction) = (0.0, 0.0, 0.0);
    bare.base.offset_spread_dn = 0.0;
    let bare = Sensor::new(bare).unwrap();
    let bright = Conditions { configuration: 1, ..bare.conditions(0.005) };
    let expected = bare.predict(&bright);
    let level = expected.mean_dn.mean().unwrap() - model.base.black_level_dn;
    let grain = expected.mean_dn.std(1.0) / level;
    let noise = (expected.var_dn2.mean().unwrap() / f64::from(n2)).sqrt() / level;
    let dark = joint.dark.std_err_dn / level;
    let limit = ((grain * grain + noise * noise) / f64::from(n1) + dark * dark).sqrt();

    let edge = |y: usize, x: usize| y < 4 || x < 4 || y >= 86 || x >= 116;
    let (all, edges) = (rms(&joint.k, truth, |_, _| true), rms(&joint.k, truth, edge));
    let (of_paper, paper_edges) = (rms(&paper.k, truth, |_, _| true), rms(&paper.k, truth, edge));
    println!(
        "limit {limit:.6}; joint {all:.6}, edges {edges:.6}; paper {of_paper:.6}, edges {paper_edges:.6}"
    );
    assert!(all < 1.1 * limit, "joint {all}, limit {limit}");
    // 1600 pixels of edge: 4 standard errors of a deviation are 7 %.
    assert!(edges < 1.1 * 1.07 * limit, "edges {edges}, limit {limit}");
    assert!(of_paper > all && paper_edges < 1.4 * of_paper, "paper {of_paper}, its edges {paper_edges}");
    let chi2 = |c: &Calibration| {
        let z2 = c.k.iter().zip(&c.k_std_err).zip(truth).map(|((k, e), t)| f64::from((k - t) / e).powi(2));
        z2.sum::<f64>() / truth.len() as f64
    };
    // 10,800 pixels: 0.05 is 3.7 standard errors of the mean of chi-squares.
    assert!((chi2(&joint) - 1.0).abs() < 0.05, "joint: chi-square per pixel {}", chi2(&joint));
    println!("chi-square per pixel: joint {:.3}, paper {:.3}", chi2(&joint), chi2(&paper));
    // The mean over the edges is that of the middle: no bias there. Five standard errors; the windows' hold K
    // itself.
    let bias = |c: &Calibration, pixel: f64| {
        let part = c.k.indexed_iter().zip(truth).filter(|((at, _), _)| edge(at.0, at.1));
        let (sum, n) = part.fold((0.0, 0.0), |(s, n), ((_, k), t)| (s + f64::from(k - t), n + 1.0));
        (sum / n) / (pixel / f64::sqrt(n))
    };
    let (of_joint, of_paper) = (bias(&joint, limit), bias(&paper, limit.hypot(model.base.sigma_k)));
    assert!(of_joint.abs() < 5.0 && of_paper.abs() < 5.0, "{of_joint} {of_paper}");
}

/// A camera, its exact calibration, and its chart of squares under 20-fold light.
struct Chart {
    sensor: Sensor,
    calibration: Calibration,
}

impl Chart {
    fn new() -> Self {
        let mut model = small("cmos12", 330, 220);
        (model.bench.shading, model.bench.gradient) = (0.0, 0.0);
        let sensor = Sensor::new(model).unwrap();
        let model = sensor.model();
        let dark = sensor.predict(&Conditions { illumination: 0.0, ..sensor.conditions(0.005) }).mean_dn;
        let info = CameraInfo { width: 330, height: 220, bit_depth: 12, ..Default::default() };
        let mut description = Description::of(info);
        description.gain_dn_per_e = Some(model.base.gain_dn_per_e);
        description.constant_noise_var_dn2 = Some(model.constant_noise_var_dn2(0.0));
        description.offset_dn = Some(model.base.black_level_dn);
        let calibration = Calibration {
            dark: radcam::calibrate::dark::DarkReference {
                exposure_s: 0.005,
                level_dn: dark.mapv(|d| d as f32),
                current_dn_per_s: None,
                std_err_dn: 0.0,
                current_std_err_dn_per_s: f64::NAN,
                var_dn2: 1.0,
            },
            k: sensor.maps().uniformity.clone(),
            k_std_err: ndarray::Array2::zeros((220, 330)),
            defects: ndarray::Array2::zeros((220, 330)),
            description,
        };
        Self { sensor, calibration }
    }

    /// V_s of every square in one frame, and the raw spatial variance over the squared raw mean above black.
    fn seen(&self, frame: u64, illumination: f64, configuration: u32) -> Vec<(Variation, f64)> {
        let c =
            Conditions { illumination, configuration, scene: Scene::Chart, ..self.sensor.conditions(0.005) };
        let mut dn = ndarray::Array2::zeros((220, 330));
        self.sensor.draw(frame, &c, self.sensor.region(), dn.as_slice_mut().unwrap());
        let corrected = Corrector::new(&self.calibration, 0.005).unwrap().image(&dn).unwrap();
        let model = self.sensor.model();
        (0..6)
            .map(|square| {
                let r = model.bench.square_region(&model.camera, square);
                let [x, y, width, height] = [r.x, r.y, r.width, r.height].map(|v| v as usize);
                let roi = Roi { x, y, width, height };
                let dark = &self.calibration.dark.level_dn;
                let v = of_region(&corrected, 1, dark, &self.calibration, roi).unwrap();
                let raw = dn.slice(ndarray::s![y..y + height, x..x + width]).mapv(f64::from);
                let mean = raw.mean().unwrap() - model.base.black_level_dn;
                (v, raw.var(1.0) / (mean * mean))
            })
            .collect()
    }
}

/// V_s of every square is the same from 1 to 20 in light, within its stated error, and it is the chart's own;
/// raw spatial variance is not.
#[test]
fn scene_variation_does_not_depend_on_the_light() {
    let chart = Chart::new();
    let levels = [0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0];
    let seen: Vec<_> = levels.iter().enumerate().map(|(i, l)| chart.seen(i as u64, *l, 0)).collect();
    let (mut chi2, mut dof) = (0.0, 0.0);
    println!("{:<12} {:>22} {:>10} {:>22}", "square", "V_s at 0.05 and 1", "", "raw at 0.05 and 1");
    for square in 0..6 {
        let all: Vec<_> = seen.iter().map(|s| &s[square].0).collect();
        let weight = |v: &Variation| v.repeat_std_err.powi(-2);
        let sum: f64 = all.iter().map(|v| weight(v)).sum();
        let mean = all.iter().map(|v| weight(v) * v.scene_variation.value).sum::<f64>() / sum;
        for v in &all {
            let z = (v.scene_variation.value - mean) / v.repeat_std_err;
            assert!(z.abs() < 5.0, "square {square}: {z}");
            chi2 += z * z;
        }
        dof += all.len() as f64 - 1.0;
        // Against the chart itself: the light that the pixels get, without any noise.
        let model = chart.sensor.model();
        let c = Conditions { scene: Scene::Chart, ..chart.sensor.conditions(0.005) };
        let light = chart.sensor.predict(&c).mean_dn - &chart.calibration.dark.level_dn.mapv(f64::from);
        let light = light / &chart.sensor.maps().uniformity.mapv(f64::from);
        let r = model.bench.square_region(&model.camera, square);
        let (x, y) = (r.x as usize, r.y as usize);
        let part = light.slice(ndarray::s![y..y + r.height as usize, x..x + r.width as usize]).to_owned();
        let truth = part.var(1.0) / part.mean().unwrap().powi(2);
        assert!(
            (mean - truth).abs() < 5.0 / sum.sqrt() + 1e-3 * truth,
            "square {square}: {mean}, truth {truth}"
        );
        let raw = |level: usize| seen[level][square].1;
        let name = &model.bench.chart[square].name;
        let (low, high) = (all[0].scene_variation.value, all[6].scene_variation.value);
        println!("{name:<12} {low:>11.3e} {high:>10.3e} {:>10} {:>11.3e} {:>10.3e}", "", raw(0), raw(6));
    }
    // 36 degrees of freedom: four standard deviations.
    assert!((chi2 - dof).abs() < 4.0 * f64::sqrt(2.0 * dof), "chi-square {chi2} for {dof}");
}

/// Squares whose V_s differ by five standard errors or more are told apart in 99 of 100 draws, at light
/// levels drawn between 1 and 20; with the raw variance over the squared mean in the place of V_s most
/// answers are wrong.
#[test]
fn surfaces_are_recognised_whatever_the_light() {
    let chart = Chart::new();
    let (mut library, mut raw_library) = (Library::default(), Library::default());
    let names: Vec<_> = chart.sensor.model().bench.chart.iter().map(|s| s.name.clone()).collect();
    let quantity = |value, std_err| Quantity::new(value, std_err, "1");
    // Learnt in half light, from four positions of the chart.
    for configuration in 0..4 {
        for (name, (v, raw)) in
            names.iter().zip(chart.seen(900 + u64::from(configuration), 0.5, configuration))
        {
            let region = format!("{name} {configuration}");
            library.learn(name, &v.scene_variation, &region).unwrap();
            let raw = quantity(raw, raw * v.scene_variation.std_err / v.scene_variation.value);
            raw_library.learn(name, &raw, &region).unwrap();
        }
    }
    let (mut right, mut right_raw, mut draws) = (0, 0, 0);
    for draw in 0..80u32 {
        // Equal steps of the logarithm of the light, in mixed order; every draw shows the chart at a new
        // place.
        let illumination = 0.05 * 20f64.powf(f64::from(draw * 37 % 80) / 79.0);
        let seen = chart.seen(2000 + u64::from(draw), illumination, 10 + draw);
        for (square, (v, raw)) in seen.iter().enumerate() {
            let apart = |s: &radcam::surfaces::Surface| {
                (s.scene_variation - library.surfaces[square].scene_variation).abs()
                    / v.scene_variation.std_err
            };
            let others = library.surfaces.iter().enumerate().filter(|(i, _)| *i != square);
            if others.map(|(_, s)| apart(s)).fold(f64::INFINITY, f64::min) < 5.0 {
                continue;
            }
            draws += 1;
            let relative = v.scene_variation.std_err / v.scene_variation.value;
            let is = |answer: Option<String>| usize::from(answer.as_ref() == Some(&names[square]));
            right += is(library.identify(&v.scene_variation).surface);
            right_raw += is(raw_library.identify(&quantity(*raw, raw * relative)).surface);
        }
    }
    println!("of {draws} draws: {right} right by V_s, {right_raw} by the raw variance");
    assert!(draws >= 200, "{draws}");
    assert!(right * 100 >= 99 * draws, "{right} of {draws}");
    assert!(right_raw * 100 < 60 * draws, "the raw variance: {right_raw} of {draws}");
}

/// A pilot says what a calibration needs; its plan is captured, calibrated, and the verbs of Section VI use
/// the result.
#[test]
fn from_a_pilot_to_a_named_surface() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let mut model = small("xc77", 192, 128);
    // Eight bits and a smooth card: a short campaign.
    model.bench.card.grain = 0.001;
    let file = write(&model, &dir.path().join("camera.toml"));
    let camera = format!("sim:{file}");
    let arguments = [
        "plan-calibration",
        "--camera",
        &camera,
        "--pilot-folder",
        &at("pilot"),
        "-o",
        &at("plan.toml"),
        "--json",
    ];
    let json: serde_json::Value = serde_json::from_str(&expect(0, &arguments)).unwrap();
    let n2 = json["n2"].as_u64().unwrap();
    // The paper: 18; A is known to a few per cent from the pilot.
    assert!((17..=20).contains(&n2) && json["n1"].as_u64().unwrap() >= 3, "{json}");
    let again = ["plan-calibration", &at("pilot"), "-o", &at("plan.toml")];
    assert!(refused(&again).contains("--overwrite"));
    let said = expect(0, &[&again[..], &["--overwrite"]].concat());
    assert!(said.contains("n1 = ") && said.contains("q^2/9"), "{said}");

    expect(0, &["capture", "--camera", &camera, "--plan", &at("plan.toml"), "-o", &at("c")]);
    let said = expect(0, &["calibrate", &at("c"), "-o", &at("cal.tiff")]);
    assert!(said.contains("defects"), "{said}");
    let cal = Calibration::read(at("cal.tiff").as_ref()).unwrap();
    let a = cal.description.gain_dn_per_e.unwrap();
    assert!((a / 0.003384 - 1.0).abs() < 0.1 && cal.description.noise_covariance.is_some());

    // The chart, in bright and in dim light.
    let exposure_s = cal.dark.exposure_s;
    let sets: String = [1.0, 0.15]
        .map(|light| {
            format!(
                "[[set]]\nkind = \"target\"\nframes = 4\nexposure_s = {exposure_s}\nillumination = {light}\n"
            )
        })
        .concat();
    fs::write(at("target.toml"), format!("format = \"radcam-plan/1\"\n{sets}")).unwrap();
    expect(0, &["simulate", &file, "--plan", &at("target.toml"), "-o", &at("t")]);
    let frame = |i: usize| at(&format!("t/frames/{i:05}.tiff"));
    let roi = |square: usize| {
        let r = model.bench.square_region(&model.camera, square);
        format!("{},{},{},{}", r.x, r.y, r.width, r.height)
    };
    for (square, name) in [(0, "white"), (1, "rough"), (4, "middle")] {
        let said = expect(
            0,
            &[
                "surface",
                "learn",
                &at("s.toml"),
                "--name",
                name,
                &at("cal.tiff"),
                &frame(0),
                "--roi",
                &roi(square),
            ],
        );
        assert!(said.contains("V_s"), "{said}");
    }
    let identify = |square: usize, code: i32| {
        let dim = [frame(4), frame(5), frame(6), frame(7)];
        let fixed =
            ["surface", "identify", &at("s.toml"), &at("cal.tiff"), &dim[0], &dim[1], &dim[2], &dim[3]];
        expect(code, &[&fixed[..], &["--roi", &roi(square), "--json"]].concat())
    };
    assert!(identify(1, 0).contains("\"surface\": \"rough\""), "{}", identify(1, 0));
    // The roughest square is none of those learnt.
    assert!(identify(5, 1).contains("\"surface\": null"));
    let said = expect(
        0,
        &[
            "scene",
            &at("cal.tiff"),
            &frame(0),
            "--roi",
            &roi(1),
            "--map",
            "20",
            "--map-output",
            &at("m.tiff"),
        ],
    );
    assert!(said.contains("scene variation V_s  0.0"), "{said}");
    assert!(Path::new(&at("m.tiff")).exists());
    let budget = expect(
        0,
        &["budget", &at("cal.tiff"), &frame(0), "--roi", &roi(1), "--json", "--report", &at("b.html")],
    );
    let budget: serde_json::Value = serde_json::from_str(&budget).unwrap();
    let top = budget["levels"].as_array().unwrap().last().unwrap();
    assert!(top["scene_dn2"].as_f64().unwrap() > 0.5 * top["total_dn2"].as_f64().unwrap());

    // What is refused.
    for (arguments, part) in [
        (
            vec!["scene", &at("cal.tiff"), &frame(0), "--roi", "180,0,30,30"],
            "leaves the image of 192 x 128 px",
        ),
        (vec!["scene", &at("cal.tiff"), &frame(0), "--roi", "0,0,5,30"], "too small"),
        (vec!["scene", &at("cal.tiff"), &frame(0), "--roi", "0,0,5"], "x,y,width,height"),
        (vec!["surface", "identify", &at("none.toml"), &at("cal.tiff"), &frame(0)], "none.toml"),
        (vec!["plan-calibration", "-o", &at("p.toml")], "PILOT"),
        (vec!["scene", &at("plan.toml"), &frame(0)], "plan.toml"),
    ] {
        assert!(refused(&arguments).contains(part), "{arguments:?}: {}", refused(&arguments));
    }
    // One configuration, said plainly.
    let said = expect(0, &["calibrate", &at("pilot"), "-o", &at("one.tiff"), "--estimator", "smooth"]);
    assert!(said.contains("K contains the card"), "{said}");
    assert!(refused(&["scene", &at("one.tiff"), &at("t/frames.csv")]).contains("frames.csv"));
}

/// A corrected camera is a camera: its frames are the raw ones corrected, and what does not hold is refused
/// and undone.
#[test]
fn a_corrected_camera_is_a_camera() {
    let chart = Chart::new();
    let (mut camera, mut bench) = crate::support::camera(chart.sensor.model().clone());
    camera.set_exposure_s(0.005).unwrap();
    bench.apply(&BenchState { illumination: 0.6, ..Default::default() }, &mut camera).unwrap();
    let mut raw = Frame::new(0, 0);
    camera.stream(&StreamOptions::default()).unwrap().next(&mut raw, Duration::from_secs(1)).unwrap();
    camera.continue_after(0, 0.0);
    let codes = Codes { scale: 8.0, offset: 512.0 };
    let mut calibration = chart.calibration.clone();
    calibration.description.camera.gain_db = Some(0.0);
    calibration.defects[(5, 5)] = radcam::calibrate::defects::HOT;
    let mut corrected = Corrected::new(camera, calibration.clone(), codes).unwrap().replacing_defects();
    let mut frame = Frame::new(0, 0);
    corrected.stream(&StreamOptions::default()).unwrap().next(&mut frame, Duration::from_secs(1)).unwrap();
    let corrector = Corrector::new(&calibration, 0.005).unwrap().replacing_defects(&calibration);
    let mut expected = vec![0; 330 * 220];
    corrector.to_u16(raw.pixels.as_slice().unwrap(), codes, &mut expected).unwrap();
    assert_eq!(frame.pixels.as_slice().unwrap(), expected);
    let message = corrected.set_gain_db(6.0).unwrap_err().to_string();
    assert!(message.contains("gain is 6 dB, and was 0 dB"), "{message}");
    assert_eq!(corrected.settings().unwrap().gain_db, Some(0.0));
    let message = corrected.set_exposure_s(0.01).unwrap_err().to_string();
    assert!(message.contains("0.005 s") && message.contains("0.01 s"), "{message}");
    assert_eq!(corrected.settings().unwrap().exposure_s, 0.005);
    let (other, _) = crate::support::camera(small("cmos12", 64, 48));
    let message = Corrected::new(other, calibration, codes).unwrap_err().to_string();
    assert!(message.contains("size is 64 x 48 px, and was 330 x 220 px"), "{message}");
}

/// Section VII again, in brief: two cameras instead of fifty. (`radcam reproduce` itself runs fifty.)
#[test]
fn the_paper_is_reproduced() {
    let dir = tempfile::tempdir().unwrap();
    let page = dir.path().join("r.html");
    let out =
        crate::support::radcam(&["reproduce", "--seeds", "2", "--json", "--report", page.to_str().unwrap()]);
    let json: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let rows = json["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 17);
    for row in rows {
        let (paper, ours) = (row["paper"].as_f64(), row["ours"].as_f64().unwrap());
        // Two cameras do not tell their own scatter: a wide net, by the scatter that fifty have.
        let Some(paper) = paper else { continue };
        let allowed = match row["quantity"].as_str().unwrap() {
            q if q.starts_with("A (") => 4e-4,
            q if q.starts_with("sigma_C^2 (") => 0.05,
            q if q.starts_with("chi-square") || q.starts_with("largest") => 9.0,
            q if q.starts_with("Q of") => 1.0,
            q if q.starts_with("Q(") => 1e-4,
            q if q.starts_with("n") => 3.0,
            q if q.starts_with("K, mean") => 5e-5,
            q if q.starts_with("K, standard") => 2e-5,
            q if q.starts_with("pixels") => 0.6,
            q if q.starts_with("dark reference, mean") => 0.01,
            q if q.starts_with("dark reference") => 3e-3,
            _ => 2.0,
        };
        assert!((paper - ours).abs() < allowed, "{row}");
    }
    assert!(fs::read_to_string(page).unwrap().matches("<svg").count() == 4);
}

/// A colour mosaic: light that its filters pass to 45, 100, 100 and 30 % gives each plane a K of mean 1 that
/// is the sensor's own, frames are corrected plane by plane, and a defect is replaced by its own colour.
#[test]
fn a_mosaic_is_calibrated_plane_by_plane() {
    use radcam::dataset::{CameraInfo, Dataset, FrameRow, Kind, Manifest, Writer};
    use radcam_sim::Conditions;
    let (height, width) = (96usize, 128usize);
    let mut model = crate::support::small("cmos12", width as u32, height as u32);
    model.base.hot_pixel_fraction = 0.0;
    let sensor = radcam_sim::Sensor::new(model).unwrap();
    let filters = [[0.45, 1.0], [1.0, 0.30]];
    let camera =
        CameraInfo { width, height, bit_depth: 12, pixel_format: "BayerRG12".into(), ..Default::default() };
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("d");
    let mut writer = Writer::create(&root, &Manifest::new(camera), &[]).unwrap();
    let exposure_s = 0.02;
    let mut number = 0;
    let mut frame = |kind: Kind, configuration: u32, exposure_s: f64| {
        let mut out = radcam::ndarray::Array2::<u16>::zeros((height, width));
        number += 1;
        for (y, row) in filters.iter().enumerate() {
            for (x, pass) in row.iter().enumerate() {
                let illumination = if kind == Kind::Dark { 0.0 } else { 0.8 * pass };
                let conditions = Conditions { illumination, configuration, ..sensor.conditions(exposure_s) };
                let mut dn = vec![0; width * height];
                sensor.draw(number, &conditions, sensor.region(), &mut dn);
                let whole = radcam::ndarray::Array2::from_shape_vec((height, width), dn).unwrap();
                let plane = radcam::ndarray::s![y..;2, x..;2];
                out.slice_mut(plane).assign(&whole.slice(plane));
            }
        }
        out
    };
    let mut set = 0;
    let mut take =
        |kind, configuration, exposure_s, frames: u32, frame: &mut dyn FnMut(Kind, u32, f64) -> _| {
            for index in 0..frames {
                let row = FrameRow {
                    file: String::new(),
                    kind,
                    set,
                    index,
                    exposure_s,
                    illumination: if kind == Kind::Dark { 0.0 } else { 0.8 },
                    configuration,
                    temperature_c: None,
                    timestamp_s: None,
                };
                let pixels: radcam::ndarray::Array2<u16> = frame(kind, configuration, exposure_s);
                writer.append(row, &pixels).unwrap();
            }
            set += 1;
        };
    for dark_s in [exposure_s, 10.0 * exposure_s] {
        take(Kind::Dark, 0, dark_s, 20, &mut frame);
    }
    for configuration in 0..8 {
        take(Kind::Flat, configuration, exposure_s, 20, &mut frame);
    }
    let dataset = Dataset::open(&root).unwrap();
    let made =
        radcam::calibrate::of_dataset(&dataset, radcam::calibrate::Estimator::Joint, None, "test").unwrap();
    let mut calibration = made.calibration;
    assert!(calibration.description.estimator.contains("plane of the colour mosaic"));
    // The sensor's own K, to the stated errors: a mosaic taken as one image would be off by tens of per cent.
    let truth = sensor.maps().uniformity.mapv(f64::from);
    let mut z: f64 = 0.0;
    for (y, x) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let plane = radcam::ndarray::s![y..;2, x..;2];
        let (k, error) = (calibration.k.slice(plane), calibration.k_std_err.slice(plane));
        assert!((k.mean().unwrap() - 1.0).abs() < 1e-5);
        let own = truth.slice(plane);
        let mean = own.mean().unwrap();
        let sum: f64 = k
            .iter()
            .zip(error)
            .zip(own)
            .map(|((k, e), t)| ((f64::from(*k) - t / mean) / f64::from(*e)).powi(2))
            .sum();
        z += sum / k.len() as f64 / 4.0;
    }
    // Mean square of 12 288 standardised differences: 1 with an error of 0.013; the biweight's own errors are
    // stated to some per cent.
    assert!((z - 1.0).abs() < 0.25, "{z}");
    // A defect in a blue pixel is replaced by blue ones.
    calibration.defects[(11, 21)] = 1;
    let corrector =
        radcam::correct::Corrector::new(&calibration, exposure_s).unwrap().replacing_defects(&calibration);
    let corrected = corrector.image(&frame(Kind::Flat, 0, exposure_s)).unwrap();
    let blue = corrected.slice(radcam::ndarray::s![1..;2, 1..;2]).mean().unwrap();
    assert!((corrected[(11, 21)] / blue - 1.0).abs() < 0.15, "{} of {blue}", corrected[(11, 21)]);
}

/// One frame of each level tells no noise, and so no error of K: `calibrate` asks for more.
#[test]
fn single_frames_of_unknown_gain_make_no_calibration() {
    let mut campaign = Campaign::new("cmos12", "standard", 41);
    let kept: Vec<usize> = ["dark", "flat"]
        .into_iter()
        .flat_map(|kind| campaign.sets(kind, 1))
        .filter_map(|set| campaign.of(set).first().copied())
        .collect();
    campaign.rows = kept.iter().map(|row| campaign.rows[*row].clone()).collect();
    campaign.save();
    let out = campaign.dir.path().join("k.tiff");
    let error =
        refused(&["calibrate", &campaign.path(), "--estimator", "smooth", "-o", out.to_str().unwrap()]);
    assert!(error.contains("has one frame") && error.contains("two frames or more"), "{error}");
    assert!(!out.exists());
}

/// A line that leaves less than no noise is refused by that, and not by the reader of the file.
#[test]
fn constant_noise_below_zero_makes_no_calibration() {
    let campaign = Campaign::new("cmos12", "standard", 42);
    let dataset = Dataset::open(Path::new(&campaign.path())).unwrap();
    let stop = std::sync::atomic::AtomicBool::new(false);
    let mut noise = radcam::noise::of_dataset(&dataset, &stop, &mut |_, _| {}).unwrap();
    noise.constant_noise_var_dn2.value = -10.0 * noise.constant_noise_var_dn2.std_err;
    let made = radcam::calibrate::of_dataset(&dataset, Estimator::Smooth, Some(&noise), "");
    let error = made.err().unwrap().to_string();
    assert!(error.contains("no noise is below 0"), "{error}");
    // Within its errors it is 0.
    noise.constant_noise_var_dn2.value = -noise.constant_noise_var_dn2.std_err;
    let made = radcam::calibrate::of_dataset(&dataset, Estimator::Smooth, Some(&noise), "").unwrap();
    assert_eq!(made.calibration.description.constant_noise_var_dn2, Some(0.0));
}

/// Six configurations of a card with stripes of 1.2 %: moved, the stripes are no part of K; left where it
/// was, they are, and it is said. Nothing tells that from an even card.
#[test]
fn a_card_that_was_not_moved_is_said() {
    for (moved, seed) in [(7.0, 299), (0.0, 300)] {
        let (folder, mut camera) = (Folder::new(), Drawn::new(seed, 20.0));
        std::fs::create_dir(folder.path("in")).unwrap();
        let mut take = |kind: &str, configuration: u32, light_e: f64| {
            for i in 0..6 {
                let card = |_: usize, x: usize| {
                    (1.0 + 0.012 * ((x as f64 + moved * f64::from(configuration)) / 3.0).sin(), 1.0)
                };
                let image = camera.frame_of(light_e, 0.01, card);
                let name = format!("in/config{configuration}_{kind}_10ms_{i}.tif");
                std::fs::write(folder.path(&name), radcam::dataset::image::tiff_bytes(&image, 12).unwrap())
                    .unwrap();
            }
        };
        (0..6).for_each(|configuration| take("flat", configuration, 7000.0));
        take("dark", 0, 0.0);
        let (data, cal) = (folder.text("d"), folder.text("cal.tiff"));
        expect(0, &["import", &folder.text("in"), "-o", &data, "--yes"]);
        let said: serde_json::Value =
            serde_json::from_str(&expect(0, &["calibrate", &data, "-o", &cal, "--json"])).unwrap();
        assert_eq!(said["n1"], 6, "{said}");
        assert_eq!(said["has_card"], moved == 0.0, "{said}");
        let said = expect(0, &["calibrate", &data, "-o", &folder.text("again.tiff")]);
        assert_eq!(said.contains("K contains the card"), moved == 0.0, "{said}");
    }
}

/// Two of eighty columns stuck at full scale are defects, and no flats that are too bright.
#[test]
fn stuck_columns_do_not_stop_a_calibration() {
    let (folder, mut camera) = (Folder::new(), Drawn::new(302, 20.0));
    std::fs::create_dir(folder.path("in")).unwrap();
    let mut take = |name: &str, light_e: f64| {
        let mut image = camera.frame(light_e, 0.01);
        [31, 57].into_iter().for_each(|x| image.column_mut(x).fill(4095));
        std::fs::write(folder.path(name), radcam::dataset::image::tiff_bytes(&image, 12).unwrap()).unwrap();
    };
    for i in 0..8 {
        (0..4).for_each(|c| take(&format!("in/config{c}_flat_10ms_{i}.tif"), 6000.0));
        take(&format!("in/dark_10ms_{i}.tif"), 0.0);
    }
    let (data, cal) = (folder.text("d"), folder.text("cal.tiff"));
    expect(0, &["import", &folder.text("in"), "-o", &data, "--yes"]);
    let said: serde_json::Value =
        serde_json::from_str(&expect(0, &["calibrate", &data, "-o", &cal, "--json"])).unwrap();
    assert!(said["defects"].as_u64().unwrap() >= 128, "{said}");
    let calibration = Calibration::read(&folder.path("cal.tiff")).unwrap();
    assert!([31, 57].iter().all(|x| calibration.defects.column(*x).iter().all(|flags| *flags != 0)));
    // The black level of 100 DN, without the stuck columns.
    let said = expect(0, &["calibrate", &data, "-o", &folder.text("again.tiff")]);
    assert!(said.contains("dark reference   100."), "{said}");
}
