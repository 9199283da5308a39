//! Every command of `motorctl`, beside daemons with a low rate, and on simulated lines.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

#[path = "../line/mod.rs"]
mod line;
mod schema;

mod command_line;
mod completions;
mod configurations;
mod doctor;
mod estop;
mod frame;
mod frame_logs;
mod guide;
mod help;
mod hold;
mod identify;
mod imu;
mod monitor;
mod not_utf8;
mod operate;
mod pages;
mod programs;
mod protocol_table;
mod readme;
mod recording;
mod robots;
mod schemas;
mod setup;
mod tune;
mod wire;
mod wire_terminal;
