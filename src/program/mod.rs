//! Commands and workbench. They parse, call the library and print; nothing is computed here.

pub mod cli;
pub mod workbench;
