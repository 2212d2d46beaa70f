//! OME-TIFF reader: exposure, channel and time of every plane (OME data model 2016-06).

use super::words::{self, Said, Writer};
use super::{Facts, headers};
use crate::dataset::image;
use quick_xml::events::{BytesStart, Event};
use std::collections::{BTreeMap, HashSet};
use std::path::Path;
use tiff::tags::Tag;

/// Returns true for an OME-XML description.
pub fn is_ome(text: &str) -> bool {
    let start = text.trim_start();
    let head = start.get(..start.len().min(1000)).unwrap_or(start);
    (start.starts_with("<?xml") || start.starts_with("<OME")) && head.contains("<OME")
}

/// Returns the attributes of an element by name.
fn attributes(element: &BytesStart<'_>) -> BTreeMap<String, String> {
    let of = |a: quick_xml::events::attributes::Attribute<'_>| {
        let name = String::from_utf8_lossy(a.key.local_name().as_ref()).into_owned();
        let value = String::from_utf8_lossy(&a.value).into_owned();
        let text = quick_xml::escape::unescape(&value).map(|t| t.into_owned());
        (name, text.unwrap_or(value))
    };
    element.attributes().filter_map(Result::ok).map(of).collect()
}

/// Attributes of the elements of the first image.
#[derive(Debug, Default)]
struct Ome {
    images: usize,
    pixels: BTreeMap<String, String>,
    channels: Vec<String>,
    planes: Vec<BTreeMap<String, String>>,
    /// Blocks of planes with their position in the file, and true if they are in this file.
    tiff_data: Vec<(BTreeMap<String, String>, bool)>,
    detectors: Vec<BTreeMap<String, String>>,
    settings: Vec<BTreeMap<String, String>>,
    date: Option<String>,
}

impl Ome {
    fn of(text: &str, file: &str) -> Self {
        let mut out = Self::default();
        let mut reader = quick_xml::Reader::from_str(text);
        let mut in_date = false;
        // A truncated description is used up to the error.
        while let Ok(event) = reader.read_event() {
            match event {
                Event::Start(e) | Event::Empty(e) => {
                    let name = e.local_name();
                    let of = attributes(&e);
                    in_date = name.as_ref() == b"AcquisitionDate";
                    match name.as_ref() {
                        b"Image" => out.images += 1,
                        b"Detector" => out.detectors.push(of),
                        // A second image is another stack.
                        _ if out.images > 1 => {}
                        b"Pixels" => out.pixels = of,
                        b"Channel" => out.channels.push(of.get("Name").cloned().unwrap_or_default()),
                        b"Plane" => out.planes.push(of),
                        b"TiffData" => out.tiff_data.push((of, true)),
                        b"UUID" => {
                            if let (Some(last), Some(name)) = (out.tiff_data.last_mut(), of.get("FileName")) {
                                last.1 = name == file;
                            }
                        }
                        b"DetectorSettings" => out.settings.push(of),
                        _ => {}
                    }
                }
                Event::Text(text) if in_date && out.images == 1 => {
                    out.date = Some(String::from_utf8_lossy(&text).trim().to_string());
                }
                Event::End(_) => in_date = false,
                Event::Eof => break,
                _ => {}
            }
        }
        out
    }

    fn size(&self, axis: char) -> usize {
        self.pixels.get(&format!("Size{axis}")).and_then(|n| n.parse().ok()).unwrap_or(1).max(1)
    }

    /// Returns the position of a plane in axis order.
    fn place(&self, at: &impl Fn(char) -> usize) -> usize {
        let order = self.pixels.get("DimensionOrder").map_or("XYZCT", String::as_str);
        let axes: Vec<char> = order.chars().filter(|c| matches!(c, 'Z' | 'C' | 'T')).collect();
        axes.iter()
            .rev()
            .fold(0usize, |place, axis| place.saturating_mul(self.size(*axis)).saturating_add(at(*axis)))
    }

    /// Returns the planes of a file that describes none, as tifffile writes it; none if they are not as many
    /// as the pages.
    fn all_planes(&self, pages: usize) -> Vec<BTreeMap<String, String>> {
        let sizes = ['C', 'Z', 'T'].map(|axis| self.size(axis));
        if sizes.iter().fold(1usize, |n, size| n.saturating_mul(*size)) != pages {
            return Vec::new();
        }
        let plane = |i: usize| {
            let at = [i % sizes[0], i / sizes[0] % sizes[1], i / sizes[0] / sizes[1]];
            ["TheC", "TheZ", "TheT"].into_iter().zip(at).map(|(key, n)| (key.into(), n.to_string())).collect()
        };
        (0..pages).map(plane).collect()
    }

    /// Returns the directories of the file that hold planes, in plane order: by TiffData if present
    /// (section "TiffData" of the OME-TIFF specification), else in axis order. If blocks overlap, the
    /// first takes precedence.
    fn directories(&self, places: &[usize]) -> Vec<Option<usize>> {
        if self.tiff_data.is_empty() {
            return places.iter().copied().map(Some).collect();
        }
        let mut order: Vec<usize> = (0..places.len()).collect();
        order.sort_by_key(|i| places[*i]);
        let mut out = vec![None; places.len()];
        // Next free position in `order`, so that a block with many planes does not rescan the occupied
        // ones.
        let mut free: Vec<usize> = (0..=order.len()).collect();
        for (block, _) in self.tiff_data.iter().filter(|(_, here)| *here) {
            let number = |key: &str| block.get(key).and_then(|n| n.parse::<usize>().ok());
            let first = self.place(&|axis| number(&format!("First{axis}")).unwrap_or(0));
            let from = number("IFD").unwrap_or(0);
            // Without a count: one plane where a directory is named, else all.
            let count = number("PlaneCount").or(number("IFD").map(|_| 1)).unwrap_or(usize::MAX);
            let end = first.saturating_add(count);
            let mut at = next_free(&mut free, order.partition_point(|i| places[*i] < first));
            while at < order.len() && places[order[at]] < end {
                let plane = order[at];
                out[plane] = Some(from.saturating_add(places[plane] - first));
                free[at] = at + 1;
                at = next_free(&mut free, at + 1);
            }
        }
        out
    }
}

/// Returns the first free position from `at`, with path compression.
fn next_free(free: &mut [usize], at: usize) -> usize {
    let mut end = at;
    while free[end] != end {
        end = free[end];
    }
    let mut on = at;
    while free[on] != end {
        on = std::mem::replace(&mut free[on], end);
    }
    end
}

/// Reads the facts of the file: its detector, and the exposure if equal for all planes.
pub fn facts(text: &str) -> Facts {
    let ome = Ome::of(text, "");
    let mut said = Vec::new();
    if let [detector] = &ome.detectors[..] {
        let names = [
            ("Model", "DeviceModelName"),
            ("Manufacturer", "DeviceVendorName"),
            ("SerialNumber", "DeviceSerialNumber"),
        ];
        let of = |(key, name): (&str, &str)| Some(Said::new(name, detector.get(key)?));
        said.extend(names.into_iter().filter_map(of));
    }
    if let Some(settings) = ome.settings.first() {
        let binning = settings.get("Binning").filter(|b| b.contains('x'));
        said.extend(binning.map(|b| Said::new("Binning", b)));
        said.extend(settings.get("Gain").map(|g| Said::new("GainRaw", g)));
    }
    said.extend(ome.date.as_deref().map(|d| Said::new("DateTime", d)));
    let mut out = words::facts(said, Writer::Lines);
    let mut exposures: Vec<Facts> = ome.planes.iter().map(|p| plane(&ome, p)).collect();
    exposures.dedup_by(|a, b| a.exposure_s == b.exposure_s);
    if let [one] = &exposures[..] {
        out = Facts { time_s: None, filter: None, ..one.clone() }.or(out);
    }
    out
}

/// Reads the facts of a plane.
fn plane(ome: &Ome, plane: &BTreeMap<String, String>) -> Facts {
    // Default unit of time of the schema: second.
    let unit = |key: &str| plane.get(key).map_or("s", String::as_str);
    let exposure = plane.get("ExposureTime").map(|t| format!("{t} {}", unit("ExposureTimeUnit")));
    let said = exposure.map(|e| Said::new("ExposureTime", &e));
    let mut out = words::facts(said.into_iter().collect(), Writer::Lines);
    if let Some(from) = out.from.get_mut("exposure_s") {
        *from = format!("OME Plane {from}");
    }
    let start = ome.date.as_deref().and_then(headers::time_s);
    let delta = plane.get("DeltaT").and_then(|t| t.parse::<f64>().ok());
    let unit_s = crate::number::seconds(unit("DeltaTUnit"));
    if let (Some(start), Some(delta), Some(unit_s)) = (start, delta, unit_s) {
        out.time_s = Some(start + delta * unit_s).filter(|t| t.is_finite());
    }
    let channel = plane.get("TheC").and_then(|n| n.parse::<usize>().ok()).unwrap_or(0);
    if ome.size('C') > 1 {
        let name = ome.channels.get(channel).filter(|n| !n.is_empty());
        out.filter = Some(name.cloned().unwrap_or_else(|| format!("channel {channel}")));
        out.doubts.extend(doubt_of_channel(channel));
    }
    out
}

/// Maximum number of channels of a hyperstack, and of one whose every page is a channel (named choices): a
/// stack saved with its frames as channels has more.
const MAX_CHANNELS: usize = 4;
const MAX_CHANNELS_ALONE: usize = 3;

/// Returns the channels of the pages of an ImageJ hyperstack; they come first in its order (XYCZT).
fn channels_of_imagej(text: &str, pages: &[usize]) -> BTreeMap<usize, Facts> {
    let said = |key: &str| {
        text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('=')?.trim().parse::<usize>().ok())
    };
    let most = |n: usize| if n == pages.len() { MAX_CHANNELS_ALONE } else { MAX_CHANNELS };
    let channels = said("channels").filter(|n| (2..=most(*n)).contains(n));
    let Some(channels) = channels.filter(|_| said("images") == Some(pages.len())) else {
        return BTreeMap::new();
    };
    let of = |(place, page): (usize, &usize)| {
        let channel = place % channels;
        let doubts = doubt_of_channel(channel).into_iter().collect();
        (*page, Facts { filter: Some(format!("channel {channel}")), doubts, ..Facts::default() })
    };
    pages.iter().enumerate().map(of).collect()
}

/// Returns the question that channels of a file raise, all but the first.
fn doubt_of_channel(channel: usize) -> Option<String> {
    (channel > 0).then(|| {
        format!("frames: channel {channel} of a file of several: another camera or filter? Keep the sets of one camera")
    })
}

/// Reads the facts of the pages of an OME-TIFF or an ImageJ hyperstack; empty for any other file.
pub fn planes(path: &Path, pages: &[usize]) -> BTreeMap<usize, Facts> {
    let text = || image::tiff_head(path).ok()?.get_tag_ascii_string(Tag::ImageDescription).ok();
    let text = text().unwrap_or_default();
    if text.starts_with("ImageJ=") {
        return channels_of_imagej(&text, pages);
    }
    if !is_ome(&text) {
        return BTreeMap::new();
    }
    let mut ome = Ome::of(&text, &path.file_name().unwrap_or_default().to_string_lossy());
    // Several images of a file count their planes separately, and only some programs state where each
    // begins.
    if ome.images != 1 {
        return BTreeMap::new();
    }
    if ome.planes.is_empty() && ome.size('C') > 1 {
        ome.planes = ome.all_planes(pages.len());
    }
    let place = |p: &BTreeMap<String, String>| {
        ome.place(&|axis: char| p.get(&format!("The{axis}")).and_then(|n| n.parse().ok()).unwrap_or(0))
    };
    let places: Vec<usize> = ome.planes.iter().map(place).collect();
    let known: HashSet<usize> = pages.iter().copied().collect();
    let planes = ome.planes.iter().zip(ome.directories(&places));
    let of = |(p, page): (&BTreeMap<String, String>, Option<usize>)| {
        let page = page.filter(|page| known.contains(page))?;
        Some((page, plane(&ome, p)))
    };
    planes.filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
        <OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">
        <Instrument ID="I:0"><Detector ID="D:0" Model="Zyla 4.2" Manufacturer="Andor" SerialNumber="VSC-1"/></Instrument>
        <Image ID="Image:0"><AcquisitionDate>2024-05-01T12:00:00</AcquisitionDate>
        <Pixels DimensionOrder="XYCZT" SizeC="2" SizeT="2" SizeX="4" SizeY="4" SizeZ="1" Type="uint16">
        <Channel ID="C:0" Name="red"/><Channel ID="C:1"/><TiffData/>
        <Plane TheC="0" TheT="0" TheZ="0" ExposureTime="20" ExposureTimeUnit="ms" DeltaT="0"/>
        <Plane TheC="1" TheT="0" TheZ="0" ExposureTime="0.5" DeltaT="1500" DeltaTUnit="ms"/>
        <Plane TheC="1" TheT="1" TheZ="0" ExposureTime="250" ExposureTimeUnit="&#181;s"/></Pixels></Image></OME>"#;

    fn place(ome: &Ome, (c, t): (usize, usize)) -> usize {
        ome.place(&|axis| [('C', c), ('T', t)].into_iter().find(|a| a.0 == axis).map_or(0, |a| a.1))
    }

    #[test]
    fn planes_have_their_own_exposures() {
        assert!(is_ome(TEXT) && !is_ome("<html>") && !is_ome("ImageJ=1.53"));
        let ome = Ome::of(TEXT, "a.ome.tif");
        let of: Vec<Facts> = ome.planes.iter().map(|p| plane(&ome, p)).collect();
        let exposures: Vec<_> = of.iter().map(|f| f.exposure_s.unwrap()).collect();
        assert_eq!(exposures, [0.02, 0.5, 0.00025]);
        assert_eq!(of[1].time_s.unwrap() - of[0].time_s.unwrap(), 1.5);
        assert_eq!((of[0].filter.as_deref(), of[1].filter.as_deref()), (Some("red"), Some("channel 1")));
        let of_file = facts(TEXT);
        assert_eq!(of_file.model.as_deref(), Some("Zyla 4.2"));
        assert_eq!((of_file.serial.as_deref(), of_file.exposure_s), (Some("VSC-1"), None));
        let places = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|at| place(&ome, at));
        assert_eq!(ome.directories(&places), [0, 1, 2, 3].map(Some));
    }

    #[test]
    fn blocks_of_planes_lie_where_they_say() {
        let block = r#"<TiffData IFD="7" FirstC="1" FirstT="1"/><TiffData IFD="0" PlaneCount="3"/>"#;
        let ome = Ome::of(&TEXT.replace("<TiffData/>", block), "a.ome.tif");
        let places = [(0, 0), (0, 1), (1, 1)].map(|at| place(&ome, at));
        assert_eq!(ome.directories(&places), [Some(0), Some(2), Some(7)]);
        let other = r#"<TiffData IFD="0" PlaneCount="4"><UUID FileName="b.ome.tif">urn</UUID></TiffData>"#;
        let ome = Ome::of(&TEXT.replace("<TiffData/>", other), "a.ome.tif");
        assert_eq!(ome.directories(&[0]), [None]);
    }
}
