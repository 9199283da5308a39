//! The commands of `motord`, a file each.

pub mod check;
pub mod init;
pub mod run;
