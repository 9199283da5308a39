//! The habits of the commands on a terminal: tables, colours, JSON lines, Ctrl-C, exit statuses.

#![forbid(unsafe_code)]

pub mod exit_status;
mod interrupt;
pub mod json;
mod table;

pub use interrupt::Interrupt;
pub use table::{Cell, Colour, Palette, Table};
