//! The real program: what it prints, its exit codes, and what it says of bad input.

use crate::support::{expect, radcam, refused};
use std::fs;
use std::path::Path;

fn simulate(root: &Path) {
    let root = root.to_str().unwrap();
    let out = expect(0, &["simulate", "cmos12", "--plan", "quick", "--region", "0,0,64,48", "-o", root]);
    assert!(out.contains("40 frames written"), "{out}");
}

#[test]
fn a_simulated_camera_is_measured() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    simulate(&root);
    let page = dir.path().join("r.html");
    let (root, page) = (root.to_str().unwrap(), page.to_str().unwrap());
    let json: serde_json::Value =
        serde_json::from_str(&expect(0, &["noise", root, "--json", "--report", page])).unwrap();
    // The names of the contract.
    for name in ["gain_dn_per_e", "constant_noise_var_dn2", "offset_dn"] {
        for part in ["value", "std_err"] {
            assert!(json[name][part].is_number(), "{name}.{part}");
        }
        assert!(json[name]["unit"].is_string());
    }
    assert!(json["chi2"].is_number() && json["dof"].is_number() && json["q"].is_number());
    let level = &json["levels"][0];
    for name in ["set", "mean_dn", "var_dn2", "var_std_err_dn2", "used", "excluded_because"] {
        assert!(level.get(name).is_some(), "{name}");
    }
    let gain = json["gain_dn_per_e"]["value"].as_f64().unwrap();
    let error = json["gain_dn_per_e"]["std_err"].as_f64().unwrap();
    assert!((gain - 0.38).abs() < 5.0 * error, "{gain} +- {error}");
    let html = fs::read_to_string(page).unwrap();
    assert!(html.contains("<svg") && html.contains("</html>"));
    let text = expect(0, &["noise", root]);
    for method in ["paper", "reweighted", "likelihood"] {
        assert!(text.contains(method), "{text}");
    }
}

/// A real table that no line describes: the answer is a disagreement, not a failure.
#[test]
fn a_table_of_a_real_sensor_is_read() {
    let Some(real) = crate::support::shared("real/lsst_r03_s11_c06_ptc.csv") else { return };
    let json: serde_json::Value =
        serde_json::from_str(&expect(1, &["noise", real.to_str().unwrap(), "--json"])).unwrap();
    // Published gain of this amplifier: about 1.5 electrons per ADU.
    let gain = json["gain_dn_per_e"]["value"].as_f64().unwrap();
    assert!((0.5..0.8).contains(&gain), "{gain}");
    let excluded = json["levels"].as_array().unwrap().iter().filter(|l| !l["used"].as_bool().unwrap());
    assert!(excluded.clone().count() > 0);
    assert!(excluded.clone().any(|l| l["excluded_because"].as_str().unwrap().contains("peak")));
}

#[test]
fn the_reference_tools_descriptor_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    simulate(&root);
    let dataset = radcam::dataset::Dataset::open(&root).unwrap();
    let mut text = String::from("v 3.0\nn 12 64 48\n");
    for set in dataset.sets() {
        let row = dataset.settings(set);
        let ns = row.exposure_s * 1e9;
        text += &match row.kind {
            radcam::dataset::Kind::Dark => format!("d {ns:.1}\n"),
            _ => format!("b {ns:.1} {:.3}\n", row.illumination * row.exposure_s * 7e5),
        };
        for &i in &set.rows {
            text += &format!("i c\\{}\n", dataset.rows()[i].file.replace('/', "\\"));
        }
    }
    let descriptor = dir.path().join("EMVA1288_Data.txt");
    fs::write(&descriptor, text).unwrap();
    let of = |path: &Path| {
        let out = expect(0, &["noise", path.to_str().unwrap(), "--json"]);
        serde_json::from_str::<serde_json::Value>(&out).unwrap()["gain_dn_per_e"]["value"].as_f64().unwrap()
    };
    assert!((of(&descriptor) / of(&root) - 1.0).abs() < 1e-9);
}

#[test]
fn bad_input_is_named_and_ends_with_2() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    simulate(&root);
    let path = root.to_str().unwrap();
    let noise = || refused(&["noise", path]);
    let change = |file: &str, change: &dyn Fn(Vec<u8>) -> Vec<u8>, parts: &[&str]| {
        let file = root.join(file);
        let good = fs::read(&file).unwrap();
        fs::write(&file, change(good.clone())).unwrap();
        let said = noise();
        for part in parts {
            assert!(said.contains(part), "{part:?} is not in {said:?}");
        }
        fs::write(&file, good).unwrap();
    };
    let text = |f: fn(String) -> String| move |b: Vec<u8>| f(String::from_utf8(b).unwrap()).into_bytes();

    // Frames: cut short, rubbish, of another size.
    change("frames/00007.tiff", &|b| b[..200].to_vec(), &["frames/00007.tiff", "set 1", "index 3", "TIFF"]);
    change("frames/00007.tiff", &|_| b"not an image".to_vec(), &["frames/00007.tiff"]);
    change("dataset.toml", &text(|t| t.replace("width = 64", "width = 63")), &["64 x 48 px", "63 x 48 px"]);
    change(
        "dataset.toml",
        &text(|t| t.replace("bit_depth = 12", "bit_depth = 8")),
        &["bit_depth = 8", "255 DN"],
    );
    change("dataset.toml", &text(|t| t.replace("dataset/1", "dataset/2")), &["radcam-dataset/2"]);
    change("dataset.toml", &|_| b"[[".to_vec(), &["dataset.toml"]);
    // Rows.
    change("frames.csv", &text(|t| t.replace("exposure_s", "exposure")), &["frames.csv", "line 1", "header"]);
    change("frames.csv", &text(|t| t.replacen("flat", "flt", 1)), &["frames.csv, line 10", "flt"]);
    change("frames.csv", &text(|t| t.clone() + t.lines().nth(1).unwrap()), &["line 42", "00000.tiff"]);
    change("frames.csv", &text(|t| t.replacen("frames/", "../frames/", 1)), &["line 2", "inside"]);
    change(
        "frames.csv",
        &text(|t| t.lines().take(9).map(|l| format!("{l}\n")).collect()),
        &["two levels, one of them lit"],
    );
    fs::remove_file(root.join("frames/00012.tiff")).unwrap();
    let said = noise();
    assert!(said.contains("frames/00012.tiff") && said.contains("No such file"), "{said}");

    let nowhere = dir.path().join("nowhere");
    // Settings that no camera has.
    for (settings, part) in [
        ("[camera.features]\nDeviceTemperature = 1e300", "DeviceTemperature = 1"),
        ("[camera.features]\nDeviceTemperature = nan", "DeviceTemperature"),
        ("[camera]\ngain_db = 99.0", "Gain = 99 dB lies outside 0 to 24 dB"),
        ("[camera]\npixel_format = \"RGB8\"", "RGB8"),
    ] {
        let plan = dir.path().join("plan.toml");
        let set = "[[set]]\nkind = \"dark\"\nframes = 2\nexposure_s = 0.01\n";
        fs::write(&plan, format!("format = \"radcam-plan/1\"\n{settings}\n{set}")).unwrap();
        let said = refused(&[
            "simulate",
            "cmos12",
            "--plan",
            plan.to_str().unwrap(),
            "-o",
            nowhere.to_str().unwrap(),
        ]);
        assert!(said.contains(part), "{said}");
    }
    // A file that is no dataset, and one whose header claims more than there is.
    let image = root.join("frames/00001.tiff");
    assert!(refused(&["diagnose", image.to_str().unwrap()]).contains("an image or another binary file"));
    let descriptor = dir.path().join("e.txt");
    for (size, part) in [("4000000000 4000000000", "4000000000 px"), ("60000 60000", "no frames")] {
        fs::write(&descriptor, format!("v 3.0\nn 12 {size}\n")).unwrap();
        let said = refused(&["diagnose", descriptor.to_str().unwrap()]);
        assert!(said.contains(part), "{said}");
    }
    // What cannot be written is told before anything is computed, and once.
    let report = dir.path().join("no/folder/x.html");
    let said = refused(&["diagnose", path, "--report", report.to_str().unwrap()]);
    assert!(said.contains("x.html cannot be written") && said.matches("No such file").count() == 1, "{said}");
    assert!(refused(&["compare", path, "--report", path]).contains("is a folder"));
    // Names that are nearly right.
    for (wrong, right) in [("image_lag", "image-lag"), ("Row Noise", "row-noise"), ("blomming", "blooming")] {
        let said = refused(&["effects", wrong]);
        assert!(said.contains(&format!("is it {right}")), "{said}");
    }
    assert!(refused(&["effects", "entropy"]).contains("lists them"));
    for value in ["-1", "nan", "0"] {
        let given = format!("--full-exposure-s={value}");
        let said = refused(&["capture", "--camera", "sim:xc77", &given, "-o", nowhere.to_str().unwrap()]);
        assert!(said.contains("above 0"), "{said}");
    }
    assert!(refused(&["noise", nowhere.to_str().unwrap()]).contains("nowhere"));
    assert!(refused(&["noise", path, "--jsn"]).contains("--json"));
    assert!(refused(&["simulate", "xc78", "-o", path]).contains("xc77, cmos12, ccd16"));
    assert!(refused(&["simulate", "xc77", "--plan", "long", "-o", path]).contains("quick, standard"));
    assert!(refused(&["simulate", "cmos12", "-o", path]).contains("not empty"));
    assert!(refused(&["capture", "--camera", "webcam", "-o", path]).contains("sim:SENSOR"));
    let region = refused(&["simulate", "cmos12", "--region", "0,0,9999,8", "-o", nowhere.to_str().unwrap()]);
    assert!(region.contains("9999 px") && region.contains("1024 px"), "{region}");
    assert!(!nowhere.exists());
}

/// Levels that say nothing are shown with the reason; nothing is left out in silence.
#[test]
fn saturated_and_single_frames_are_shown() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    let plan = dir.path().join("plan.toml");
    let set = |kind, frames, exposure_s, light| {
        format!(
            "[[set]]\nkind = \"{kind}\"\nframes = {frames}\nexposure_s = {exposure_s}\nillumination = {light}\n"
        )
    };
    let sets = [
        set("dark", 3, "0.01", "0.0"),
        set("flat", 3, "0.005", "1.0"),
        set("flat", 3, "0.01", "1.0"),
        set("flat", 3, "2.0", "1.0"),
        set("flat", 1, "0.008", "1.0"),
    ];
    fs::write(&plan, format!("format = \"radcam-plan/1\"\n{}", sets.concat())).unwrap();
    let path = root.to_str().unwrap();
    expect(0, &["simulate", "cmos12", "--plan", plan.to_str().unwrap(), "--region", "0,0,64,48", "-o", path]);
    let json: serde_json::Value = serde_json::from_str(&expect(0, &["noise", path, "--json"])).unwrap();
    let because = |i: usize| json["levels"][i]["excluded_because"].as_str().unwrap_or_default().to_string();
    assert_eq!(json["levels"].as_array().unwrap().len(), 5);
    assert!(because(3).contains("clipped") && because(4).contains("one frame"), "{json}");
    assert!(json["notes"].to_string().contains("darks of one exposure"), "{json}");
    // A report beside the caller, by its bare name.
    let status = std::process::Command::new(env!("CARGO_BIN_EXE_radcam"))
        .args(["noise", path, "--report", "r.html"])
        .current_dir(dir.path())
        .output()
        .unwrap()
        .status;
    assert!(status.success() && dir.path().join("r.html").exists());
    let log = fs::read_to_string(root.join("capture.log")).unwrap();
    assert!(log.contains("completed 13 failures 0 underruns 0 missing 0 written 13 outcome done"), "{log}");
}

/// The paper's camera has no black level and much dark current: the zero lies far below its darks.
#[test]
fn the_papers_camera_is_measured_with_the_quick_plan() {
    let dir = tempfile::tempdir().unwrap();
    for seed in ["1", "2", "3"] {
        let root = dir.path().join(seed);
        let path = root.to_str().unwrap();
        let region = ["--region", "0,0,200,160"];
        expect(
            0,
            &[&["simulate", "xc77", "--plan", "quick", "--seed", seed, "-o", path], &region[..]].concat(),
        );
        let json: serde_json::Value = serde_json::from_str(&expect(0, &["noise", path, "--json"])).unwrap();
        for (name, truth) in
            [("constant_noise_var_dn2", 1.1196), ("gain_dn_per_e", 0.003384), ("offset_dn", 0.0)]
        {
            let (value, error) =
                (json[name]["value"].as_f64().unwrap(), json[name]["std_err"].as_f64().unwrap());
            assert!((value - truth).abs() < 4.0 * error, "seed {seed}: {name} {value} +- {error}");
        }
    }
}

/// From a campaign of several configurations to a calibration file and corrected frames.
#[test]
fn a_camera_is_calibrated_and_its_frames_corrected() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let mut plan = String::from("format = \"radcam-plan/1\"\n[camera]\nregion = [400, 300, 96, 80]\n");
    for exposure_s in [0.005, 0.5] {
        plan += &format!("[[set]]\nkind = \"dark\"\nframes = 12\nexposure_s = {exposure_s}\n");
    }
    for k in 0..12 {
        plan += &format!(
            "[[set]]\nkind = \"flat\"\nframes = 12\nexposure_s = 0.005\nillumination = 1.0\nconfiguration = {k}\n"
        );
    }
    fs::write(at("plan.toml"), plan).unwrap();
    expect(0, &["simulate", "cmos12", "--plan", &at("plan.toml"), "-o", &at("c")]);
    for (estimator, more) in [("paper", &[][..]), ("joint", &["--overwrite"])] {
        let arguments = ["calibrate", &at("c"), "-o", &at("cal.tiff"), "--estimator", estimator];
        let out = expect(0, &[&arguments[..], more].concat());
        assert!(out.contains("12 configurations of 12 frames"), "{out}");
    }
    let calibrate =
        |more: &[&str]| refused(&[&["calibrate", &at("c"), "-o", &at("other.tiff")], more].concat());
    assert!(refused(&["calibrate", &at("c"), "-o", &at("cal.tiff")]).contains("--overwrite writes over it"));
    assert!(calibrate(&["--window", "9"]).contains("belong to --estimator paper"));
    assert!(calibrate(&["--estimator", "paper", "--window", "4"]).contains("odd"));
    assert!(calibrate(&["--estimator", "paper", "--window", "99999"]).contains("96 x 80 px"));
    assert!(calibrate(&["--estimator", "paper", "--p", "nan"]).contains("above 0"));
    assert!(!dir.path().join("other.tiff").exists());
    // K against the maps that the simulator was made with.
    let calibration = radcam::calibrate::file::Calibration::read(at("cal.tiff").as_ref()).unwrap();
    let sensor = radcam_sim::Sensor::new(radcam_sim::sensors::load("cmos12").unwrap()).unwrap();
    let truth = sensor.maps().uniformity.slice(ndarray::s![300..380, 400..496]).to_owned();
    let mean = truth.mean().unwrap();
    let n = truth.len() as f64;
    let off = ndarray::Zip::from(&calibration.k).and(&truth).map_collect(|&k, &t| f64::from(k - t / mean));
    let rms = (off.mapv(|x| x * x).sum() / n).sqrt();
    let stated = f64::from(calibration.k_std_err.mean().unwrap());
    assert!((rms / stated - 1.0).abs() < 0.1, "K is off by {rms}, stated {stated}");

    let out = expect(0, &["correct", &at("cal.tiff"), &at("c"), "-o", &at("flat")]);
    assert!(out.contains("168 frames corrected, by the pixels"), "{out}");
    let frame = at("c/frames/00030.tiff");
    expect(0, &["correct", &at("cal.tiff"), &frame, "-o", &at("one.tiff"), "--codes", "8,256"]);
    assert!(fs::metadata(at("one.tiff")).unwrap().len() > 96 * 80 * 2);
    // What it refuses.
    assert!(refused(&["correct", &at("cal.tiff"), &frame, "-o", &at("z.png")]).contains("TIFF, not as png"));
    let other = at("other");
    expect(0, &["simulate", "cmos12", "--seed", "9", "--plan", &at("plan.toml"), "-o", &other]);
    let said = refused(&["correct", &at("cal.tiff"), &other, "-o", &at("x")]);
    assert!(said.contains("serial is SIM9, and was SIM12") && said.contains("--force"), "{said}");
    fs::write(at("short.tiff"), &fs::read(at("cal.tiff")).unwrap()[..3000]).unwrap();
    assert!(refused(&["correct", &at("short.tiff"), &frame, "-o", &at("x")]).contains("short.tiff"));
    // Nothing that is read or there already is written over, and no two frames go to one file.
    let twice = at("again/00030.tiff");
    fs::create_dir(at("again")).unwrap();
    fs::copy(&frame, &twice).unwrap();
    for (inputs, output, part) in [
        (&[frame.as_str()][..], "one.tiff", "--overwrite writes over it"),
        (&[frame.as_str()], "cal.tiff", "is read, and would be overwritten"),
        (&[at("c").as_str()], "c", "is read, and would be overwritten"),
        (&[frame.as_str(), &twice], "both", "output of two frames"),
    ] {
        let said = refused(&[&["correct", &at("cal.tiff")][..], inputs, &["-o", &at(output)]].concat());
        assert!(said.contains(part), "{output}: {said}");
    }
    assert!(!dir.path().join("both").exists());
    expect(0, &["correct", &at("cal.tiff"), &frame, "-o", &at("one.tiff"), "--overwrite"]);
    assert!(
        refused(&["correct", &at("cal.tiff"), &frame, "-o", &at("x"), "--exposure-s", "nan"])
            .contains("above 0")
    );
    // A plain frame is checked by what it says of itself, and what its codes show.
    let plain = |name: &str, code: u16, bits: u8| {
        let image = ndarray::Array2::from_elem((80, 96), code);
        fs::write(at(name), radcam::dataset::image::tiff_bytes(&image, bits).unwrap()).unwrap();
        refused(&["correct", &at("cal.tiff"), &at(name), "-o", &at("x.tiff")])
    };
    assert!(plain("shifted.tiff", 64 << 4, 16).contains("multiples of"));
    assert!(
        plain("deep.tiff", 60_001, 16)
            .contains("holds 60001 DN, and the largest code of the calibration's 12 bits")
    );
    assert!(plain("flat8.tiff", 200, 8).contains("bit depth is 8, and was 12"));
    let lit = "[[set]]\nkind = \"target\"\nframes = 2\nexposure_s = 0.003\nillumination = 1.0\n";
    let plan = "format = \"radcam-plan/1\"\n[camera]\nregion = [400, 300, 96, 80]\n";
    fs::write(at("gain.toml"), format!("{plan}gain_db = 6.0\n{lit}")).unwrap();
    expect(0, &["simulate", "cmos12", "--plan", &at("gain.toml"), "-o", &at("gain")]);
    let loose = at("loose.tiff");
    fs::copy(at("gain/frames/00000.tiff"), &loose).unwrap();
    for verb in [&["correct", "-o", "x.tiff"][..], &["scene"], &["budget"]] {
        let said = refused(&[verb, &[&at("cal.tiff"), &loose]].concat());
        assert!(said.contains("gain is 6 dB, and was 0 dB"), "{verb:?}: {said}");
    }
    // The exposure is the frame's own: at 3 ms as at 5 ms a surface has one V_s.
    fs::write(at("short.toml"), format!("{plan}{lit}")).unwrap();
    expect(0, &["simulate", "cmos12", "--plan", &at("short.toml"), "-o", &at("shorter")]);
    let image = at("shorter/frames/00000.tiff");
    let scene = |more: &[&str]| -> serde_json::Value {
        let begin = ["scene", &at("cal.tiff"), &image, "--json"];
        serde_json::from_str(&expect(0, &[&begin[..], more].concat())).unwrap()
    };
    assert_eq!(scene(&[]), scene(&["--exposure-s", "0.003"]));
    assert_ne!(scene(&[])["mean_dn"], scene(&["--exposure-s", "0.5"])["mean_dn"]);
    let said = refused(&["scene", &at("cal.tiff"), &image, "--map", "5000", "--map-output", &at("m.tiff")]);
    assert!(said.contains("fit into the image of 96 x 80 px"), "{said}");
    // The same image again makes a surface no better known.
    let learn = ["surface", "learn", &at("s.toml"), "--name", "card", &at("cal.tiff"), &image];
    expect(0, &learn);
    assert!(refused(&learn).contains("learnt before"));
    let said = refused(&["scene", &at("cal.tiff"), &image, &at("c/frames/00030.tiff")]);
    assert!(said.contains("images of one exposure"), "{said}");
    // A sensor's name is a model, wherever one is asked for.
    assert!(refused(&["compare", &at("c"), "--model", "nikon"]).contains("no model or sensor \"nikon\""));
    let judged = radcam(&["compare", &at("c"), "--model", "cmos12"]);
    assert!(judged.status.code() != Some(2), "{judged:?}");
    // A file that ends too early says so, and so does a JPEG.
    fs::write(at("c/frames/00030.tiff"), &fs::read(&image).unwrap()[..900]).unwrap();
    assert!(refused(&["noise", &at("c")]).contains("cut short"));
    fs::write(at("photo.tiff"), b"\xff\xd8\xff\xe0 JFIF").unwrap();
    assert!(refused(&["scene", &at("cal.tiff"), &at("photo.tiff")]).contains("a JPEG"));
    simulate(&dir.path().join("flat_only"));
    assert!(refused(&["calibrate", &at("flat_only"), "-o", &at("y.tiff")]).contains("three configurations"));
}

/// A plan for an error of K gives that error: its mean over the pixels, which a campaign of few frames knows
/// to some per cent, is no larger and no needlessly small.
#[test]
fn an_error_of_k_that_is_asked_for_is_met() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let (plan, campaign, cal) = (at("plan.toml"), at("campaign"), at("cal.tiff"));
    let sensor = crate::support::small_sensor(dir.path(), "cmos12", 96, 64);
    let camera = format!("sim:{}", sensor.display());
    let pilot = ["--camera", &camera, "--pilot-folder", &at("pilot"), "--k-error", "0.001", "-o", &plan];
    let out = expect(0, &[&["plan-calibration"], &pilot[..]].concat());
    assert!(out.contains("MiB") && out.contains("for K to 0.001"), "{out}");
    expect(0, &["capture", "--camera", &camera, "--plan", &plan, "-o", &campaign]);
    let out = expect(0, &["calibrate", &campaign, "-o", &cal]);
    let error = out.split("error of K").nth(1).and_then(|t| t.split_whitespace().next());
    let error: f64 = error.unwrap().parse().unwrap();
    assert!((0.0004..0.0011).contains(&error), "{out}");
}

/// A plan for one configuration, as a pilot of too few says: the error of K that was asked for is met by
/// `--estimator smooth`, and a pilot of one configuration is enough.
#[test]
fn a_calibration_of_one_configuration_is_planned() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let sensor = crate::support::small_sensor(dir.path(), "cmos12", 96, 64);
    let sensor = sensor.to_str().unwrap();
    expect(0, &["simulate", sensor, "--plan", "quick", "-o", &at("pilot")]);
    let plan = ["plan-calibration", &at("pilot"), "--k-error", "0.001", "-o", &at("plan.toml")];
    let said = refused(&plan);
    assert!(said.contains("three configurations") && said.contains("--estimator smooth"), "{said}");
    let said = expect(0, &[&plan[..], &["--estimator", "smooth"]].concat());
    assert!(
        said.contains("1 configurations") && said.contains("radcam calibrate --estimator smooth"),
        "{said}"
    );
    expect(0, &["simulate", sensor, "--plan", &at("plan.toml"), "-o", &at("campaign")]);
    let out = expect(0, &["calibrate", &at("campaign"), "--estimator", "smooth", "-o", &at("cal.tiff")]);
    let error = out.split("error of K").nth(1).and_then(|t| t.split_whitespace().next());
    let error: f64 = error.unwrap().parse().unwrap();
    assert!((0.0006..0.0011).contains(&error), "{out}");
}

/// One verb continues what another run left unfinished.
#[test]
fn resume_from_the_command_line() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    simulate(&root);
    let csv = root.join("frames.csv");
    let rows: Vec<String> = fs::read_to_string(&csv).unwrap().lines().map(Into::into).collect();
    fs::write(&csv, rows[..20].join("\n") + "\nframes/000").unwrap();
    // A killed program leaves the frame that it was writing.
    let left = root.join("frames/.radcam-Ab3xYz");
    fs::write(&left, "II*").unwrap();
    let out = expect(0, &["simulate", "cmos12", "--resume", "-o", root.to_str().unwrap()]);
    assert!(out.contains("21 frames written"), "{out}");
    assert!(!left.exists());
    // Its own plan may be named again; another one is refused.
    expect(0, &["simulate", "cmos12", "--plan", "quick", "--resume", "-o", root.to_str().unwrap()]);
    let said =
        refused(&["simulate", "cmos12", "--plan", "standard", "--resume", "-o", root.to_str().unwrap()]);
    assert!(said.contains("another plan"), "{said}");
    expect(0, &["noise", root.to_str().unwrap()]);
}

/// A standard output that cannot be written is an error with its reason, not a panic.
#[test]
fn a_full_disk_is_told() {
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let out = crate::support::program().arg("effects").stdout(full).output().unwrap();
    let said = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(2), "{said}");
    assert!(said.contains("No space left") && !said.contains("panicked"), "{said}");
}

/// A file that cannot be written to its end, as on a full disk, leaves nothing of itself behind; what was
/// whole before stays.
#[test]
fn what_cannot_be_written_whole_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    let root = root.to_str().unwrap();
    // No file above 8 KiB: of the frames of 64 x 48 px, 6 KiB each, all; of those of 128 x 96 px none.
    let limited = |region: &str| {
        let shell = "trap '' XFSZ; ulimit -f 8; exec \"$0\" \"$@\"";
        let program = env!("CARGO_BIN_EXE_radcam");
        let arguments = ["simulate", "cmos12", "--plan", "quick", "--region", region, "-o", root];
        let out = std::process::Command::new("bash").args(["-c", shell, program]).args(arguments).output();
        let out = out.unwrap();
        (out.status.code(), String::from_utf8_lossy(&out.stderr).into_owned())
    };
    let files = || -> Vec<String> {
        let all = fs::read_dir(format!("{root}/frames")).unwrap();
        all.map(|f| f.unwrap().file_name().into_string().unwrap()).collect()
    };
    let (code, said) = limited("0,0,128,96");
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("File too large") && said.contains("00000.tiff"), "{said}");
    assert_eq!(files(), [""; 0]);
    fs::remove_dir_all(root).unwrap();
    let (code, said) = limited("0,0,64,48");
    assert_eq!((code, files().len()), (Some(0), 40), "{said}");
}

/// A simulation that was broken off and gone on with is the one that was not: frames, rows and all that
/// follows.
#[test]
fn a_resumed_simulation_is_the_undisturbed_one() {
    let dir = tempfile::tempdir().unwrap();
    let [whole, broken] = ["whole", "broken"].map(|name| dir.path().join(name));
    let mut model = crate::support::small("cmos12", 64, 48);
    let lag = radcam_sim::effects::find("image-lag").unwrap();
    let values = radcam_sim::effects::example("image-lag", &model).unwrap();
    let parameters = lag.parameters().iter().zip(&values).map(|(p, v)| (p.name.to_string(), *v)).collect();
    model.effects =
        vec![radcam_sim::EffectValues { id: "image-lag".into(), parameters, ..Default::default() }];
    let camera = dir.path().join("camera.toml");
    fs::write(&camera, model.to_toml().unwrap()).unwrap();
    let run = |to: &Path, more: &[&str]| {
        let begin = ["simulate", camera.to_str().unwrap(), "-o", to.to_str().unwrap()];
        expect(0, &[&begin[..], more].concat())
    };
    let said = run(&whole, &["--plan", "quick"]);
    // What was received and not kept is explained.
    assert!(said.contains("(40 kept; "), "{said}");
    run(&broken, &["--plan", "quick"]);
    let rows = fs::read_to_string(broken.join("frames.csv")).unwrap();
    let kept: Vec<&str> = rows.lines().take(15).collect();
    fs::write(broken.join("frames.csv"), kept.join("\n") + "\n").unwrap();
    for number in 14..40 {
        fs::remove_file(broken.join(format!("frames/{number:05}.tiff"))).unwrap();
    }
    run(&broken, &["--resume"]);
    assert_eq!(fs::read_to_string(broken.join("frames.csv")).unwrap(), rows);
    for number in 0..40 {
        let name = format!("frames/{number:05}.tiff");
        assert_eq!(fs::read(whole.join(&name)).unwrap(), fs::read(broken.join(&name)).unwrap(), "{name}");
    }
}

/// The first things that a new user types, and what they get.
#[test]
fn first_steps_are_shown_and_followed() {
    let alone = radcam(&[]);
    let text = String::from_utf8_lossy(&alone.stdout).into_owned();
    let order = ["radcam demo", "radcam investigate", "radcam import", "radcam diagnose", "radcam calibrate"];
    let places: Vec<usize> = order.iter().map(|verb| text.find(verb).unwrap()).collect();
    assert!(places.is_sorted() && alone.status.code() == Some(2), "{text}");
    for shell in ["bash", "zsh", "fish"] {
        assert!(expect(0, &["completions", shell]).contains("investigate"), "{shell}");
    }
    let dir = tempfile::tempdir().unwrap();
    expect(0, &["man", "-o", dir.path().to_str().unwrap()]);
    assert!(fs::read_to_string(dir.path().join("radcam-diagnose.1")).unwrap().contains("DATASET"));
    for verb in [
        "cameras",
        "capture",
        "simulate",
        "serve",
        "investigate",
        "import",
        "noise",
        "plan-calibration",
        "calibrate",
        "correct",
        "scene",
        "budget",
        "reproduce",
        "compare",
        "diagnose",
        "model",
        "effects",
        "demo",
    ] {
        assert!(expect(0, &[verb, "--help"]).contains("--json"), "{verb}");
    }
    let to = dir.path().join("captured").to_str().unwrap().to_string();
    let capture =
        ["capture", "--camera", "sim:cmos12", "--plan", "quick", "--region", "8,4,64,48", "-o", &to];
    let said: serde_json::Value =
        serde_json::from_str(&expect(0, &[&capture[..], &["--json"]].concat())).unwrap();
    assert_eq!(said["frames"], 40);
    let taken = radcam::dataset::Dataset::open(Path::new(&to)).unwrap();
    assert_eq!((taken.manifest().camera.width, taken.manifest().camera.height), (64, 48));
    let pages: serde_json::Value = serde_json::from_str(&expect(0, &["effects", "--json"])).unwrap();
    assert!(pages.as_array().unwrap().len() > 25 && pages[0]["parameters"].is_array());
    // A negative number is a value, and its fault is named.
    let said = refused(&["capture", "--camera", "sim:cmos12", "--full-exposure-s", "-1", "-o", "x"]);
    assert!(said.contains("a number above 0") && !said.contains("-- -1"), "{said}");
    // A reader that has seen enough is no fault.
    let head = "effects=$($0 effects | head -1; test ${PIPESTATUS[0]} = 0) && echo \"$effects\"";
    let out =
        std::process::Command::new("bash").args(["-c", head, env!("CARGO_BIN_EXE_radcam")]).output().unwrap();
    assert!(out.status.success() && out.stderr.is_empty(), "{out:?}");
}

/// Datasets with less than a line needs: what can be said is said, with the error that leaves.
#[test]
fn one_level_and_one_bias_frame_give_a_gain_with_its_error() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("all");
    simulate(&root);
    let rows = fs::read_to_string(root.join("frames.csv")).unwrap();
    let part = |name: &str, keep: &dyn Fn(&str) -> bool| {
        let to = dir.path().join(name);
        fs::create_dir_all(to.join("frames")).unwrap();
        fs::copy(root.join("dataset.toml"), to.join("dataset.toml")).unwrap();
        let mut text = String::new();
        for (i, line) in rows.lines().enumerate() {
            let place = line.split(',').skip(1).take(3).collect::<Vec<_>>().join(",");
            if i == 0 || keep(&place) {
                text += &format!("{line}\n");
                let file = line.split(',').next().unwrap();
                fs::copy(root.join(file), to.join(file)).ok();
            }
        }
        fs::write(to.join("frames.csv"), text).unwrap();
        to.to_str().unwrap().to_string()
    };
    let bias = part("bias", &|place| place == "dark,0,0" || place.starts_with("flat,7"));
    let report: serde_json::Value = serde_json::from_str(&expect(0, &["noise", &bias, "--json"])).unwrap();
    let of =
        |name: &str| (report[name]["value"].as_f64().unwrap(), report[name]["std_err"].as_f64().unwrap());
    let ((gain, gain_error), (read, read_error)) = (of("gain_dn_per_e"), of("read_noise_e"));
    // Truth within two errors; the pattern of the offsets is in the bound, so that it lies above the read
    // noise.
    assert!((gain - 0.38).abs() < 2.0 * gain_error && gain_error < 0.02, "{gain} +- {gain_error}");
    assert!(read + 1.8 * read_error > 2.6, "{read} +- {read_error}");
    assert_eq!(report["estimators"][0]["method"], "one-level");
    let flats = part("flats", &|place| place.starts_with("flat,7"));
    let said = expect(0, &["noise", &flats]);
    assert!(said.contains("one lit level") && said.contains("take flats at a second level"), "{said}");
    // A bias frame that is clipped at black bounds nothing, and levels without a zero tell no read noise.
    let lit = part("lit", &|place| place.starts_with("flat"));
    let manifest = fs::read_to_string(dir.path().join("lit/dataset.toml")).unwrap();
    let unknown: String =
        manifest.lines().filter(|l| !l.starts_with("black_level")).map(|l| format!("{l}\n")).collect();
    fs::write(dir.path().join("lit/dataset.toml"), unknown).unwrap();
    assert!(expect(0, &["noise", &lit]).contains("read noise       not determined"));
    let none = part("none", &|_| false);
    assert!(refused(&["noise", &none]).contains("has no frames"));
}

/// Ctrl-C ends a long run with the shell's code for it, and what is there is gone on with.
#[test]
#[cfg(unix)]
fn an_interrupted_run_says_so_and_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    let run = ["simulate", "cmos12", "--plan", "standard", "-o", root.to_str().unwrap()];
    let mut child = crate::support::program().args(run).stderr(std::process::Stdio::null()).spawn().unwrap();
    let lines = || fs::read_to_string(root.join("frames.csv")).map_or(0, |t| t.lines().count());
    while lines() < 5 {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it could be interrupted");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let id = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(lines() < 241);
    expect(0, &[&run[..], &["--resume"]].concat());
    assert_eq!(lines(), 241);
}
