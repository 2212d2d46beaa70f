//! A camera and its features.

use crate::socket::{self, OpenSocket};
use crate::stream::{Stream, StreamSetup};
use crate::{Error, Named};
use aravis::glib::prelude::*;
use aravis::glib::translate::{ToGlibPtr, from_glib_full};
use aravis::prelude::*;
use aravis::{AccessCheckPolicy, GvPacketSizeAdjustment, RangeCheckPolicy};
use std::collections::BTreeSet;
use std::ffi::{CStr, c_char};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Device on the network or on USB.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeviceInfo {
    /// Id given by Aravis.
    pub id: String,
    /// IP address or USB path.
    pub address: String,
    /// Manufacturer.
    pub vendor: String,
    /// Model name.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// `GigEVision`, `USB3Vision`.
    pub protocol: String,
}

/// Copies a string that libaravis owns.
fn text(pointer: *const c_char) -> String {
    if pointer.is_null() {
        return String::new();
    }
    // SAFETY: libaravis returns either null or a NUL-terminated string that lives until the device list is next
    // updated; it is copied here before anything else is called.
    unsafe { CStr::from_ptr(pointer) }.to_string_lossy().into_owned()
}

/// Converts the success flag and the error of a libaravis call into a result.
fn done(success: i32, error: *mut aravis::glib::ffi::GError, what: &str) -> Result<(), Error> {
    if success != 0 {
        return Ok(());
    }
    if error.is_null() {
        return Err(Error::new(what, "refused"));
    }
    // SAFETY: libaravis gave this error to the caller, who frees it.
    let error: aravis::glib::Error = unsafe { from_glib_full(error) };
    Err(Error::new(what, error.message()))
}

/// Lists the cameras on all networks and USB. Takes about a second.
pub fn devices() -> Vec<DeviceInfo> {
    // The library owns the device list: only one thread may use it at a time.
    static LIST: std::sync::Mutex<()> = std::sync::Mutex::new(());
    let _one = LIST.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let _only = socket::opening();
    // SAFETY: plain calls without arguments; the library initialises itself.
    let count = unsafe {
        aravis_sys::arv_update_device_list();
        aravis_sys::arv_get_n_devices()
    };
    let info = |i| {
        // SAFETY: i is below the number of devices just asked for, and the lock keeps the list as it is.
        let [id, address, vendor, model, serial, protocol] = unsafe {
            [
                aravis_sys::arv_get_device_id(i),
                aravis_sys::arv_get_device_address(i),
                aravis_sys::arv_get_device_vendor(i),
                aravis_sys::arv_get_device_model(i),
                aravis_sys::arv_get_device_serial_nbr(i),
                aravis_sys::arv_get_device_protocol(i),
            ]
        };
        DeviceInfo {
            id: text(id),
            address: text(address),
            vendor: text(vendor),
            model: text(model),
            serial: text(serial),
            protocol: text(protocol),
        }
    };
    (0..count).map(info).collect()
}

/// Type of a feature's value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeatureKind {
    /// Boolean.
    Boolean,
    /// One of several names.
    Enumeration,
    /// Integer.
    Integer,
    /// Floating-point number.
    Float,
    /// Text.
    Text,
}

/// Feature of the camera's description.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Feature {
    /// GenICam name.
    pub name: String,
    /// Type of its value.
    pub kind: FeatureKind,
    /// Features selected by this one (selector).
    pub selected: Vec<String>,
}

/// Describes a node as a feature; `None` if it has no value.
fn described(name: String, node: &aravis::GcNode) -> Option<Feature> {
    let kind = if node.is::<aravis::GcBoolean>() {
        FeatureKind::Boolean
    } else if node.is::<aravis::GcEnumeration>() {
        FeatureKind::Enumeration
    } else if node.is::<aravis::GcFloat>() {
        FeatureKind::Float
    } else if node.is::<aravis::GcInteger>() {
        FeatureKind::Integer
    } else if node.is::<aravis::GcString>() {
        FeatureKind::Text
    } else {
        return None;
    };
    let selector = node.dynamic_cast_ref::<aravis::GcSelector>().filter(|s| s.is_selector());
    let selected = selector.map(|s| s.selected_features()).unwrap_or_default();
    let selected = selected.iter().filter_map(|f| f.name()).map(Into::into).collect();
    Some(Feature { name, kind, selected })
}

/// Reads `size` bytes of a camera's memory.
pub(crate) fn memory(camera: &aravis::Camera, address: u64, size: u32) -> Result<Vec<u8>, Error> {
    let what = format!("memory at {address:#x}");
    let device = camera.device().ok_or_else(|| Error::new(&what, "no device"))?;
    let mut bytes = vec![0; size as usize];
    let mut error = std::ptr::null_mut();
    // SAFETY: the device is alive by our reference, `size` bytes at `bytes` are ours, and the error is null
    // or ours to free.
    let read = unsafe {
        aravis_sys::arv_device_read_memory(
            device.to_glib_none().0,
            address,
            size,
            bytes.as_mut_ptr().cast(),
            &mut error,
        )
    };
    done(read, error, &what).map(|()| bytes)
}

/// Limits the control socket (the new one) to packets from the camera: answers of other hosts could be taken
/// for its own, or make libaravis wait for weeks.
fn hear_only(camera: &aravis::Camera, before: &BTreeSet<OpenSocket>) {
    let Some(address) = crate::stream::address_of(camera) else { return };
    let now = socket::udp_sockets();
    let mut new = now.difference(before);
    let (Some(only), None) = (new.next(), new.next()) else {
        tracing::debug!("the control socket was not found");
        return;
    };
    if let Err(e) = socket::answers_of(address).and_then(|program| socket::attach(only.fd, &program)) {
        tracing::warn!(error = %e, "the control socket hears everybody");
    }
}

/// An open camera, controlled by this process.
#[derive(Debug)]
pub struct Camera {
    inner: aravis::Camera,
    lost: Arc<AtomicBool>,
}

impl Camera {
    /// Opens a camera by IP address, or by the id that [`devices`] gives.
    ///
    /// On a machine with several interfaces the address is safer: opened by name, Aravis may listen for
    /// frames on another interface.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no camera answers by that name.
    pub fn open(name: &str) -> Result<Self, Error> {
        let inner = {
            let _only = socket::opening();
            let before = socket::udp_sockets();
            let inner = aravis::Camera::new(Some(name)).named("open")?;
            hear_only(&inner, &before);
            inner
        };
        // Both checks are off by default: gain 99 of at most 24 would be accepted.
        inner.set_range_check_policy(RangeCheckPolicy::Enable);
        inner.set_access_check_policy(AccessCheckPolicy::Enable);
        let lost = Arc::new(AtomicBool::new(false));
        if let Some(device) = inner.device() {
            let flag = Arc::clone(&lost);
            // Runs on the heartbeat thread: dropping the last handle of the camera there would abort.
            device.connect_control_lost(move |_| flag.store(true, Ordering::Release));
        }
        Ok(Self { inner, lost })
    }

    /// Returns true if the heartbeat has failed.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Acquire)
    }

    /// Returns true if a GigE Vision camera supports packet resend (GVCP capability register, GigE Vision
    /// 2.0, 28.4).
    pub fn resends(&self) -> bool {
        const GVCP_CAPABILITY: u64 = 0x934;
        const PACKET_RESEND: u8 = 1 << 2;
        self.is_gigevision()
            && self.memory(GVCP_CAPABILITY, 4).is_ok_and(|b| b.last().is_some_and(|b| b & PACKET_RESEND != 0))
    }

    /// Returns true if this process may write to the camera. GigE Vision gives control to one client at a
    /// time; others may only read.
    pub fn has_control(&self) -> bool {
        let device = self.inner.device().and_then(|d| d.downcast::<aravis::GvDevice>().ok());
        device.is_none_or(|d| d.is_controller())
    }

    /// Returns (vendor, model, serial number).
    ///
    /// # Errors
    ///
    /// Aravis reports an error: the camera does not answer.
    pub fn identity(&self) -> Result<(String, String, String), Error> {
        let vendor = self.inner.vendor_name().named("DeviceVendorName")?;
        let model = self.inner.model_name().named("DeviceModelName")?;
        let serial = self.inner.device_serial_number().map(Into::into).unwrap_or_default();
        Ok((vendor.into(), model.into(), serial))
    }

    /// Returns true for a GigE Vision camera.
    pub fn is_gigevision(&self) -> bool {
        self.inner.is_gv_device()
    }

    /// Stops the acquisition, also one started by another client.
    ///
    /// # Errors
    ///
    /// The camera refuses.
    pub fn stop_acquisition(&self) -> Result<(), Error> {
        self.inner.stop_acquisition().named("AcquisitionStop")
    }

    /// Returns every feature with a value in the description's categories, available now or not.
    pub fn features(&self) -> Vec<Feature> {
        let Some(description) = self.inner.device().and_then(|d| d.genicam()) else { return Vec::new() };
        let mut out: Vec<Feature> = Vec::new();
        let mut categories = vec!["Root".to_string()];
        let mut seen = std::collections::BTreeSet::new();
        while let Some(name) = categories.pop() {
            // A description may list a feature twice, or a category within itself.
            if !seen.insert(name.clone()) {
                continue;
            }
            let Some(node) = description.node(&name) else { continue };
            if let Some(category) = node.downcast_ref::<aravis::GcCategory>() {
                categories.extend(category.features().into_iter().map(Into::into));
                continue;
            }
            out.extend(described(name, &node));
        }
        out.sort_by(|a, b| a.name.cmp(&b.name));
        out
    }

    /// Returns a feature by its name, in a category or not; `None` if no feature of that name has a value.
    pub fn feature(&self, name: &str) -> Option<Feature> {
        let node = self.inner.device()?.genicam()?.node(name)?;
        described(name.into(), &node)
    }

    /// Returns the camera's description file.
    pub fn description(&self) -> Option<String> {
        let (text, _) = self.inner.device()?.genicam_xml();
        Some(text.into())
    }

    /// Reads `size` bytes of the camera's memory. Bootstrap registers start at 0 (GigE Vision 2.0, chapter
    /// 28).
    ///
    /// # Errors
    ///
    /// Aravis reports an error: the memory is not readable.
    pub fn memory(&self, address: u64, size: u32) -> Result<Vec<u8>, Error> {
        memory(&self.inner, address, size)
    }

    /// Writes the camera's memory.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: the memory is not writable.
    pub fn set_memory(&self, address: u64, bytes: &[u8]) -> Result<(), Error> {
        let what = format!("memory at {address:#x}");
        let device = self.inner.device().ok_or_else(|| Error::new(&what, "no device"))?;
        let size = u32::try_from(bytes.len()).map_err(|e| Error::new(&what, e))?;
        let mut error = std::ptr::null_mut();
        // SAFETY: the device is alive by our reference, libaravis copies `size` bytes from `bytes` and does
        // not write to them, and the error is null or ours to free.
        let written = unsafe {
            aravis_sys::arv_device_write_memory(
                device.to_glib_none().0,
                address,
                size,
                bytes.as_ptr().cast_mut().cast(),
                &mut error,
            )
        };
        done(written, error, &what)
    }

    /// Returns address and length in bytes of a register feature.
    ///
    /// # Errors
    ///
    /// There is no such feature, or it is not a register.
    pub fn register(&self, feature: &str) -> Result<(u64, u64), Error> {
        let node = self.inner.device().and_then(|d| d.feature(feature));
        let node = node.ok_or_else(|| Error::new(feature, "not found"))?;
        let register = node
            .dynamic_cast_ref::<aravis::GcRegister>()
            .ok_or_else(|| Error::new(feature, "no register"))?;
        Ok((register.address().named(feature)?, register.length().named(feature)?))
    }

    /// Returns true once an executed command is done: its register no longer holds the written value (GenApi,
    /// IsDone). A command with an unreadable register counts as done.
    pub fn is_done(&self, command: &str) -> bool {
        let node = self.inner.device().and_then(|d| d.feature(command));
        let mut child = node.and_then(|n| n.first_child());
        let (mut written, mut now) = (1, None);
        while let Some(node) = child {
            if let Some(property) = node.downcast_ref::<aravis::GcPropertyNode>() {
                match aravis::prelude::GcPropertyNodeExt::node_type(property) {
                    aravis::GcPropertyNodeType::CommandValue => {
                        written = property.int64().unwrap_or(written);
                    }
                    // Its value is that of the register behind it.
                    aravis::GcPropertyNodeType::PValue => now = property.int64().ok(),
                    _ => {}
                }
            }
            child = node.next_sibling();
        }
        now.is_none_or(|now| now != written)
    }

    /// Returns true if the feature exists and is available now.
    pub fn has(&self, feature: &str) -> bool {
        self.inner.is_feature_available(feature).unwrap_or(false)
    }

    /// Reads a float.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn float(&self, feature: &str) -> Result<f64, Error> {
        self.inner.float(feature).named(feature)
    }

    /// Returns minimum and maximum of a float.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn float_bounds(&self, feature: &str) -> Result<(f64, f64), Error> {
        self.inner.float_bounds(feature).named(feature)
    }

    /// Returns the increment of a float; `None` without one.
    pub fn float_increment(&self, feature: &str) -> Option<f64> {
        // Aravis returns DBL_MIN for a float without an increment.
        self.inner.float_increment(feature).ok().filter(|step| *step > 1e-300)
    }

    /// Returns the unit of a float feature, if the camera states it.
    pub fn unit(&self, feature: &str) -> Option<String> {
        let node = self.inner.device()?.feature(feature)?;
        node.downcast_ref::<aravis::GcFloatNode>()?.unit().map(Into::into)
    }

    /// Writes a float.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn set_float(&self, feature: &str, value: f64) -> Result<(), Error> {
        self.inner.set_float(feature, value).named(feature)
    }

    /// Reads an integer.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn integer(&self, feature: &str) -> Result<i64, Error> {
        self.inner.integer(feature).named(feature)
    }

    /// Returns minimum and maximum of an integer.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn integer_bounds(&self, feature: &str) -> Result<(i64, i64), Error> {
        self.inner.integer_bounds(feature).named(feature)
    }

    /// Returns the increment of an integer.
    pub fn integer_increment(&self, feature: &str) -> i64 {
        self.inner.integer_increment(feature).map_or(1, |step| step.max(1))
    }

    /// Writes an integer.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn set_integer(&self, feature: &str, value: i64) -> Result<(), Error> {
        self.inner.set_integer(feature, value).named(feature)
    }

    /// Reads a boolean.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn boolean(&self, feature: &str) -> Result<bool, Error> {
        self.inner.boolean(feature).named(feature)
    }

    /// Writes a boolean.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn set_boolean(&self, feature: &str, value: bool) -> Result<(), Error> {
        self.inner.set_boolean(feature, value).named(feature)
    }

    /// Reads a string or the entry of an enumeration.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn string(&self, feature: &str) -> Result<String, Error> {
        self.inner.string(feature).map(Into::into).named(feature)
    }

    /// Writes a string or the entry of an enumeration.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn set_string(&self, feature: &str, value: &str) -> Result<(), Error> {
        self.inner.set_string(feature, value).named(feature)
    }

    /// Returns the entries of an enumeration that are available now.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn entries(&self, feature: &str) -> Result<Vec<String>, Error> {
        let entries = self.inner.dup_available_enumerations_as_strings(feature).named(feature)?;
        Ok(entries.into_iter().map(Into::into).collect())
    }

    /// Executes a command.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn execute(&self, feature: &str) -> Result<(), Error> {
        self.inner.execute_command(feature).named(feature)
    }

    /// Reads the exposure, s, under any of the usual feature names.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn exposure_s(&self) -> Result<f64, Error> {
        self.inner.exposure_time().map(|us| us * 1e-6).named("ExposureTime")
    }

    /// Returns minimum and maximum exposure, s.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn exposure_bounds_s(&self) -> Result<(f64, f64), Error> {
        let (min, max) = self.inner.exposure_time_bounds().named("ExposureTime")?;
        Ok((min * 1e-6, max * 1e-6))
    }

    /// Sets the exposure, s.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn set_exposure_s(&self, value: f64) -> Result<(), Error> {
        self.inner.set_exposure_time(value * 1e6).named("ExposureTime")
    }

    /// Reads the gain in the camera's unit, under any of the usual feature names.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn gain(&self) -> Result<f64, Error> {
        self.inner.gain().named("Gain")
    }

    /// Returns minimum and maximum gain.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn gain_bounds(&self) -> Result<(f64, f64), Error> {
        self.inner.gain_bounds().named("Gain")
    }

    /// Sets the gain.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn set_gain(&self, value: f64) -> Result<(), Error> {
        self.inner.set_gain(value).named("Gain")
    }

    /// Returns true if the camera has a gain.
    pub fn has_gain(&self) -> bool {
        self.inner.is_gain_available().unwrap_or(false)
    }

    /// Reads the frame rate, Hz.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn frame_rate_hz(&self) -> Result<f64, Error> {
        self.inner.frame_rate().named("AcquisitionFrameRate")
    }

    /// Returns minimum and maximum frame rate, Hz.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn frame_rate_bounds_hz(&self) -> Result<(f64, f64), Error> {
        self.inner.frame_rate_bounds().named("AcquisitionFrameRate")
    }

    /// Sets the frame rate; this also puts the camera into free run.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn set_frame_rate_hz(&self, value: f64) -> Result<(), Error> {
        self.inner.set_frame_rate(value).named("AcquisitionFrameRate")
    }

    /// Reads the PFNC code of the pixel format.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn pixel_format(&self) -> Result<u32, Error> {
        self.inner.pixel_format().map(|f| f.raw()).named("PixelFormat")
    }

    /// Returns the PFNC codes of the pixel formats available now.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn pixel_formats(&self) -> Result<Vec<u32>, Error> {
        let codes = self.inner.dup_available_pixel_formats().named("PixelFormat")?;
        Ok(codes.into_iter().filter_map(|c| u32::try_from(c).ok()).collect())
    }

    /// Sets the pixel format by its PFNC code.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn set_pixel_format(&self, code: u32) -> Result<(), Error> {
        self.inner.set_pixel_format(aravis::PixelFormat::from_raw(code)).named("PixelFormat")
    }

    /// Reads x, y, width, height of the region, pixels.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn region(&self) -> Result<[i32; 4], Error> {
        let (x, y, w, h) = self.inner.region().named("Width")?;
        Ok([x, y, w, h])
    }

    /// Sets x, y, width, height of the region, pixels.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn set_region(&self, [x, y, w, h]: [i32; 4]) -> Result<(), Error> {
        self.inner.set_region(x, y, w, h).named("Width")
    }

    /// Puts the camera into software trigger mode.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn set_software_trigger(&self) -> Result<(), Error> {
        self.inner.set_trigger("Software").named("TriggerMode")
    }

    /// Puts the camera into free run.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn clear_triggers(&self) -> Result<(), Error> {
        self.inner.clear_triggers().named("TriggerMode")
    }

    /// Sends one software trigger.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no such feature, not readable or writable now, or no answer from the camera.
    pub fn software_trigger(&self) -> Result<(), Error> {
        self.inner.software_trigger().named("TriggerSoftware")
    }

    /// Starts an acquisition. Settings cannot be changed until the stream is dropped.
    ///
    /// # Errors
    ///
    /// Aravis reports an error: no stream can be set up, for example for lack of memory or of a route to the
    /// camera.
    pub fn stream(&mut self, setup: &StreamSetup) -> Result<Stream<'_>, Error> {
        if self.is_gigevision() {
            match setup.packet_size {
                Some(size) => {
                    let size = i32::try_from(size).map_err(|e| Error::new("GevSCPSPacketSize", e))?;
                    self.inner.gv_set_packet_size(size).named("GevSCPSPacketSize")?;
                }
                None => {
                    self.inner.gv_set_packet_size_adjustment(GvPacketSizeAdjustment::OnFailureOnce);
                    if let Err(e) = self.inner.gv_auto_packet_size() {
                        tracing::debug!(error = e.message(), "packet size left as it is");
                    }
                }
            }
        }
        Stream::start(&self.inner, setup, Arc::clone(&self.lost))
    }

    /// Returns the GigE Vision packet size, bytes.
    pub fn packet_size(&self) -> Option<u32> {
        self.is_gigevision().then(|| self.inner.gv_get_packet_size().ok()).flatten()
    }
}
