//! The program of every target: `MOTORD_FUZZ` names the one that takes the bytes. Built for fuzzing, it
//! is the fuzzer; otherwise it runs the given files.

#![cfg_attr(fuzzing, no_main)]

use motord_fuzz::{TARGETS, Target};
use std::sync::LazyLock;

static TARGET: LazyLock<Target> = LazyLock::new(|| {
    let name = std::env::var("MOTORD_FUZZ").unwrap_or_default();
    let target = TARGETS.iter().find(|(known, _)| *known == name);
    target.unwrap_or_else(|| panic!("MOTORD_FUZZ={name} is no target: lib.rs lists them")).1
});

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| TARGET(bytes));

#[cfg(not(fuzzing))]
fn main() -> std::io::Result<()> {
    for file in std::env::args_os().skip(1) {
        TARGET(&std::fs::read(file)?);
    }
    Ok(())
}
