//! Commands and workbench. They parse, call the library and print; nothing is computed here.
//!
//! In: arguments of the command line ([`cli`], one file per verb), requests of a browser ([`workbench`]).
//! Out: text, JSON, pages, exit codes. Begin with [`cli`].

pub mod cli;
pub mod workbench;
