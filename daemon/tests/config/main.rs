//! Configuration files: their meaning, the reports of `motord check`, and the files of
//! `motord init`.

mod arbitrary;
mod arming;
mod can_imus;
mod document;
mod ends;
mod ids;
mod implausible;
mod imus;
mod init;
mod ipc_schedule;
mod messages;
mod mistakes;
mod physics;
mod shipped;
mod slips;
