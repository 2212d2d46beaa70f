//! The GenICam description of a served camera.
//!
//! A virtual camera cannot refuse what is written to a register, so every number passes a converter that keeps it within its bounds and on
//! its steps: what a client writes and reads back is what the camera does.

use super::processing::{BINNINGS, FEATURES, PATTERNS};
use super::{EXPOSURE_BASE_US, GAIN_STEP_DB, Names, Options, SCENES, SIZE_STEP, register, size};
use crate::camera::sim::formats_of;
use radcam_aravis::address;
use radcam_sim::Model;
use std::fmt::Write;

/// Builds the GenICam description file.
struct Description {
    categories: Vec<(&'static str, Vec<String>)>,
    nodes: String,
}

impl Description {
    fn list(&mut self, category: &'static str, name: &str) {
        match self.categories.iter_mut().find(|(known, _)| *known == category) {
            Some((_, names)) => names.push(name.into()),
            None => self.categories.push((category, vec![name.into()])),
        }
    }

    fn register(&mut self, name: &str, at: u32, access: &str) {
        let _ = writeln!(
            self.nodes,
            "<IntReg Name=\"{name}\" NameSpace=\"Custom\"><Address>{at:#x}</Address><Length>4</Length>\
             <AccessMode>{access}</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>\
             <Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
        );
    }

    fn text(&mut self, category: &'static str, name: &str, at: u32, length: u32) {
        self.list(category, name);
        let _ = writeln!(
            self.nodes,
            "<StringReg Name=\"{name}\" NameSpace=\"Standard\"><Address>{at:#x}</Address>\
             <Length>{length}</Length><AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>"
        );
    }

    /// An integer that nobody can change.
    fn constant(&mut self, category: &'static str, name: &str, at: u32) {
        self.list(category, name);
        let _ = writeln!(
            self.nodes,
            "<Integer Name=\"{name}\" NameSpace=\"Standard\"><pValue>{name}Reg</pValue></Integer>"
        );
        self.register(&format!("{name}Reg"), at, "RO");
    }

    /// An integer from `min` to the value of the node `max`, in steps.
    fn integer(&mut self, category: &'static str, name: &str, at: u32, (min, max, step): (u32, &str, u32)) {
        self.list(category, name);
        let _ = writeln!(
            self.nodes,
            "<Integer Name=\"{name}\" NameSpace=\"Standard\"><pValue>{name}Converter</pValue><Min>{min}</Min>\
             <pMax>{max}</pMax><Inc>{step}</Inc></Integer>"
        );
        let within = |x: &str| {
            format!(
                "({x} &lt; {min}) ? {min} : (({x} &gt; MOST) ? (MOST - (MOST - {min}) % {step}) : ({x} - ({x} - {min}) % {step}))"
            )
        };
        let _ = writeln!(
            self.nodes,
            "<IntConverter Name=\"{name}Converter\"><pVariable Name=\"MOST\">{max}</pVariable><FormulaTo>{}</FormulaTo>\
             <FormulaFrom>{}</FormulaFrom><pValue>{name}Reg</pValue><Slope>Increasing</Slope></IntConverter>",
            within("FROM"),
            within("TO")
        );
        self.register(&format!("{name}Reg"), at, "RW");
    }

    /// A number that other nodes compute with.
    fn number(&mut self, name: &str, formula: &str, variables: &[&str]) {
        let _ = write!(self.nodes, "<IntSwissKnife Name=\"{name}\">");
        for (letter, node) in ["A", "B"].iter().zip(variables) {
            let _ = write!(self.nodes, "<pVariable Name=\"{letter}\">{node}</pVariable>");
        }
        let _ = writeln!(self.nodes, "<Formula>{formula}</Formula></IntSwissKnife>");
    }

    /// A float within bounds, on steps where it has some. `access`: `RW` or `RO`.
    fn float(
        &mut self,
        category: &'static str,
        name: &str,
        at: u32,
        (min, max, step): (f64, f64, Option<f64>),
        [unit, access]: [&str; 2],
    ) {
        self.list(category, name);
        let inc = step.map_or(String::new(), |s| format!("<Inc>{s}</Inc>"));
        let _ = writeln!(
            self.nodes,
            "<Float Name=\"{name}\" NameSpace=\"Standard\"><pValue>{name}Converter</pValue><Min>{min}</Min>\
             <Max>{max}</Max>{inc}<Unit>{unit}</Unit></Float>"
        );
        let within = |x: &str| {
            let on_steps = match step {
                Some(s) => format!("{min} + FLOOR(({x} - {min}) / {s} + 0.5) * {s}"),
                None => x.to_string(),
            };
            format!("({x} &lt; {min}) ? {min} : (({x} &gt; {max}) ? {max} : ({on_steps}))")
        };
        let _ = writeln!(
            self.nodes,
            "<Converter Name=\"{name}Converter\"><FormulaTo>{}</FormulaTo><FormulaFrom>{}</FormulaFrom>\
             <pValue>{name}Reg</pValue><Slope>Increasing</Slope></Converter>\n\
             <FloatReg Name=\"{name}Reg\" NameSpace=\"Custom\"><Address>{at:#x}</Address><Length>8</Length>\
             <AccessMode>{access}</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>\
             <Endianess>BigEndian</Endianess></FloatReg>",
            within("FROM"),
            within("TO")
        );
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
        let _ = write!(self.nodes, "<Enumeration Name=\"{name}\" NameSpace=\"Standard\">");
        for (entry, value) in entries {
            let _ = write!(self.nodes, "<EnumEntry Name=\"{entry}\"><Value>{value}</Value></EnumEntry>");
        }
        let _ = writeln!(self.nodes, "<pValue>{name}Reg</pValue></Enumeration>");
        self.register(&format!("{name}Reg"), at, access);
    }

    fn boolean(&mut self, category: &'static str, name: &str, at: u32, access: &str) {
        self.list(category, name);
        let _ = writeln!(
            self.nodes,
            "<Boolean Name=\"{name}\"><pValue>{name}Reg</pValue><OnValue>1</OnValue><OffValue>0</OffValue>\
             </Boolean>"
        );
        self.register(&format!("{name}Reg"), at, access);
    }

    fn command(&mut self, category: &'static str, name: &str, reg: &str, value: u32) {
        self.list(category, name);
        let _ = writeln!(
            self.nodes,
            "<Command Name=\"{name}\" NameSpace=\"Standard\"><pValue>{reg}</pValue>\
             <CommandValue>{value}</CommandValue></Command>"
        );
    }
}

impl Description {
    /// What the camera does to its pixels beside measuring.
    fn processing(&mut self, options: &Options) {
        for (name, at) in FEATURES {
            let access = if options.stuck.iter().any(|(stuck, _)| stuck == name) { "RO" } else { "RW" };
            match name {
                "Gamma" => self.float("AnalogControl", name, at, (0.25, 4.0, None), ["1", access]),
                "TestPattern" => self.enumeration("ImageFormatControl", name, at, &PATTERNS, access),
                "BinningHorizontal" | "BinningVertical" => {
                    let entries = BINNINGS.map(|n| (n.to_string(), n));
                    let entries: Vec<_> = entries.iter().map(|(text, n)| (text.as_str(), *n)).collect();
                    self.binning(name, at, &entries, access);
                }
                _ => self.boolean("ImageFormatControl", name, at, access),
            }
        }
    }

    /// Binning is an integer; powers of two are all it takes.
    fn binning(&mut self, name: &str, at: u32, entries: &[(&str, u32)], access: &str) {
        self.list("ImageFormatControl", name);
        let most = entries.iter().map(|e| e.1).max().unwrap_or(1);
        let within = |x: &str| format!("({x} &lt; 2) ? 1 : (({x} &lt; {most}) ? 2 : {most})");
        let _ = writeln!(
            self.nodes,
            "<Integer Name=\"{name}\" NameSpace=\"Standard\"><pValue>{name}Converter</pValue><Min>1</Min><Max>{most}</Max>\
             </Integer>\n<IntConverter Name=\"{name}Converter\"><FormulaTo>{}</FormulaTo><FormulaFrom>{}</FormulaFrom>\
             <pValue>{name}Reg</pValue><Slope>Increasing</Slope></IntConverter>",
            within("FROM"),
            within("TO")
        );
        self.register(&format!("{name}Reg"), at, access);
    }

    /// Exposure, gain and black level under the names of this generation of cameras.
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

    /// A selector of one entry, as cameras of one tap have it.
    fn only_all(&mut self, name: &str) {
        self.list("AnalogControl", name);
        let _ = writeln!(
            self.nodes,
            "<Enumeration Name=\"{name}\" NameSpace=\"Standard\"><EnumEntry Name=\"All\"><Value>0</Value></EnumEntry>\
             <Value>0</Value></Enumeration>"
        );
    }
}

/// The GenICam description of a sensor (GenApi 1.0 schema, names of the Standard Features Naming Convention).
pub fn of(model: &Model, options: &Options) -> String {
    let body = &model.camera;
    let (w, h) = (size(body.width), size(body.height));
    let mut d = Description { categories: Vec::new(), nodes: String::new() };

    d.text("DeviceControl", "DeviceVendorName", address::VENDOR, 32);
    d.text("DeviceControl", "DeviceModelName", address::MODEL, 32);
    d.text("DeviceControl", "DeviceVersion", address::VERSION, 32);
    d.text("DeviceControl", "DeviceID", 0xd8, 16);
    d.text("DeviceControl", "DeviceSerialNumber", 0xd8, 16);
    d.float(
        "DeviceControl",
        "DeviceTemperature",
        register::TEMPERATURE_C,
        (-100.0, 150.0, None),
        ["C", "RW"],
    );

    d.constant("ImageFormatControl", "SensorWidth", address::SENSOR_WIDTH);
    d.constant("ImageFormatControl", "SensorHeight", address::SENSOR_HEIGHT);
    // Binning leaves so many whole steps; the offset shares them with the size.
    let step = SIZE_STEP;
    for (size, sensor, binning, offset) in [
        ("Width", "SensorWidth", "BinningHorizontal", "OffsetX"),
        ("Height", "SensorHeight", "BinningVertical", "OffsetY"),
    ] {
        let most = format!("(A / B / {step} * {step} &gt; 0) ? (A / B / {step} * {step}) : 1");
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

    let modes = [("Continuous", 1), ("SingleFrame", 2), ("MultiFrame", 3)];
    d.enumeration("AcquisitionControl", "AcquisitionMode", 0x12c, &modes, "RW");
    d.register("AcquisitionReg", 0x124, "WO");
    d.command("AcquisitionControl", "AcquisitionStart", "AcquisitionReg", 1);
    d.command("AcquisitionControl", "AcquisitionStop", "AcquisitionReg", 0);
    d.list("AcquisitionControl", "AcquisitionFrameRate");
    d.nodes.push_str(
        "<Float Name=\"AcquisitionFrameRate\" NameSpace=\"Standard\"><pValue>FrameRateConverter</pValue>\
         <Min>0.1</Min><Max>1000</Max><Unit>Hz</Unit></Float>\n\
         <Converter Name=\"FrameRateConverter\">\
         <FormulaTo>1000000 / ((FROM &lt; 0.1) ? 0.1 : ((FROM &gt; 1000) ? 1000 : FROM))</FormulaTo>\
         <FormulaFrom>1000000 / ((TO &lt; 1000) ? 1000 : ((TO &gt; 10000000) ? 10000000 : TO))</FormulaFrom><pValue>FramePeriodReg</pValue><Slope>Decreasing</Slope></Converter>\n",
    );
    d.register("FramePeriodReg", address::FRAME_PERIOD_US, "RW");
    d.settings(model, options.names);
    d.list("AcquisitionControl", "TriggerSelector");
    d.nodes.push_str(
        "<Enumeration Name=\"TriggerSelector\" NameSpace=\"Standard\"><EnumEntry Name=\"FrameStart\">\
         <Value>0</Value></EnumEntry><Value>0</Value></Enumeration>\n",
    );
    d.enumeration("AcquisitionControl", "TriggerMode", 0x300, &[("Off", 0), ("On", 1)], "RW");
    d.enumeration("AcquisitionControl", "TriggerSource", 0x304, &[("Line0", 0), ("Software", 1)], "RW");
    d.enumeration("AcquisitionControl", "TriggerActivation", 0x308, &[("RisingEdge", 0)], "RW");
    d.register("TriggerSoftwareReg", 0x30c, "WO");
    d.command("AcquisitionControl", "TriggerSoftware", "TriggerSoftwareReg", 1);

    d.float(
        "BenchControl",
        "BenchIllumination",
        register::ILLUMINATION,
        (0.0, 1e6, None),
        ["relative", "RW"],
    );
    d.boolean("BenchControl", "BenchDark", register::DARK, "RW");
    d.number("BenchConfigurationMax", "1000000", &[]);
    d.integer("BenchControl", "BenchConfiguration", register::CONFIGURATION, (0, "BenchConfigurationMax", 1));
    d.enumeration("BenchControl", "BenchScene", register::SCENE, &SCENES.map(|(name, n, _)| (name, n)), "RW");

    d.list("TransportLayerControl", "PayloadSize");
    d.nodes.push_str(
        "<IntSwissKnife Name=\"PayloadSize\" NameSpace=\"Standard\"><pVariable Name=\"W\">Width</pVariable>\
         <pVariable Name=\"H\">Height</pVariable><pVariable Name=\"P\">PixelFormat</pVariable>\
         <Formula>W * H * ((P &gt;&gt; 16) &amp; 0xFF) / 8</Formula></IntSwissKnife>\n\
         <Integer Name=\"TLParamsLocked\"><Visibility>Invisible</Visibility><Value>0</Value><Min>0</Min>\
         <Max>1</Max></Integer>\n<Port Name=\"Device\" NameSpace=\"Standard\"/>\n",
    );

    let escape = |s: &str| s.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;");
    let mut xml = format!(
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<RegisterDescription ModelName=\"{}\" VendorName=\"{}\" \
         StandardNameSpace=\"GEV\" SchemaMajorVersion=\"1\" SchemaMinorVersion=\"0\" SchemaSubMinorVersion=\"1\" \
         MajorVersion=\"1\" MinorVersion=\"0\" SubMinorVersion=\"0\" ToolTip=\"{}\" \
         ProductGuid=\"0\" VersionGuid=\"0\" xmlns=\"http://www.genicam.org/GenApi/Version_1_0\">\n",
        escape(&body.model),
        escape(&body.vendor),
        escape(&model.about),
    );
    xml.push_str("<Category Name=\"Root\" NameSpace=\"Standard\">");
    for (category, _) in &d.categories {
        let _ = write!(xml, "<pFeature>{category}</pFeature>");
    }
    xml.push_str("</Category>\n");
    for (category, names) in &d.categories {
        let _ = write!(xml, "<Category Name=\"{category}\">");
        for name in names {
            let _ = write!(xml, "<pFeature>{name}</pFeature>");
        }
        xml.push_str("</Category>\n");
    }
    xml + &d.nodes + "</RegisterDescription>\n"
}
