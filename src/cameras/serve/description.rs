//! GenICam description file of a served camera.
//!
//! A virtual camera cannot refuse a register write. Every number therefore passes a converter that keeps it
//! within its bounds and steps: the value that a client reads back is the value in use.

use super::files::{self, BUFFER, DEFECTS};
use super::gige::address;
use super::processing::{BINNINGS, FEATURES, FLAT_FIELDS, PATTERNS};
use super::{EXPOSURE_BASE_US, GAIN_STEP_DB, Names, Options, SCENES, SIZE_STEP, register, size};
use crate::camera::sim::formats_of;
use crate::pixel_format::PixelFormat;
use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesText, Event};
use radcam_sim::Model;

/// Builds the GenICam description file.
struct Description {
    categories: Vec<(&'static str, Vec<String>)>,
    nodes: Writer<Vec<u8>>,
}

/// Panic message of writes that only go to memory and cannot fail.
const MEMORY: &str = "writes to memory";

/// Returns the attributes of a node. Names of the Standard Features Naming Convention are `Standard`; the
/// bench and the nodes behind features are `Custom`.
fn attributes<'a>(tag: &str, name: &'a str) -> [(&'a str, &'a str); 2] {
    let behind = tag.ends_with("Converter") || ["IntReg", "FloatReg"].contains(&tag) || name.ends_with("Max");
    let space = if behind || name.starts_with("Bench") { "Custom" } else { "Standard" };
    [("Name", name), ("NameSpace", space)]
}

impl Description {
    fn list(&mut self, category: &'static str, name: &str) {
        match self.categories.iter_mut().find(|(known, _)| *known == category) {
            Some((_, names)) => names.push(name.into()),
            None => self.categories.push((category, vec![name.into()])),
        }
    }

    /// Adds a node with its elements, each a tag and a text.
    fn node(&mut self, tag: &str, name: &str, elements: &[(&str, &str)]) {
        let inner = |w: &mut Writer<Vec<u8>>| {
            elements.iter().try_for_each(|(tag, text)| {
                // `pVariable:A` names a variable of a formula; `pIndex:8` is an index in steps of 8 bytes.
                let (tag, variable) = tag.split_once(':').map_or((*tag, None), |(t, v)| (t, Some(v)));
                let element = w.create_element(tag);
                let attribute = if tag == "pIndex" { "Offset" } else { "Name" };
                let element = variable.into_iter().fold(element, |e, v| e.with_attribute((attribute, v)));
                element.write_text_content(BytesText::new(text)).map(drop)
            })
        };
        let element = self.nodes.create_element(tag).with_attributes(attributes(tag, name));
        element.write_inner_content(inner).expect(MEMORY);
    }

    fn register(&mut self, name: &str, at: u32, access: &str) {
        let address = format!("{at:#x}");
        self.node(
            "IntReg",
            name,
            &[
                ("Address", &address),
                ("Length", "4"),
                ("AccessMode", access),
                ("pPort", "Device"),
                ("Cachable", "NoCache"),
                ("Sign", "Unsigned"),
                ("Endianess", "BigEndian"),
            ],
        );
    }

    fn text(&mut self, category: &'static str, name: &str, at: u32, length: u32) {
        self.list(category, name);
        let (address, length) = (format!("{at:#x}"), length.to_string());
        let elements =
            [("Address", &*address), ("Length", &length), ("AccessMode", "RO"), ("pPort", "Device")];
        self.node("StringReg", name, &elements);
    }

    /// Adds a read-only integer.
    fn constant(&mut self, category: &'static str, name: &str, at: u32) {
        self.list(category, name);
        let register = format!("{name}Reg");
        self.node("Integer", name, &[("pValue", &register)]);
        self.register(&register, at, "RO");
    }

    /// Adds a converter that keeps its value within bounds, by formulas of `FROM` and `TO`, in front of the
    /// register.
    fn converter(
        &mut self,
        tag: &str,
        name: &str,
        variable: Option<(&str, &str)>,
        within: impl Fn(&str) -> String,
    ) {
        let (to, from, register) = (within("FROM"), within("TO"), format!("{name}Reg"));
        let mut elements: Vec<(&str, &str)> = variable.into_iter().collect();
        elements.extend([
            ("FormulaTo", &*to),
            ("FormulaFrom", &from),
            ("pValue", &register),
            ("Slope", "Increasing"),
        ]);
        self.node(tag, &format!("{name}Converter"), &elements);
    }

    /// Adds an integer from `min` to the value of the node `max`, in steps.
    fn integer(&mut self, category: &'static str, name: &str, at: u32, (min, max, step): (u32, &str, u32)) {
        self.list(category, name);
        let (least, inc, converter) = (min.to_string(), step.to_string(), format!("{name}Converter"));
        let elements = [("pValue", &*converter), ("Min", &least), ("pMax", max), ("Inc", &inc)];
        self.node("Integer", name, &elements);
        self.converter("IntConverter", name, Some(("pVariable:MOST", max)), |x| {
            format!("({x} < {min}) ? {min} : (({x} > MOST) ? (MOST - (MOST - {min}) % {step}) : ({x} - ({x} - {min}) % {step}))")
        });
        self.register(&format!("{name}Reg"), at, "RW");
    }

    /// Adds a number used in formulas of other nodes.
    fn number(&mut self, name: &str, formula: &str, variables: &[&str]) {
        let mut elements: Vec<(&str, &str)> =
            ["pVariable:A", "pVariable:B"].into_iter().zip(variables.iter().copied()).collect();
        elements.push(("Formula", formula));
        self.node("IntSwissKnife", name, &elements);
    }

    /// Adds a float within bounds, optionally in steps. `access`: `RW` or `RO`.
    fn float(
        &mut self,
        category: &'static str,
        name: &str,
        at: u32,
        (min, max, step): (f64, f64, Option<f64>),
        [unit, access]: [&str; 2],
    ) {
        self.list(category, name);
        let converter = format!("{name}Converter");
        let (least, most, inc) = (min.to_string(), max.to_string(), step.map(|s| s.to_string()));
        let mut elements = vec![("pValue", &*converter), ("Min", &least), ("Max", &most)];
        elements.extend(inc.as_deref().map(|inc| ("Inc", inc)));
        elements.push(("Unit", unit));
        self.node("Float", name, &elements);
        self.converter("Converter", name, None, |x| {
            let on_steps = match step {
                Some(s) => format!("{min} + FLOOR(({x} - {min}) / {s} + 0.5) * {s}"),
                None => x.to_string(),
            };
            format!("({x} < {min}) ? {min} : (({x} > {max}) ? {max} : ({on_steps}))")
        });
        let address = format!("{at:#x}");
        self.node(
            "FloatReg",
            &format!("{name}Reg"),
            &[
                ("Address", &address),
                ("Length", "8"),
                ("AccessMode", access),
                ("pPort", "Device"),
                ("Cachable", "NoCache"),
                ("Endianess", "BigEndian"),
            ],
        );
    }

    /// Adds an enumeration whose value is in an element: `pValue` with a register, or an own `Value`.
    fn entries(&mut self, name: &str, entries: &[(&str, u32)], (tag, value): (&str, &str)) {
        let inner = |w: &mut Writer<Vec<u8>>| {
            for (entry, value) in entries {
                let of_entry = |w: &mut Writer<Vec<u8>>| {
                    w.create_element("Value").write_text_content(BytesText::new(&value.to_string())).map(drop)
                };
                w.create_element("EnumEntry")
                    .with_attribute(("Name", *entry))
                    .write_inner_content(of_entry)?;
            }
            w.create_element(tag).write_text_content(BytesText::new(value)).map(drop)
        };
        let element =
            self.nodes.create_element("Enumeration").with_attributes(attributes("Enumeration", name));
        element.write_inner_content(inner).expect(MEMORY);
    }

    fn enumeration(
        &mut self,
        category: &'static str,
        name: &str,
        at: u32,
        entries: &[(&str, u32)],
        access: &str,
    ) {
        self.list(category, name);
        let register = format!("{name}Reg");
        self.entries(name, entries, ("pValue", &register));
        self.register(&register, at, access);
    }

    fn boolean(&mut self, category: &'static str, name: &str, at: u32, access: &str) {
        self.list(category, name);
        let register = format!("{name}Reg");
        self.node("Boolean", name, &[("pValue", &register), ("OnValue", "1"), ("OffValue", "0")]);
        self.register(&register, at, access);
    }

    fn command(&mut self, category: &'static str, name: &str, reg: &str, value: u32) {
        self.list(category, name);
        self.node("Command", name, &[("pValue", reg), ("CommandValue", &value.to_string())]);
    }
}

impl Description {
    /// Adds the image processing features.
    fn processing(&mut self, options: &Options) {
        for (name, at) in FEATURES {
            let access = if options.stuck.iter().any(|(stuck, _)| stuck == name) { "RO" } else { "RW" };
            match name {
                "Gamma" => self.float("AnalogControl", name, at, (0.25, 4.0, None), ["1", access]),
                "TestPattern" => self.enumeration("ImageFormatControl", name, at, &PATTERNS, access),
                "FlatFieldCorrectionMode" => {
                    self.enumeration("ImageFormatControl", name, at, &FLAT_FIELDS, access);
                }
                "BinningHorizontal" | "BinningVertical" => {
                    let entries = BINNINGS.map(|n| (n.to_string(), n));
                    let entries: Vec<_> = entries.iter().map(|(text, n)| (text.as_str(), *n)).collect();
                    self.binning(name, at, &entries, access);
                }
                _ => self.boolean("ImageFormatControl", name, at, access),
            }
        }
    }

    /// Adds the user-writable memory: files (SFNC 2.7, chapter File Access Control), and a defect list as in
    /// FLIR cameras.
    fn memory(&mut self) {
        let category = "FileAccessControl";
        for (name, at, entries, access) in [
            ("FileSelector", register::FILE_SELECTOR, &files::NAMES[..], "RW"),
            ("FileOperationSelector", register::FILE_OPERATION, &files::OPERATIONS[..], "RW"),
            ("FileOpenMode", register::FILE_OPEN_MODE, &files::MODES[..], "RW"),
            ("FileOperationStatus", register::FILE_STATUS, &files::STATUSES[..], "RO"),
        ] {
            self.enumeration(category, name, at, entries, access);
        }
        self.register("FileOperationExecuteReg", register::FILE_EXECUTE, "RW");
        self.command(category, "FileOperationExecute", "FileOperationExecuteReg", 1);
        self.constant(category, "FileOperationResult", register::FILE_RESULT);
        self.constant(category, "FileSize", register::FILE_SIZE);
        self.number("FileAccessOffsetMax", &u32::MAX.to_string(), &[]);
        self.integer(category, "FileAccessOffset", register::FILE_OFFSET, (0, "FileAccessOffsetMax", 1));
        self.number("FileAccessLengthMax", &BUFFER.to_string(), &[]);
        self.integer(category, "FileAccessLength", register::FILE_LENGTH, (0, "FileAccessLengthMax", 1));
        self.list(category, "FileAccessBuffer");
        let (address, length) = (format!("{:#x}", register::FILE_BUFFER), BUFFER.to_string());
        let buffer =
            [("Address", &*address), ("Length", &*length), ("AccessMode", "RW"), ("pPort", "Device")];
        self.node("Register", "FileAccessBuffer", &[&buffer[..], &[("Cachable", "NoCache")]].concat());

        let category = "ImageFormatControl";
        self.number("DefectTablePixelCountMax", &DEFECTS.to_string(), &[]);
        self.integer(
            category,
            "DefectTablePixelCount",
            register::DEFECT_COUNT,
            (0, "DefectTablePixelCountMax", 1),
        );
        self.number("DefectTableIndexMax", &(DEFECTS - 1).to_string(), &[]);
        self.integer(category, "DefectTableIndex", register::DEFECT_INDEX, (0, "DefectTableIndexMax", 1));
        for (name, at) in [("DefectTableCoordinateX", 0), ("DefectTableCoordinateY", 4)] {
            self.list(category, name);
            let (address, register) = (format!("{:#x}", register::DEFECT_LIST + at), format!("{name}Reg"));
            self.node("Integer", name, &[("pValue", &register)]);
            let elements = [
                ("Address", &*address),
                ("pIndex:8", "DefectTableIndex"),
                ("Length", "4"),
                ("AccessMode", "RW"),
                ("pPort", "Device"),
                ("Cachable", "NoCache"),
                ("Sign", "Unsigned"),
                ("Endianess", "BigEndian"),
            ];
            self.node("IntReg", &register, &elements);
        }
        self.register("DefectTableApplyReg", register::DEFECT_APPLY, "RW");
        self.command(category, "DefectTableApply", "DefectTableApplyReg", 1);
        self.command(category, "DefectTableFactoryRestore", "DefectTableApplyReg", 0);
    }

    /// Adds a binning factor: an integer that takes only powers of two.
    fn binning(&mut self, name: &str, at: u32, entries: &[(&str, u32)], access: &str) {
        self.list("ImageFormatControl", name);
        let most = entries.iter().map(|e| e.1).max().unwrap_or(1);
        let (most_text, converter) = (most.to_string(), format!("{name}Converter"));
        self.node("Integer", name, &[("pValue", &converter), ("Min", "1"), ("Max", &most_text)]);
        self.converter("IntConverter", name, None, |x| {
            format!("({x} < 2) ? 1 : (({x} < {most}) ? 2 : {most})")
        });
        self.register(&format!("{name}Reg"), at, access);
    }

    /// Adds exposure, gain and black level under the names of this camera generation.
    fn settings(&mut self, model: &Model, names: Names) {
        let body = &model.camera;
        let exposure_us =
            (1e6 * body.exposure_min_s, 1e6 * body.exposure_max_s, Some(1e6 * body.exposure_increment_s));
        let gain_db = (0.0, body.gain_max_db, None);
        let full_scale = model.full_scale_dn();
        let (acquisition, analog) = ("AcquisitionControl", "AnalogControl");
        match names {
            Names::Current => {
                self.float(acquisition, "ExposureTime", register::EXPOSURE_US, exposure_us, ["us", "RW"]);
                self.float(analog, "Gain", register::GAIN_DB, gain_db, ["dB", "RW"]);
                let black = (0.0, f64::from(full_scale), None);
                self.float(analog, "BlackLevel", register::BLACK_LEVEL, black, ["DN", "RW"]);
                return;
            }
            Names::Abs => {
                self.float(acquisition, "ExposureTimeAbs", register::EXPOSURE_US, exposure_us, ["us", "RW"]);
                self.only_all("GainSelector");
                self.float(analog, "GainAbs", register::GAIN_DB, gain_db, ["dB", "RW"]);
            }
            Names::Raw => {
                let base = (EXPOSURE_BASE_US, EXPOSURE_BASE_US, None);
                let at = register::EXPOSURE_BASE_US;
                self.float(acquisition, "ExposureTimeBaseAbs", at, base, ["us", "RO"]);
                let steps = |us: f64| (us / EXPOSURE_BASE_US) as u32;
                self.number("ExposureTimeRawMax", &steps(exposure_us.1).to_string(), &[]);
                let bounds = (steps(exposure_us.0).max(1), "ExposureTimeRawMax", 1);
                self.integer(acquisition, "ExposureTimeRaw", register::EXPOSURE_RAW, bounds);
                self.only_all("GainSelector");
                let most = (body.gain_max_db / GAIN_STEP_DB) as u32;
                self.number("GainRawMax", &most.to_string(), &[]);
                self.integer(analog, "GainRaw", register::GAIN_RAW, (0, "GainRawMax", 1));
            }
        }
        self.only_all("BlackLevelSelector");
        self.number("BlackLevelRawMax", &full_scale.to_string(), &[]);
        self.integer(analog, "BlackLevelRaw", register::BLACK_RAW, (0, "BlackLevelRawMax", 1));
    }

    /// Adds a selector with one entry, as in cameras with one tap.
    fn only_all(&mut self, name: &str) {
        self.list("AnalogControl", name);
        self.entries(name, &[("All", 0)], ("Value", "0"));
    }
}

impl Description {
    /// Creates a description with the identity of the camera.
    fn of_device() -> Self {
        let mut d = Self { categories: Vec::new(), nodes: Writer::new_with_indent(Vec::new(), b' ', 1) };
        d.text("DeviceControl", "DeviceVendorName", address::VENDOR, 32);
        d.text("DeviceControl", "DeviceModelName", address::MODEL, 32);
        d.text("DeviceControl", "DeviceVersion", address::VERSION, 32);
        d.text("DeviceControl", "DeviceID", 0xd8, 16);
        d.text("DeviceControl", "DeviceSerialNumber", 0xd8, 16);
        d
    }

    /// Adds acquisition start and stop.
    fn acquisition(&mut self) {
        let modes = [("Continuous", 1), ("SingleFrame", 2), ("MultiFrame", 3)];
        self.enumeration("AcquisitionControl", "AcquisitionMode", 0x12c, &modes, "RW");
        self.register("AcquisitionReg", address::ACQUISITION, "WO");
        self.command("AcquisitionControl", "AcquisitionStart", "AcquisitionReg", 1);
        self.command("AcquisitionControl", "AcquisitionStop", "AcquisitionReg", 0);
    }

    /// Adds the payload size, bytes.
    fn transport(&mut self) {
        self.list("TransportLayerControl", "PayloadSize");
        self.node(
            "IntSwissKnife",
            "PayloadSize",
            &[
                ("pVariable:W", "Width"),
                ("pVariable:H", "Height"),
                ("pVariable:P", "PixelFormat"),
                ("Formula", "W * H * ((P >> 16) & 0xFF) / 8"),
            ],
        );
        self.node(
            "Integer",
            "TLParamsLocked",
            &[("Visibility", "Invisible"), ("Value", "0"), ("Min", "0"), ("Max", "1")],
        );
        self.node("Port", "Device", &[]);
    }

    /// Returns the file, with the features in their categories.
    fn finish(self, vendor: &str, model: &str, about: &str) -> String {
        let d = self;
        let mut xml = Writer::new_with_indent(Vec::new(), b' ', 1);
        xml.write_event(Event::Decl(BytesDecl::new("1.0", Some("utf-8"), None))).expect(MEMORY);
        let root = xml.create_element("RegisterDescription").with_attributes([
            ("ModelName", model),
            ("VendorName", vendor),
            ("ToolTip", about),
            ("StandardNameSpace", "GEV"),
            ("SchemaMajorVersion", "1"),
            ("SchemaMinorVersion", "0"),
            ("SchemaSubMinorVersion", "1"),
            ("MajorVersion", "1"),
            ("MinorVersion", "0"),
            ("SubMinorVersion", "0"),
            ("ProductGuid", "0"),
            ("VersionGuid", "0"),
            ("xmlns", "http://www.genicam.org/GenApi/Version_1_0"),
        ]);
        let nodes = String::from_utf8(d.nodes.into_inner()).expect(MEMORY);
        let features = |w: &mut Writer<Vec<u8>>, category: &str, names: &[&str]| {
            let list = |w: &mut Writer<Vec<u8>>| {
                names.iter().try_for_each(|name| {
                    w.create_element("pFeature").write_text_content(BytesText::new(name)).map(drop)
                })
            };
            let element = w.create_element("Category").with_attributes(attributes("Category", category));
            element.write_inner_content(list).map(drop)
        };
        let inner = |w: &mut Writer<Vec<u8>>| {
            let categories: Vec<&str> = d.categories.iter().map(|(category, _)| *category).collect();
            features(w, "Root", &categories)?;
            for (category, names) in &d.categories {
                features(w, category, &names.iter().map(String::as_str).collect::<Vec<_>>())?;
            }
            w.write_event(Event::Text(BytesText::from_escaped(nodes.as_str())))
        };
        root.write_inner_content(inner).expect(MEMORY);
        String::from_utf8(xml.into_inner()).expect(MEMORY)
    }
}

/// Returns the description of a camera that relays frames of another: read-only.
pub fn of_relay(vendor: &str, model: &str, about: &str, format: PixelFormat) -> String {
    let mut d = Description::of_device();
    d.constant("ImageFormatControl", "SensorWidth", address::SENSOR_WIDTH);
    d.constant("ImageFormatControl", "SensorHeight", address::SENSOR_HEIGHT);
    d.constant("ImageFormatControl", "Width", address::WIDTH);
    d.constant("ImageFormatControl", "Height", address::HEIGHT);
    d.constant("ImageFormatControl", "OffsetX", address::OFFSET_X);
    d.constant("ImageFormatControl", "OffsetY", address::OFFSET_Y);
    let entry = [(format.name(), format.code())];
    d.enumeration("ImageFormatControl", "PixelFormat", address::PIXEL_FORMAT, &entry, "RO");
    d.acquisition();
    let exposure = (0.0, 1e12, None);
    d.float("AcquisitionControl", "ExposureTime", register::EXPOSURE_US, exposure, ["us", "RO"]);
    d.transport();
    d.finish(vendor, model, about)
}

/// Returns the GenICam description of a sensor (GenApi 1.0 schema, names of the Standard Features Naming
/// Convention).
pub fn of(model: &Model, options: &Options) -> String {
    let body = &model.camera;
    let (w, h) = (size(body.width), size(body.height));
    let mut d = Description::of_device();
    d.float(
        "DeviceControl",
        "DeviceTemperature",
        register::TEMPERATURE_C,
        (-100.0, 150.0, None),
        ["C", "RW"],
    );

    d.constant("ImageFormatControl", "SensorWidth", address::SENSOR_WIDTH);
    d.constant("ImageFormatControl", "SensorHeight", address::SENSOR_HEIGHT);
    // Maximum size after binning, in whole steps; offset and size share it.
    let step = SIZE_STEP;
    for (size, sensor, binning, offset) in [
        ("Width", "SensorWidth", "BinningHorizontal", "OffsetX"),
        ("Height", "SensorHeight", "BinningVertical", "OffsetY"),
    ] {
        let most = format!("(A / B / {step} * {step} > 0) ? (A / B / {step} * {step}) : 1");
        d.number(&format!("{size}Max"), &most, &[sensor, binning]);
        d.number(&format!("{offset}Max"), "A - B", &[&format!("{size}Max"), size]);
    }
    let sized = |max: u32| (step.min(max), if max < step { 1 } else { step });
    let ((min_w, step_w), (min_h, step_h)) = (sized(w), sized(h));
    d.integer("ImageFormatControl", "Width", address::WIDTH, (min_w, "WidthMax", step_w));
    d.integer("ImageFormatControl", "Height", address::HEIGHT, (min_h, "HeightMax", step_h));
    d.integer("ImageFormatControl", "OffsetX", address::OFFSET_X, (0, "OffsetXMax", 1));
    d.integer("ImageFormatControl", "OffsetY", address::OFFSET_Y, (0, "OffsetYMax", 1));
    let formats: Vec<_> = formats_of(body.bit_depth).iter().map(|f| (f.name(), f.code())).collect();
    d.enumeration("ImageFormatControl", "PixelFormat", address::PIXEL_FORMAT, &formats, "RW");
    d.processing(options);
    d.memory();

    d.acquisition();
    d.list("AcquisitionControl", "AcquisitionFrameRate");
    let hz = [("pValue", "FrameRateConverter"), ("Min", "0.1"), ("Max", "1000"), ("Unit", "Hz")];
    d.node("Float", "AcquisitionFrameRate", &hz);
    d.node(
        "Converter",
        "FrameRateConverter",
        &[
            ("FormulaTo", "1000000 / ((FROM < 0.1) ? 0.1 : ((FROM > 1000) ? 1000 : FROM))"),
            ("FormulaFrom", "1000000 / ((TO < 1000) ? 1000 : ((TO > 10000000) ? 10000000 : TO))"),
            ("pValue", "FramePeriodReg"),
            ("Slope", "Decreasing"),
        ],
    );
    d.register("FramePeriodReg", address::FRAME_PERIOD_US, "RW");
    d.settings(model, options.names);
    d.list("AcquisitionControl", "TriggerSelector");
    d.entries("TriggerSelector", &[("FrameStart", 0)], ("Value", "0"));
    d.enumeration("AcquisitionControl", "TriggerMode", address::TRIGGER_MODE, &[("Off", 0), ("On", 1)], "RW");
    d.enumeration(
        "AcquisitionControl",
        "TriggerSource",
        address::TRIGGER_SOURCE,
        &[("Line0", 0), ("Software", 1)],
        "RW",
    );
    d.enumeration("AcquisitionControl", "TriggerActivation", 0x308, &[("RisingEdge", 0)], "RW");
    d.register("TriggerSoftwareReg", address::TRIGGER_SOFTWARE, "WO");
    d.command("AcquisitionControl", "TriggerSoftware", "TriggerSoftwareReg", 1);

    d.float(
        "BenchControl",
        "BenchIllumination",
        register::ILLUMINATION,
        (0.0, 1e6, None),
        ["relative", "RW"],
    );
    d.float(
        "BenchControl",
        "BenchPhotonFlux",
        register::PHOTON_FLUX,
        (0.0, 1e15, None),
        ["photons/px/s", "RO"],
    );
    d.boolean("BenchControl", "BenchDark", register::DARK, "RW");
    d.number("BenchConfigurationMax", "1000000", &[]);
    d.integer("BenchControl", "BenchConfiguration", register::CONFIGURATION, (0, "BenchConfigurationMax", 1));
    d.number("BenchFrameMax", &u32::MAX.to_string(), &[]);
    d.integer("BenchControl", "BenchFrame", register::FRAME, (0, "BenchFrameMax", 1));
    d.float("BenchControl", "BenchTime", register::TIME_S, (0.0, 1e9, None), ["s", "RW"]);
    d.enumeration("BenchControl", "BenchScene", register::SCENE, &SCENES.map(|(name, n, _)| (name, n)), "RW");

    d.transport();
    d.finish(&body.vendor, &body.model, &model.about)
}
