//! The terminal side of all programs: tables, colours, JSON lines, signals, exit statuses, input
//! files, shell completions and manual pages.

#![forbid(unsafe_code)]

pub mod exit_status;
mod file_error;
mod interrupt;
pub mod json;
mod pages;
mod table;

pub use exit_status::{Absence, parse_arguments};
pub use file_error::FileError;
pub use interrupt::Interrupt;
pub use motord_untrusted::{InputError, InputFile, is_harmless, printable, printable_line, recreate};
pub use pages::{Pages, Shell};
pub use table::{Cell, Colour, Palette, Table, number, within};
