//! List of defective pixels by column and row, as in FLIR cameras (Blackfly S, Oryx) and in the served
//! camera.
//!
//! FLIR's interface: a count, an index, the coordinates at the index (on the whole sensor), and a command
//! that applies the list.

use super::{Content, Map, Memory, UploadError, Written, save, switch_on};
use crate::camera::{Camera, Value};

const COUNT: &str = "DefectTablePixelCount";
const INDEX: &str = "DefectTableIndex";
const COORDINATES: [&str; 2] = ["DefectTableCoordinateX", "DefectTableCoordinateY"];
const APPLY: &str = "DefectTableApply";
const ENABLE: &str = "DefectCorrectStaticEnable";

pub const MEMORY: Memory = Memory {
    map: Map::Defects,
    name: "a list DefectTable of defective pixels",
    features: &[COUNT, INDEX, COORDINATES[0], COORDINATES[1], APPLY, ENABLE],
    file: None,
    write,
};

fn write(
    camera: &mut dyn Camera,
    content: &Content<'_>,
    go_on: &mut dyn FnMut(f64) -> bool,
) -> Result<Written, UploadError> {
    let flags = content.calibration.defects.indexed_iter().filter(|(_, flag)| **flag != 0);
    let mut found: Vec<(usize, usize)> = flags.map(|(at, _)| at).collect();
    let mut remarks = Vec::new();
    let room = camera.largest(COUNT).map_or(usize::MAX, |most| most as usize);
    if found.len() > room {
        // Pixels with the worst correction without the list come first.
        let k = &content.calibration.k;
        found.sort_by(|a, b| (k[*b] - 1.0).abs().total_cmp(&(k[*a] - 1.0).abs()));
        remarks.push(format!(
            "{} of {} defects do not fit; those of the largest |K - 1| are in",
            found.len() - room,
            found.len()
        ));
        found.truncate(room);
        found.sort_unstable();
    }
    camera.set_feature(COUNT, &Value::Int(found.len() as i64))?;
    for (index, &(y, x)) in found.iter().enumerate() {
        if !go_on(index as f64 / found.len() as f64) {
            return Err(UploadError::Interrupted);
        }
        camera.set_feature(INDEX, &Value::Int(index as i64))?;
        // Setting a feature reads it back.
        camera.set_feature(COORDINATES[0], &Value::Int(x as i64))?;
        camera.set_feature(COORDINATES[1], &Value::Int(y as i64))?;
    }
    camera.execute(APPLY)?;
    save(camera, content, "DefectTableSave", &mut remarks)?;
    let mut switched_on = Vec::new();
    switch_on(camera, ENABLE, Value::Bool(true), &mut switched_on)?;
    Ok(Written { map: Map::Defects, memory: MEMORY.name.into(), entries: found.len(), remarks, switched_on })
}
