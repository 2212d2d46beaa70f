//! TIFF as programs write it: sample formats, packing, mosaics, stacks of ImageJ, planes of OME.

use crate::containers::{Camera, Folder, SIDE, frames, tiff, two};
use crate::support::{expect, refused};
use ndarray::Array2;
use radcam::dataset::Dataset;
use std::fs;
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::{Gray8, Gray16, Gray32Float, GrayI16};
use tiff::tags::Tag;

#[test]
fn tiff_of_every_kind_is_read() {
    let [(_, dark), (_, flat)] = two();
    for kind in ["int16", "float", "thumbnail", "mosaic", "packed", "reversed", "behind one"] {
        let folder = Folder::new();
        for (name, frame) in two() {
            let path = folder.file(&format!("{name}.tif"));
            match kind {
                "int16" => tiff::<GrayI16>(&path, &[frame.mapv(|v| v as i16)], ""),
                "float" => tiff::<Gray32Float>(&path, &[frame.mapv(f32::from)], ""),
                "thumbnail" => {
                    let mut encoder = TiffEncoder::new(fs::File::create(&path).unwrap()).unwrap();
                    encoder
                        .write_image::<Gray16>(SIDE as u32, SIDE as u32, frame.as_slice().unwrap())
                        .unwrap();
                    let mut small = encoder.new_image::<Gray8>(8, 8).unwrap();
                    small.encoder().write_tag(Tag::NewSubfileType, 1u32).unwrap();
                    small.write_data(&[7; 64]).unwrap();
                }
                _ => tiff::<Gray16>(&path, std::slice::from_ref(&frame), ""),
            }
            let mut bytes = fs::read(&path).unwrap();
            match kind {
                "mosaic" => set_tag(&mut bytes, 262, 32_803),
                "packed" => {
                    set_tag(&mut bytes, 258, 12);
                    pack(&mut bytes, &frame);
                }
                "reversed" => {
                    let (from, length) = (tag(&bytes, 273), SIDE * SIDE * 2);
                    bytes[from..from + length].iter_mut().for_each(|b| *b = b.reverse_bits());
                    // Orientation is not needed, FillOrder is.
                    rename_tag(&mut bytes, 296, 266);
                    set_tag(&mut bytes, 266, 2);
                }
                "behind one" => {
                    tiff::<Gray16>(&path, std::slice::from_ref(&frame), "ImageJ=1.53t\nimages=3\nslices=3\n");
                    bytes = fs::read(&path).unwrap();
                    bytes = behind_one(bytes, &frame);
                }
                _ => {}
            }
            fs::write(&path, bytes).unwrap();
        }
        if kind == "mosaic" {
            let said = refused(&["import", &folder.text("in"), "-o", &folder.text("d"), "--yes"]);
            assert!(said.contains("--plane"), "{said}");
            expect(0, &["import", &folder.text("in"), "-o", &folder.text("d"), "--yes", "--plane", "0,1"]);
            let dataset = Dataset::open(&folder.0.path().join("d")).unwrap();
            let plane = flat.slice(ndarray::s![..;2, 1..;2]).to_owned();
            assert_eq!(frames(&dataset)[1], plane);
            continue;
        }
        let (said, dataset) = folder.import();
        let found = frames(&dataset);
        if kind == "behind one" {
            assert_eq!(found.len(), 6, "{said}");
            assert_eq!((&found[0], &found[4]), (&dark, &flat.mapv(|v| v + 1)), "{kind}");
        } else {
            assert_eq!(found, [dark.clone(), flat.clone()], "{kind}: {said}");
        }
    }
}

/// Place of the value of a tag in the first directory of a little-endian TIFF.
fn place(bytes: &[u8], tag: u16) -> usize {
    let long = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let directory = long(4);
    let count = usize::from(u16::from_le_bytes([bytes[directory], bytes[directory + 1]]));
    let entries = (0..count).map(|k| directory + 2 + 12 * k);
    let found = entries.into_iter().find(|at| bytes[*at..*at + 2] == tag.to_le_bytes());
    found.unwrap_or_else(|| panic!("no tag {tag}")) + 8
}

fn tag(bytes: &[u8], tag: u16) -> usize {
    let at = place(bytes, tag);
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
}

fn set_tag(bytes: &mut [u8], tag: u16, value: u16) {
    let at = place(bytes, tag);
    bytes[at..at + 2].copy_from_slice(&value.to_le_bytes());
}

pub fn rename_tag(bytes: &mut [u8], tag: u16, to: u16) {
    let at = place(bytes, tag) - 8;
    bytes[at..at + 2].copy_from_slice(&to.to_le_bytes());
}

/// Twelve bits a pixel, two pixels in three bytes, in one strip at the end.
fn pack(bytes: &mut Vec<u8>, frame: &Array2<u16>) {
    let from = bytes.len() as u32;
    let codes: Vec<u16> = frame.iter().copied().collect();
    let length = codes.len() / 2 * 3;
    for pair in codes.chunks(2) {
        bytes.extend([(pair[0] >> 4) as u8, (pair[0] << 4 | pair[1] >> 8) as u8, pair[1] as u8]);
    }
    one_strip(bytes, from, length as u32);
}

/// Directs the only strip somewhere else.
fn one_strip(bytes: &mut [u8], from: u32, length: u32) {
    for (tag, value) in [(273, from), (279, length)] {
        let at = place(bytes, tag);
        // One LONG: the strips that there were are no more.
        bytes[at - 6..at - 4].copy_from_slice(&4u16.to_le_bytes());
        bytes[at - 4..at].copy_from_slice(&1u32.to_le_bytes());
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }
    let at = place(bytes, 278);
    bytes[at..at + 4].copy_from_slice(&(SIDE as u32).to_le_bytes()[..4]);
}

/// Three frames one behind the other, and one directory.
fn behind_one(mut bytes: Vec<u8>, frame: &Array2<u16>) -> Vec<u8> {
    let from = bytes.len() as u32;
    for k in 0..3u16 {
        bytes.extend(frame.iter().flat_map(|v| (v + k).to_le_bytes()));
    }
    one_strip(&mut bytes, from, (SIDE * SIDE * 2) as u32);
    bytes
}

/// OME-TIFF: planes of one file are parted by their exposure and channel, and the detector is the camera.
#[test]
fn planes_of_ome_tiff_have_their_own_exposures() {
    let camera = Camera { bits: 12, gain: 0.5, read_noise_e: 2.0, black_dn: 32.0, most_e: 7000.0 };
    let folder = Folder::new();
    let plane = |t: usize, ms: f64, unit: &str| {
        format!(r#"<Plane TheC="0" TheT="{t}" TheZ="0" ExposureTime="{ms}"{unit} DeltaT="{t}"/>"#)
    };
    let planes: String = (0..8)
        .map(|t| match t / 4 {
            0 => plane(t, 20.0, r#" ExposureTimeUnit="ms""#),
            // The schema's unit is the second.
            _ => plane(t, 0.04, ""),
        })
        .collect();
    let text = format!(
        r#"<?xml version="1.0" encoding="UTF-8"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Instrument ID="Instrument:0"><Detector ID="Detector:0" Model="Zyla 4.2" Manufacturer="Andor" SerialNumber="VSC-1"/></Instrument><Image ID="Image:0"><AcquisitionDate>2024-05-01T12:00:00</AcquisitionDate><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint16" SizeX="{SIDE}" SizeY="{SIDE}" SizeZ="1" SizeC="1" SizeT="8"><Channel ID="Channel:0:0"/><TiffData/>{planes}</Pixels></Image></OME>"#
    );
    let frames: Vec<Array2<u16>> = (0..8).map(|t| camera.frame(t, if t < 4 { 0.3 } else { 0.6 })).collect();
    tiff::<Gray16>(&folder.file("flats.ome.tif"), &frames, &text);
    let (said, dataset) = folder.import();
    let of = |set: &radcam::dataset::Set| (dataset.settings(set).exposure_s, set.rows.len());
    assert_eq!(dataset.sets().iter().map(of).collect::<Vec<_>>(), [(0.02, 4), (0.04, 4)], "{said}");
    let info = &dataset.manifest().camera;
    assert_eq!((&*info.vendor, &*info.model, &*info.serial), ("Andor", "Zyla 4.2", "VSC-1"));
    assert_eq!(dataset.rows()[7].timestamp_s, Some(7.0));
}

/// Two channels of a stack, of OME without planes and of ImageJ, are two sets: frames of two cameras are no
/// repeats.
#[test]
fn channels_of_stacks_part_sets() {
    let camera = Camera { bits: 12, gain: 0.5, read_noise_e: 2.0, black_dn: 32.0, most_e: 7000.0 };
    let ome = format!(
        r#"<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYCZT" Type="uint16" SizeX="{SIDE}" SizeY="{SIDE}" SizeZ="1" SizeC="2" SizeT="6"><Channel ID="Channel:0:0" Name="left"/><Channel ID="Channel:0:1" Name="right"/><TiffData IFD="0" PlaneCount="12"/></Pixels></Image></OME>"#
    );
    let imagej = "ImageJ=1.53t\nimages=12\nchannels=2\nframes=6\nhyperstack=true\n".to_string();
    for text in [ome, imagej] {
        let folder = Folder::new();
        let of = |lights: [f64; 2]| -> Vec<Array2<u16>> {
            (0..12).map(|t| camera.frame(t, lights[t as usize % 2])).collect()
        };
        tiff::<Gray16>(&folder.file("flats_20ms.tif"), &of([0.6, 0.3]), &text);
        tiff::<Gray16>(&folder.file("darks_20ms.tif"), &of([0.0, 0.0]), &text);
        let said = refused(&["import", &folder.text("in"), "-o", &folder.text("d"), "--yes"]);
        assert!(said.contains("channel 1 of a file of several"), "{said}");
        // The sets of one camera are kept.
        let path = folder.text("d.map.toml");
        let map = fs::read_to_string(&path).unwrap();
        let (head, sets) = map.split_once("[[set]]").unwrap();
        let kept: Vec<&str> = sets.split("[[set]]").filter(|set| !set.contains("channel 1 of")).collect();
        assert_eq!((sets.split("[[set]]").count(), kept.len()), (4, 2), "{map}");
        fs::write(&path, format!("{head}[[set]]{}", kept.join("[[set]]"))).unwrap();
        expect(0, &["import", "--map", &path, "-o", &folder.text("d")]);
        let dataset = Dataset::open(folder.text("d").as_ref()).unwrap();
        for set in dataset.sets() {
            let frames = dataset.read_set(set).unwrap();
            let means: Vec<f64> = frames.iter().map(|f| f.mapv(f64::from).mean().unwrap()).collect();
            assert!(means.len() == 6 && means.iter().all(|m| (m - means[0]).abs() < 20.0), "{means:?}");
        }
    }
}
