//! Fuzz targets: one for everything that motord reads from a wire, a file or another process.
//!
//! A target takes any bytes, hands them over as their real source does, and panics when a promise is broken. That it
//! returns is the first promise of each: no bytes make a decoder panic, loop for ever, or take memory without bound. The others are
//! said at each target.
//!
//! The targets are pure: the same bytes do the same. libFuzzer searches for bytes that break them; what it found
//! worth keeping is in `corpus/`, and `tests/corpus.rs` runs it wherever the tests run. `docs/fuzzing.md` tells how, and what was found.

#![forbid(unsafe_code)]

mod input;
mod messages;
mod robot;
mod text;
mod wire;

pub use messages::{requests, setpoints, states};
pub use text::{candump, config, description, lock, registration, sim};
pub use wire::{commands, disarmed, drive, replies, serial};

#[cfg(fuzzing)]
pub use libfuzzer_sys;

/// A function that takes any bytes, and panics when a promise is broken.
pub type Target = fn(&[u8]);

/// Every target, under the name of its program and of its corpus.
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
];

/// The program of a target: the fuzzer where it is built for fuzzing, else one that runs the files that it is given.
#[macro_export]
macro_rules! program {
    ($target:path) => {
        #[cfg(fuzzing)]
        $crate::libfuzzer_sys::fuzz_target!(|bytes: &[u8]| $target(bytes));

        #[cfg(not(fuzzing))]
        fn main() -> std::io::Result<()> {
            for file in std::env::args_os().skip(1) {
                $target(&std::fs::read(file)?);
            }
            Ok(())
        }
    };
}
