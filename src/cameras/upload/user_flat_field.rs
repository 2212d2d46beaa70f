//! File with an offset and a factor for every pixel, in the layout of
//! [`FlatField::to_bytes`](crate::flat_field::FlatField::to_bytes), as in the served camera.

use super::{Content, Map, Memory, UploadError, Written, switch_on};
use crate::camera::{Camera, Value};

const FILE: &str = "UserFlatField";
const MODE: &str = "FlatFieldCorrectionMode";

pub const MEMORY: Memory = Memory {
    map: Map::FlatField,
    name: "a file UserFlatField of coefficients of every pixel",
    features: &[MODE],
    file: Some(FILE),
    write,
};

fn write(
    camera: &mut dyn Camera,
    content: &Content<'_>,
    go_on: &mut dyn FnMut(f64) -> bool,
) -> Result<Written, UploadError> {
    let bytes = content.flat_field.to_bytes();
    let of = bytes.len() as f64;
    let mut interrupted = false;
    let mut part = |from: f64, done: usize| {
        let going = go_on(from + 0.5 * done as f64 / of);
        interrupted |= !going;
        going
    };
    let moved = camera.write_file(FILE, &bytes, &mut |done| part(0.0, done)).and_then(|()| {
        // Reading one byte more detects a longer file.
        camera.read_file(FILE, bytes.len() + 1, &mut |done| part(0.5, done))
    });
    let read = match moved {
        Err(_) if interrupted => return Err(UploadError::Interrupted),
        moved => moved?,
    };
    if read != bytes {
        let message = format!("{FILE} reads otherwise than it was written; it is not switched on");
        return Err(UploadError::Memory { camera: camera.identity().id.clone(), message });
    }
    let mut remarks = vec![format!(
        "offsets rounded by at most {} DN, factors by 0.003 %",
        crate::number::six_digits(content.flat_field.offset_rounding_dn())
    )];
    if content.cut > 0 {
        remarks
            .push(format!("{} coefficients do not fit and were cut to the nearest that does", content.cut));
    }
    let mut switched_on = Vec::new();
    switch_on(camera, MODE, Value::Text("User".into()), &mut switched_on)?;
    let (columns, rows) = content.flat_field.size();
    let entries = columns as usize * rows as usize;
    Ok(Written { map: Map::FlatField, memory: MEMORY.name.into(), entries, remarks, switched_on })
}
