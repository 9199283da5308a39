//! Fuzz targets: one for every input that motord reads from a wire, a file or another process.
//!
//! A target takes any bytes, passes them on as their real source does, and panics when a guarantee
//! is broken. The first guarantee of each is that it returns. No bytes make a decoder panic, loop
//! without end, or allocate without a bound. Each target documents its further guarantees.
//!
//! The targets are pure: the same bytes give the same result. libFuzzer searches for bytes that
//! break them. `corpus/` holds its useful findings, an archive for each target, which
//! `tests/corpus.rs` runs with the other tests. `docs/fuzzing.md` describes the use and the
//! findings.

#![forbid(unsafe_code)]

mod imu;
mod input;
mod messages;
mod robot;
mod text;
mod wire;

pub use imu::{damiao_imu, hipnuc_can, hipnuc_serial, xsens};
pub use messages::{requests, setpoints, states};
pub use text::{candump, config, description, lock, registration, sim};
pub use wire::{commands, disarmed, drive, replies, serial};

/// A function that takes any bytes, and panics when a guarantee is broken.
pub type Target = fn(&[u8]);

/// Every target, by the name that `MOTORD_FUZZ` and its corpus have.
pub const TARGETS: &[(&str, Target)] = &[
    ("replies", replies),
    ("commands", commands),
    ("drive", drive),
    ("disarmed", disarmed),
    ("serial", serial),
    ("config", config),
    ("lock", lock),
    ("candump", candump),
    ("description", description),
    ("sim", sim),
    ("registration", registration),
    ("setpoints", setpoints),
    ("requests", requests),
    ("states", states),
    ("hipnuc_serial", hipnuc_serial),
    ("hipnuc_can", hipnuc_can),
    ("damiao_imu", damiao_imu),
    ("xsens", xsens),
];
