//! Report on a camera, for someone who helps without having that camera.

use super::{AravisCamera, arv};
use crate::camera::{Camera, CameraError, StreamCounts, StreamOptions};
use crate::features::{Role, role, suspicious};
use crate::frame::Frame;
use arv::{Feature, FeatureKind};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Bootstrap registers (GigE Vision 2.0, chapter 28): identity and addresses, locations of the description,
/// control, stream channel 0.
const BOOTSTRAP: [(u64, u32); 4] = [(0, 0x200), (0x200, 0x200), (0x900, 0x60), (0xd00, 0x40)];
/// Frames that a report takes to measure losses.
const REPORT_FRAMES: u64 = 30;

impl AravisCamera {
    /// Returns the report as JSON: identity, settings, features with bounds and with the action that a
    /// capture takes on each, bootstrap registers, losses of a stream, description. It is meant for someone
    /// who helps without having the camera. Nothing but the packet size is changed.
    pub fn report(&mut self) -> serde_json::Value {
        let features: Vec<_> = self.tree.iter().map(|f| self.feature_report(f)).collect();
        let words = |e: CameraError| serde_json::json!({ "error": e.to_string() });
        let settings = self.settings().map_or_else(words, |s| {
            serde_json::json!({
                "exposure_s": s.exposure_s, "gain_db": s.gain_db, "black_level_dn": s.black_level_dn,
                "frame_rate_hz": s.frame_rate_hz, "pixel_format": s.pixel_format.name(),
                "region": [s.region.x, s.region.y, s.region.width, s.region.height], "temperature_c": s.temperature_c,
            })
        });
        let exposure_s = self.capabilities.exposure_s.map(|b| [b.min, b.max, b.increment.unwrap_or(0.0)]);
        let gain_db = self.capabilities.gain_db.map(|b| [b.min, b.max]);
        let hex = |(at, bytes): (u64, u32)| {
            let text = self.inner.memory(at, bytes).map_or_else(
                |e| e.to_string(),
                |bytes| bytes.iter().map(|b| format!("{b:02x}")).collect::<String>(),
            );
            (format!("{at:#x}"), text)
        };
        let bootstrap: BTreeMap<String, String> = BOOTSTRAP.into_iter().map(hex).collect();
        let stream = self.stream_report();
        let id = &self.identity;
        serde_json::json!({
            "format": "radcam-camera-report/1",
            "radcam": env!("CARGO_PKG_VERSION"),
            "libaravis": arv::version().map(|n| n.to_string()).join("."),
            "system": format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            "camera": {
                "id": id.id, "vendor": id.vendor, "model": id.model, "serial": id.serial, "firmware": id.firmware,
                "gige_vision": self.inner.is_gigevision(),
            },
            "settings": settings,
            "bounds": { "exposure_s": exposure_s, "gain_db": gain_db },
            "unlisted_features": self.unlisted_features(),
            "features": features,
            "stream": stream,
            "bootstrap_registers": bootstrap,
            "description": self.inner.description(),
        })
    }

    fn feature_report(&self, feature: &Feature) -> serde_json::Value {
        let name = &feature.name;
        let available = self.inner.has(name);
        let value = available.then(|| self.read(name, feature.kind)).flatten();
        let bounds = match feature.kind {
            FeatureKind::Integer => self.inner.integer_bounds(name).ok().map(|(a, b)| [a as f64, b as f64]),
            FeatureKind::Float => self.inner.float_bounds(name).ok().map(|(a, b)| [a, b]),
            _ => None,
        };
        let entries =
            (feature.kind == FeatureKind::Enumeration).then(|| self.inner.entries(name).ok()).flatten();
        let does = match role(name) {
            Some(Role::Distorts(neutral, _)) => match (self.neutral(feature, neutral), &value) {
                (Some(to), Some(now)) if to != *now => format!("a capture sets it to {to}"),
                (Some(to), Some(_)) => format!("left at {to}, where it does nothing"),
                (None, Some(_)) => "recorded: it has no value that switches it off".into(),
                (_, None) => "switched off where it can be used".into(),
            },
            Some(Role::Setting) => "recorded: a setting".into(),
            Some(Role::Geometry) => "recorded: geometry".into(),
            Some(Role::Harmless(why)) => format!("left alone: {why}"),
            None if suspicious(name) => "not known to radcam: recorded and warned of".into(),
            None => "left alone".into(),
        };
        serde_json::json!({
            "name": name, "kind": format!("{:?}", feature.kind), "available": available,
            "value": value.map(|v| v.to_string()), "bounds": bounds, "unit": self.inner.unit(name), "entries": entries,
            "selects": feature.selected, "radcam": does,
        })
    }

    /// Takes some frames with the current settings and reports the losses.
    fn stream_report(&mut self) -> serde_json::Value {
        let timeout = Duration::from_secs_f64(self.exposure_s().map_or(2.0, |s| (3.0 * s + 2.0).min(60.0)));
        let mut taken = 0;
        let mut fault = None;
        let begun = Instant::now();
        let counts = match self.stream(&StreamOptions::default()) {
            Ok(mut stream) => {
                let mut frame = Frame::new(0, 0);
                while taken < REPORT_FRAMES && fault.is_none() {
                    match stream.next(&mut frame, timeout) {
                        Ok(()) => taken += 1,
                        Err(e) => fault = Some(e.to_string()),
                    }
                }
                stream.counts()
            }
            Err(e) => {
                fault = Some(e.to_string());
                StreamCounts::default()
            }
        };
        serde_json::json!({
            "asked": REPORT_FRAMES, "complete": counts.completed, "damaged": counts.failures,
            "missing": counts.missing, "underruns": counts.underruns, "seconds": begun.elapsed().as_secs_f64(),
            "packet_size": self.inner.packet_size(), "error": fault,
        })
    }
}
