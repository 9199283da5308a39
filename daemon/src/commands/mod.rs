//! The commands of `motord`, a file each.

pub mod check;
pub mod run;
pub mod safe_stop;
