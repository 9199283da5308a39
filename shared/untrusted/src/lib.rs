//! Files and texts that another user or process may have made.
//!
//! - [`InputFile`]: a file to read. It is a regular file, and has a limit.
//! - [`recreate`]: a file to write, in place of what another user may have created there.
//! - [`printable`] and [`printable_line`]: text for a terminal, a log or a page.

#![forbid(unsafe_code)]

mod file;
mod text;

pub use file::{InputError, InputFile, recreate};
pub use text::{is_harmless, printable, printable_line};
