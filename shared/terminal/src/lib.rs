//! The habits of the commands on a terminal: tables, colours, JSON lines, Ctrl-C, exit statuses;
//! and what every program prints of its command line: completions and manual pages.

#![forbid(unsafe_code)]

mod absence;
pub mod exit_status;
mod interrupt;
pub mod json;
mod pages;
mod table;
mod text;

pub use absence::Absence;
pub use interrupt::Interrupt;
pub use pages::{Pages, Shell};
pub use table::{Cell, Colour, Palette, Table};
pub use text::{number, printable, within};
