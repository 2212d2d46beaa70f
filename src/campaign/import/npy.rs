//! NumPy arrays: any integer or floating-point type, either byte order, either memory order (NEP 1).
//!
//! `ndarray-npy` reads only the types and the byte order of this machine, so the header is parsed here.

use crate::input;
use ndarray::{Array2, Array3, ArrayD, Axis, Ix3, IxDyn, ShapeBuilder};
use std::path::Path;

/// Frames, rows, columns.
pub type Stack = Array3<f64>;

/// Maximum length of the last axis at which it may be the frame axis (a named choice: no sensor is that
/// narrow, and few windows are).
const NARROWEST: usize = 16;

/// Maximum number of axes of a NumPy array (NPY_MAXDIMS of version 2).
const MAX_AXES: usize = 64;

struct Header {
    kind: char,
    bytes: usize,
    big_endian: bool,
    fortran: bool,
    shape: Vec<usize>,
    /// First byte of the numbers.
    at: usize,
}

/// Returns the value of a key of the header, a Python dictionary.
fn entry<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let rest = text.split_once(&format!("'{key}'"))?.1.trim_start().strip_prefix(':')?.trim_start();
    let end = match rest.chars().next()? {
        '\'' => 1 + rest[1..].find('\'')?,
        '(' => rest.find(')')?,
        _ => rest.find([',', '}'])?,
    };
    Some(rest[..end].trim_start_matches(['\'', '(']).trim())
}

fn header(bytes: &[u8]) -> Result<Header, String> {
    let fault = || "is no sound NumPy array: its header cannot be read".to_string();
    let length = match bytes.get(6) {
        Some(1) => bytes.get(8..10).map(|b| (10usize, usize::from(b[0]) | usize::from(b[1]) << 8)),
        Some(2 | 3) => {
            bytes.get(8..12).and_then(|b| Some((12, u32::from_le_bytes(b.try_into().ok()?) as usize)))
        }
        _ => None,
    };
    let (from, length) = length.ok_or_else(fault)?;
    let text = bytes.get(from..from.saturating_add(length)).and_then(|b| std::str::from_utf8(b).ok());
    let text = text.ok_or_else(fault)?;
    let of = |key| entry(text, key).ok_or_else(fault);
    let descr = of("descr")?;
    let (order, rest) = descr.split_at_checked(1).unwrap_or(("", descr));
    let kind = rest.chars().next().unwrap_or(' ');
    let size = rest.get(1..).and_then(|n| n.parse().ok()).unwrap_or(0);
    let known = matches!((kind, size), ('u' | 'i', 1 | 2 | 4 | 8) | ('f', 2 | 4 | 8) | ('b', 1));
    if !known || !matches!(order, "<" | ">" | "|" | "=") {
        return Err(format!(
            "is a NumPy array of type '{}'; frames are whole or floating-point numbers",
            input::echo(descr)
        ));
    }
    let shape = of("shape")?.split(',').map(str::trim).filter(|n| !n.is_empty());
    let shape = shape.map(|n| n.parse().map_err(|_| fault())).collect::<Result<Vec<usize>, _>>()?;
    Ok(Header {
        kind,
        bytes: size,
        big_endian: order == ">",
        fortran: of("fortran_order")? == "True",
        shape,
        at: from + length,
    })
}

/// Reads an array as frames, rows, columns. `axis` counts the frames; by default the first axis does,
/// unless the values contradict it: then the user is asked.
pub fn read(path: &Path, axis: Option<usize>) -> Result<Stack, String> {
    stack(&input::bytes(path).map_err(|e| e.to_string())?, axis)
}

fn stack(bytes: &[u8], axis: Option<usize>) -> Result<Stack, String> {
    let header = header(bytes)?;
    let count = header.shape.iter().try_fold(1usize, |n, k| n.checked_mul(*k));
    let data = count.and_then(|n| n.checked_mul(header.bytes)).and_then(|n| bytes.get(header.at..)?.get(..n));
    let data = data.ok_or_else(|| {
        let shape = input::echo(&format!("{:?}", header.shape));
        format!("cut short: the file ends before the numbers of its shape {shape} do")
    })?;
    // The product of the nonzero axes may overflow: `ndarray` panics on such a shape.
    if header.shape.contains(&0) || header.shape.len() > MAX_AXES {
        let shape = input::echo(&format!("{:?}", header.shape));
        return Err(format!("has the shape {shape}, which holds no frames"));
    }
    let numbers: Vec<f64> = data.chunks_exact(header.bytes).map(|b| number(b, &header)).collect();
    let shape = IxDyn(&header.shape);
    let array = if header.fortran {
        ArrayD::from_shape_vec(shape.f(), numbers)
    } else {
        ArrayD::from_shape_vec(shape, numbers)
    };
    let mut array = array.map_err(|e| e.to_string())?;
    // An axis of one channel or one position is dropped.
    while array.ndim() > 3
        && let Some(k) = (0..array.ndim()).find(|k| array.len_of(Axis(*k)) == 1)
    {
        array = array.index_axis_move(Axis(k), 0);
    }
    // (rows, columns, 1) is a frame of one channel; no camera sends frames of a single column.
    if axis.is_none() && matches!(array.shape(), [rows, columns, 1] if *rows > 1 && *columns > 1) {
        array = array.index_axis_move(Axis(2), 0);
    }
    let dims = array.ndim();
    let array = if dims == 2 { array.insert_axis(Axis(0)) } else { array };
    let mut array = array.into_dimensionality::<Ix3>().map_err(|_| {
        format!("has {dims} axes; frames are (rows, columns), stacks (frames, rows, columns)")
    })?;
    if dims != 3 {
        return Ok(array);
    }
    match axis.filter(|a| *a < 3) {
        Some(1) => array = array.permuted_axes([1, 0, 2]),
        Some(2) => array = array.permuted_axes([2, 0, 1]),
        Some(_) => {}
        None => frames_come_first(&array, array.dim())?,
    }
    Ok(array.as_standard_layout().into_owned())
}

fn number(b: &[u8], header: &Header) -> f64 {
    let mut order = [0u8; 8];
    for (i, byte) in b.iter().enumerate() {
        let place = if header.big_endian { b.len() - 1 - i } else { i };
        order[place] = *byte;
    }
    let bits = u64::from_le_bytes(order);
    match (header.kind, b.len()) {
        ('f', 2) => half::f16::from_bits(bits as u16).into(),
        ('f', 4) => f32::from_bits(bits as u32).into(),
        ('f', _) => f64::from_bits(bits),
        ('i', n) => {
            let up = 64 - 8 * n as u32;
            ((bits << up) as i64 >> up) as f64
        }
        _ => bits as f64,
    }
}

/// Refuses a stack of shape (frames, rows, columns) if a part of it shows that the first axis may not
/// count the frames.
pub fn frames_come_first(array: &Array3<f64>, shape: (usize, usize, usize)) -> Result<(), String> {
    let (frames, rows, columns) = shape;
    let other = other_axis(array);
    if columns <= NARROWEST && columns < rows && columns < frames && other.is_none() {
        return Err(format!(
            "has the shape {shape:?}: {frames} frames of {columns} columns, or {columns} frames as the last axis counts them; say which: \
             --frames-axis 2 (or 0)"
        ));
    }
    match other {
        Some(other) => Err(format!(
            "has the shape {shape:?}, and its pixels repeat along axis {other}, not along axis 0 as in a stack (frames, rows, columns); say which axis \
             counts the frames: --frames-axis {other} (or 0)"
        )),
        None => Ok(()),
    }
}

/// Returns the axis along which the pixels repeat, if that is clearly not the first. Along the frame
/// axis a pixel varies only by its temporal noise, along the others also by offsets, dust and shading.
fn other_axis(array: &Array3<f64>) -> Option<usize> {
    let scatter = |axis: usize| {
        let n = array.len_of(Axis(axis)) as f64;
        let means: Array2<f64> = array.mean_axis(Axis(axis))?;
        let grand = means.mean()?;
        let mut sum = 0.0;
        for frame in array.axis_iter(Axis(axis)) {
            // The frame mean is subtracted: light that changes from frame to frame is not a pattern.
            let level = frame.mean()? - grand;
            sum += frame.iter().zip(&means).map(|(v, m)| (v - m - level).powi(2)).sum::<f64>();
        }
        (n >= 2.0).then(|| sum / ((n - 1.0) * (means.len() as f64 - 1.0).max(1.0)))
    };
    let first = scatter(0)?;
    let others = [1, 2].into_iter().filter_map(|axis| Some((axis, scatter(axis)?)));
    let (axis, least) = others.min_by(|a, b| a.1.total_cmp(&b.1))?;
    (least < CLEARLY_LESS * first).then_some(axis)
}

/// Maximum ratio of scatter along another axis to that along the first at which the other one counts the
/// frames. Column noise that changes from frame to frame brings axis 1 below 1 if the pixels have no
/// pattern of their own.
const CLEARLY_LESS: f64 = 0.8;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::image::NUMPY;

    fn npy(descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let text = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
        let mut out = NUMPY.to_vec();
        out.extend([1, 0]);
        out.extend((text.len() as u16).to_le_bytes());
        out.extend(text.bytes());
        out.extend(data);
        out
    }

    #[test]
    fn types_and_orders_are_read() {
        let of = |descr: &str, fortran: &str, shape: &str, data: &[u8]| {
            stack(&npy(descr, fortran, shape, data), None)
                .map(|a| (a.dim(), a.iter().copied().collect::<Vec<_>>()))
        };
        assert_eq!(of(">u2", "False", "(1, 2)", &[1, 0, 0, 7]), Ok(((1, 1, 2), vec![256.0, 7.0])));
        assert_eq!(of("<i2", "False", "(1, 2)", &[0xff, 0xff, 7, 0]), Ok(((1, 1, 2), vec![-1.0, 7.0])));
        let floats: Vec<u8> = [0.25f32, -1.5].iter().flat_map(|v| v.to_be_bytes()).collect();
        assert_eq!(of(">f4", "False", "(2, 1)", &floats), Ok(((1, 2, 1), vec![0.25, -1.5])));
        assert_eq!(of("|u1", "True", "(2, 2)", &[1, 2, 3, 4]), Ok(((1, 2, 2), vec![1.0, 3.0, 2.0, 4.0])));
        assert_eq!(
            of("|u1", "False", "(2, 1, 1, 2)", &[1, 2, 3, 4]),
            Ok(((2, 1, 2), vec![1.0, 2.0, 3.0, 4.0]))
        );
        // One channel behind rows and columns is not a stack of lines.
        assert_eq!(of("|u1", "False", "(2, 2, 1)", &[1, 2, 3, 4]), Ok(((1, 2, 2), vec![1.0, 2.0, 3.0, 4.0])));
        for (descr, shape, part) in [
            ("<c8", "(1, 2)", "'<c8'"),
            ("|O", "(1,)", "'|O'"),
            ("<u2", "(2, 3, 4, 5)", "cut short"),
            ("|u1", "(4,)", "1 axes"),
            ("|u1", "(1, 99999999999999)", "cut short"),
            ("|u1", "(0, 2)", "no frames"),
            ("|u1", "(3, 0, 5)", "no frames"),
            ("|u1", "(18446744073709551615, 0)", "no frames"),
            ("|u1", "(0, 9223372036854775807, 4)", "no frames"),
        ] {
            let said = of(descr, "False", shape, &[0; 4]).unwrap_err();
            assert!(said.contains(part), "{said}");
        }
    }
}
