//! Configuration files: their meaning, the reports of `motord check`, and the files of
//! `motord init`.

mod arming;
mod document;
mod ends;
mod ids;
mod imus;
mod init;
mod ipc_schedule;
mod messages;
mod mistakes;
mod physics;
mod shipped;
mod slips;
