//! Table with an offset and a factor for each column, as in FLIR cameras (Blackfly S, Oryx).
//!
//! FLIR's flat-field correction: P = gain (U + offset), by column, with U the uncorrected and P the corrected
//! pixel. The unit of an offset is "16-bit": relative to a full scale of 65535.

use super::{Content, Map, Memory, UploadError, Written, save, switch_on};
use crate::camera::{Camera, Value};
use ndarray::Axis;

const INDEX: &str = "FfcUserTableXCoordinate";
const GAIN: &str = "FfcUserGain";
const OFFSET: &str = "FfcUserOffset";
const MODE: &str = "FfcMode";

pub const MEMORY: Memory = Memory {
    map: Map::FlatField,
    name: "a table FfcUserTable of coefficients of every column",
    features: &[INDEX, GAIN, OFFSET, MODE],
    file: None,
    write,
};

/// Maximum relative difference between a written factor and its readback: the steps are not documented.
const GAIN_STEP: f64 = 1e-3;

fn write(
    camera: &mut dyn Camera,
    content: &Content<'_>,
    go_on: &mut dyn FnMut(f64) -> bool,
) -> Result<Written, UploadError> {
    let fault = |camera: &mut dyn Camera, message: String| UploadError::Memory {
        camera: camera.identity().id.clone(),
        message,
    };
    let dark = content.calibration.dark.at(content.exposure_s).map_err(crate::correct::CorrectError::from)?;
    let full_dn = f64::from(content.calibration.description.camera.full_scale_dn());
    let means = dark.mean_axis(Axis(0)).zip(content.calibration.k.mean_axis(Axis(0)));
    let Some((dark_dn, k)) = means else {
        return Err(fault(camera, "the calibration has no rows".into()));
    };
    let columns = dark_dn.len();
    for (column, (&dark_dn, &k)) in dark_dn.iter().zip(&k).enumerate() {
        if !go_on(column as f64 / columns as f64) {
            return Err(UploadError::Interrupted);
        }
        // Maps the dark level of the column to that of the sensor: P = black + (U - dark) / K = (U + black K
        // - dark) / K.
        let gain = 1.0 / f64::from(k);
        let offset_dn = f64::from(content.flat_field.black_dn()) * f64::from(k) - f64::from(dark_dn);
        let offset = (offset_dn / full_dn * 65_535.0).round();
        camera.set_feature(INDEX, &Value::Int(column as i64))?;
        camera.set_feature(GAIN, &Value::Float(gain))?;
        camera.set_feature(OFFSET, &Value::Int(offset as i64))?;
        let reads = match camera.feature(GAIN)? {
            Value::Float(v) => v,
            other => return Err(fault(camera, format!("{GAIN} reads {other}, which is no number"))),
        };
        if (reads / gain - 1.0).abs() > GAIN_STEP || camera.feature(OFFSET)? != Value::Int(offset as i64) {
            let message = format!(
                "{GAIN} of column {column} was set to {gain:.5} and reads {reads:.5}, or {OFFSET} differs from {offset}"
            );
            return Err(fault(camera, message));
        }
    }
    let mut remarks = vec!["by column: what differs within a column stays".to_string()];
    save(camera, content, "FfcUserTableSave", &mut remarks)?;
    let mut switched_on = Vec::new();
    switch_on(camera, MODE, Value::Text("User".into()), &mut switched_on)?;
    if camera.has_feature("FfcEnable") {
        switch_on(camera, "FfcEnable", Value::Bool(true), &mut switched_on)?;
    }
    Ok(Written { map: Map::FlatField, memory: MEMORY.name.into(), entries: columns, remarks, switched_on })
}
