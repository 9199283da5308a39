//! The terminal side of all programs: tables, colours, JSON lines, signals, exit statuses, input
//! files, shell completions and manual pages.

#![forbid(unsafe_code)]

mod absence;
pub mod exit_status;
mod interrupt;
pub mod json;
mod pages;
mod regular;
mod table;
mod text;

pub use absence::Absence;
pub use interrupt::Interrupt;
pub use pages::{Pages, Shell};
pub use regular::open_regular;
pub use table::{Cell, Colour, Palette, Table};
pub use text::{number, printable, within};
