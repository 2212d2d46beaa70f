//! Log messages go to Python's `logging`, to loggers named as the modules: `radcam.capture`,
//! `radcam.camera.aravis`.

use pyo3::prelude::*;
use std::fmt::{Debug, Write};
use std::sync::Once;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::{Context, Layer, SubscriberExt};

/// Installs the subscriber at the first work, unless another is set: the program, which comes with the
/// package, logs to standard error as usual.
pub fn begin() {
    static BEGUN: Once = Once::new();
    BEGUN.call_once(|| {
        let own = Targets::new().with_target("radcam", LevelFilter::DEBUG);
        let to_python = tracing_subscriber::registry().with(ToPython.with_filter(own));
        let _ = tracing::subscriber::set_global_default(to_python);
    });
}

struct ToPython;

impl<S: Subscriber> Layer<S> for ToPython {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let about = event.metadata();
        // Level numbers of `logging`.
        let level = match *about.level() {
            Level::ERROR => 40,
            Level::WARN => 30,
            Level::INFO => 20,
            Level::DEBUG | Level::TRACE => 10,
        };
        let mut text = Text::default();
        event.record(&mut text);
        let name = about.target().replace("::", ".");
        // Skipped while the interpreter shuts down. An exception in a user's handler belongs to no call of
        // the user, so it is discarded.
        let _ = Python::try_attach(|py| -> PyResult<()> {
            let logger = py.import("logging")?.call_method1("getLogger", (name,))?;
            logger.call_method1("log", (level, "%s", format!("{}{}", text.message, text.fields)))?;
            Ok(())
        });
    }
}

/// Message and fields of an event.
#[derive(Default)]
struct Text {
    message: String,
    fields: String,
}

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        let _ = match field.name() {
            "message" => write!(self.message, "{value:?}"),
            name => write!(self.fields, " {name}={value:?}"),
        };
    }
}
