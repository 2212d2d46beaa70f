//! Exceptions, named as the errors of the Rust crate.

use pyo3::exceptions::PyException;
use pyo3::prelude::*;

macro_rules! errors {
    ($($python:ident $($rust:ty)*;)*) => {
        pyo3::create_exception!(radcam, RadcamError, PyException, "What radcam could not do.");
        $(pyo3::create_exception!(radcam, $python, RadcamError);)*

        /// Conversion of an error into the exception of its name.
        pub trait Raised {
            /// Returns the exception.
            fn raised(self) -> PyErr;
        }

        $($(impl Raised for $rust {
            fn raised(self) -> PyErr {
                $python::new_err(self.to_string())
            }
        })*)*

        pub fn add(m: &Bound<'_, PyModule>) -> PyResult<()> {
            let py = m.py();
            m.add("RadcamError", py.get_type::<RadcamError>())?;
            $(m.add(stringify!($python), py.get_type::<$python>())?;)*
            Ok(())
        }
    };
}

errors! {
    CalibrateError radcam::calibrate::CalibrateError radcam::calibrate::file::FileError;
    CameraError radcam::camera::CameraError;
    CaptureError;
    CorrectError radcam::correct::CorrectError;
    DatasetError;
    EmvaError;
    ModelError radcam_sim::ModelError;
    NoiseError;
    ObserveError;
    PlanError radcam::plan::PlanError;
}

use pyo3::exceptions::PyKeyboardInterrupt;
use radcam::capture::CaptureError as Capture;
use radcam::data_faults::ExamineError as Examine;
use radcam::emva::EmvaError as Emva;
use radcam::noise::NoiseError as Noise;
use radcam::observables::ObserveError as Observe;

// An interruption stays an interruption and a dataset error a dataset error, whichever call raised it.

impl Raised for Capture {
    fn raised(self) -> PyErr {
        match self {
            Self::Interrupted { .. } => PyKeyboardInterrupt::new_err(()),
            e => CaptureError::new_err(e.to_string()),
        }
    }
}

impl Raised for Examine {
    fn raised(self) -> PyErr {
        match self {
            Self::Interrupted => PyKeyboardInterrupt::new_err(()),
            Self::Dataset(e) => e.raised(),
            e => RadcamError::new_err(e.to_string()),
        }
    }
}

impl Raised for Emva {
    fn raised(self) -> PyErr {
        match self {
            Self::Interrupted => PyKeyboardInterrupt::new_err(()),
            Self::Dataset(e) => e.raised(),
            e => EmvaError::new_err(e.to_string()),
        }
    }
}

impl Raised for radcam::dataset::DatasetError {
    fn raised(self) -> PyErr {
        DatasetError::new_err(self.to_string())
    }
}

impl Raised for Noise {
    fn raised(self) -> PyErr {
        match self {
            Noise::Interrupted => PyKeyboardInterrupt::new_err(()),
            Noise::Dataset(e) => e.raised(),
            e => NoiseError::new_err(e.to_string()),
        }
    }
}

impl Raised for Observe {
    fn raised(self) -> PyErr {
        match self {
            Observe::Interrupted => PyKeyboardInterrupt::new_err(()),
            Observe::Dataset(e) => e.raised(),
            e => ObserveError::new_err(e.to_string()),
        }
    }
}
