//! Bench: light on the card, shutter, and the control of both.
//!
//! Three backends: the simulated bench, a camera's GenICam features, and an operator at the terminal.

pub use crate::camera::sim::SharedBench;
use crate::camera::{Camera, CameraError, Value};
use crate::dataset::BenchInfo;
use crate::plan::Plan;
pub use crate::plan::{BenchState, GenicamBench};
use radcam_sim::Scene;
use std::io::{BufRead, Write};
use std::time::Duration;

/// Reason why the bench did not reach the requested state.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BenchError {
    /// A feature of the camera reported an error.
    #[error("bench: {0}")]
    Camera(#[from] CameraError),
    /// The operator cannot be asked or gave up.
    #[error("bench: {0}")]
    Operator(String),
}

/// Bench that can be set to a state.
pub trait Illuminator {
    /// Sets the bench to a state and returns the state reached, which may differ: a lamp may have steps.
    /// `camera` is for benches that are controlled through it.
    ///
    /// # Errors
    ///
    /// A feature of the camera refuses, or the operator gives up.
    fn apply(&mut self, state: &BenchState, camera: &mut dyn Camera) -> Result<BenchState, BenchError>;

    /// Returns the known properties of the light, for `dataset.toml`.
    fn info(&self) -> Option<BenchInfo>;

    /// Returns true if the bench moves by itself; otherwise the operator is asked to move it.
    fn moves_itself(&self) -> bool {
        true
    }
}

/// Returns the bench of a camera: the simulated bench of a simulated camera, the GenICam features that the
/// plan names, those of a served camera, or else an operator, who is asked at the terminal.
///
/// ```
/// use radcam::{bench, camera, plan::Plan};
/// let mut camera = camera::open("sim:cmos12")?;
/// let bench = bench::of(&mut *camera, &Plan::quick());
/// assert!(bench.moves_itself());
/// # Ok::<(), radcam::camera::CameraError>(())
/// ```
pub fn of(camera: &mut dyn Camera, plan: &Plan) -> Box<dyn Illuminator> {
    of_or(camera, plan, || Box::new(ManualBench::new(std::io::stdin().lock(), std::io::stderr())))
}

/// Returns the bench of a camera as `of` does, with another operator than the one at the terminal.
pub fn of_or(
    camera: &mut dyn Camera,
    plan: &Plan,
    operator: impl FnOnce() -> Box<dyn Illuminator>,
) -> Box<dyn Illuminator> {
    if let Some(bench) = camera.shared_bench() {
        return Box::new(bench);
    }
    match &plan.bench {
        Some(features) => Box::new(features.clone()),
        None if camera.has_feature("BenchIllumination") => Box::new(GenicamBench::served()),
        None => operator(),
    }
}

impl Illuminator for SharedBench {
    fn apply(&mut self, state: &BenchState, _camera: &mut dyn Camera) -> Result<BenchState, BenchError> {
        self.set(*state);
        Ok(*state)
    }

    /// The simulated lamp is exact.
    fn info(&self) -> Option<BenchInfo> {
        Some(BenchInfo { illumination_unit: "relative".into(), illumination_rel_std: Some(0.0), light: None })
    }
}

impl Illuminator for GenicamBench {
    fn apply(&mut self, state: &BenchState, camera: &mut dyn Camera) -> Result<BenchState, BenchError> {
        let missing = |feature: &str| CameraError::NotAvailable {
            camera: camera.identity().id.clone(),
            feature: format!("{feature} (the plan needs one, and names none under [bench])"),
        };
        if state.configuration != 0 && self.configuration.is_none() {
            return Err(missing("configuration").into());
        }
        if state.scene != Scene::Card && self.scene.is_none() {
            return Err(missing("scene").into());
        }
        let light = state.illumination * self.illumination_scale;
        let reached = match camera.set_feature(&self.illumination, &Value::Float(light))? {
            Value::Float(light) => light / self.illumination_scale,
            _ => state.illumination,
        };
        if let Some(name) = &self.dark {
            camera.set_feature(name, &Value::Bool(state.illumination == 0.0))?;
        }
        if let Some(name) = &self.configuration {
            camera.set_feature(name, &Value::Int(state.configuration.into()))?;
        }
        if let Some(name) = &self.scene {
            camera.set_feature(name, &Value::Text(format!("{:?}", state.scene)))?;
        }
        std::thread::sleep(Duration::try_from_secs_f64(self.settle_s).unwrap_or_default());
        Ok(BenchState { illumination: reached, ..*state })
    }

    fn info(&self) -> Option<BenchInfo> {
        let illumination_rel_std = self.illumination_rel_std;
        Some(BenchInfo { illumination_unit: "relative".into(), illumination_rel_std, light: None })
    }
}

/// Manual bench: prompts the operator, who confirms with Enter.
pub struct ManualBench<R, W> {
    input: R,
    output: W,
    now: Option<BenchState>,
}

impl<R: BufRead, W: Write> ManualBench<R, W> {
    /// Creates a bench whose operator reads `output` and answers on `input`.
    pub fn new(input: R, output: W) -> Self {
        Self { input, output, now: None }
    }

    fn ask(&mut self, what: &str) -> Result<(), BenchError> {
        let fault = |e: std::io::Error| BenchError::Operator(format!("{what}: {e}"));
        write!(self.output, "{what}, then press Enter (q gives up): ").map_err(fault)?;
        self.output.flush().map_err(fault)?;
        let mut answer = String::new();
        let read = self.input.read_line(&mut answer).map_err(fault)?;
        if read == 0 {
            let message = format!(
                "nobody is at the terminal to \"{what}\"; name the bench's GenICam features in the plan"
            );
            return Err(BenchError::Operator(message));
        }
        if answer.trim().eq_ignore_ascii_case("q") {
            return Err(BenchError::Operator(format!("given up at \"{what}\"")));
        }
        Ok(())
    }
}

impl<R: BufRead, W: Write> Illuminator for ManualBench<R, W> {
    fn apply(&mut self, state: &BenchState, _camera: &mut dyn Camera) -> Result<BenchState, BenchError> {
        let before = self.now;
        if before == Some(*state) {
            return Ok(*state);
        }
        let changed = |differs: &dyn Fn(&BenchState) -> bool| before.as_ref().is_none_or(differs);
        if state.illumination == 0.0 {
            if changed(&|b| b.illumination != 0.0) {
                self.ask("Cover the lens")?;
            }
        } else {
            if changed(&|b| b.scene != state.scene) {
                self.ask(match state.scene {
                    Scene::Card => "Put the uniform card before the camera",
                    Scene::Patch => "Put a still scene with a bright patch in the middle before the camera",
                    Scene::Chart => "Put the surfaces to be told apart before the camera",
                })?;
            }
            if before.map_or(0, |b| b.configuration) != state.configuration {
                let k = state.configuration;
                self.ask(&format!("Move both card and light to a new place (configuration {k})"))?;
            }
            if changed(&|b| b.illumination != state.illumination) {
                let percent = 100.0 * state.illumination;
                self.ask(&format!("Uncover the lens and set the light to {percent:.4} % of its full level"))?;
            }
        }
        self.now = Some(*state);
        Ok(*state)
    }

    fn moves_itself(&self) -> bool {
        false
    }

    /// A level set by hand is nominal.
    fn info(&self) -> Option<BenchInfo> {
        Some(BenchInfo { illumination_unit: "relative".into(), ..Default::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::sim::SimCamera;
    use radcam_sim::{Sensor, sensors};

    #[test]
    fn the_operator_is_asked_for_what_changes_and_no_more() {
        let sensor = Sensor::new(sensors::load("cmos12").unwrap()).unwrap();
        let mut camera = SimCamera::new("cmos12", sensor.into(), SharedBench::default());
        let mut said = Vec::new();
        let mut bench = ManualBench::new(&b"\n\n\n\n\nq\n"[..], &mut said);
        let dark = BenchState::default();
        let flat = BenchState { illumination: 0.5, ..dark };
        for state in [dark, dark, flat, flat, BenchState { configuration: 2, ..flat }] {
            bench.apply(&state, &mut camera).unwrap();
        }
        let patch = BenchState { scene: Scene::Patch, ..flat };
        bench.apply(&patch, &mut camera).unwrap();
        let bright = BenchState { illumination: 1.0, ..patch };
        assert!(bench.apply(&bright, &mut camera).unwrap_err().to_string().contains("given up"));
        assert!(bench.apply(&bright, &mut camera).unwrap_err().to_string().contains("nobody"));
        let said = String::from_utf8(said).unwrap();
        assert_eq!(said.matches("press Enter").count(), 7, "{said}");
        assert!(said.contains("50.0000 %") && said.contains("configuration 2"), "{said}");
    }
}
