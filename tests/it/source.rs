//! The library as another program uses it: cameras by name, one source for what is measured, results as JSON
//! and back.

use radcam::prelude::*;
use serde::{Serialize, de::DeserializeOwned};

fn there_and_back<T: Serialize + DeserializeOwned>(value: &T) -> T {
    let text = serde_json::to_string(value).unwrap();
    let back: T = serde_json::from_str(&text).unwrap();
    assert_eq!(serde_json::to_string(&back).unwrap(), text);
    back
}

#[test]
fn results_survive_json() {
    let dir = tempfile::tempdir().unwrap();
    let campaign = dir.path().join("c");
    let mut model = radcam::sim::sensors::load("cmos12").unwrap();
    model.effects.push(toml::from_str("id = \"interpixel-crosstalk\"\nparameters = { a = 0.02 }").unwrap());
    let sensor = dir.path().join("m.toml");
    std::fs::write(&sensor, model.to_toml().unwrap()).unwrap();
    let mut camera = camera::open(&format!("sim:{}", sensor.display())).unwrap();
    let mut plan = Plan::quick();
    plan.camera.region = Some([0, 0, 64, 64]);
    let mut bench = bench::of(&mut *camera, &plan);
    let summary = Capture::new(&mut *camera, &mut *bench).run(&plan, &campaign).unwrap();
    assert_eq!(there_and_back(&summary), summary);
    let source = Source::open(&campaign).unwrap();
    let noise = source.noise().unwrap();
    assert_eq!(there_and_back(&noise).levels, noise.levels);
    let diagnosis = source.diagnose(&[]).unwrap();
    let back = there_and_back(&diagnosis);
    assert_eq!((back.verdict, back.missing), (diagnosis.verdict, diagnosis.missing));
    for comparison in &diagnosis.comparisons {
        assert_eq!(&there_and_back(comparison), comparison);
    }
    // Not a number is null, and comes back.
    let table = dir.path().join("one.csv");
    std::fs::write(&table, "mean_dn,var_dn2\n100,41\n200,81\n").unwrap();
    let noise = Source::open(&table).unwrap().noise().unwrap();
    assert!(there_and_back(&noise).estimators[0].q.is_nan());
}

#[test]
fn cameras_are_opened_by_name() {
    assert!(camera::list().iter().any(|l| l.camera == "sim:xc77" && l.protocol == "simulated"));
    for (name, part) in [
        ("cmos12", "sim:SENSOR"),
        ("usb:1", "no backend \"usb\""),
        ("sim:none", "no model or sensor \"none\""),
        ("replay:/nowhere", "/nowhere"),
    ] {
        let said = camera::open(name).err().unwrap().to_string();
        assert!(said.contains(part) && said.matches(name).count() == 1, "{said}");
    }
}
