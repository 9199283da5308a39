//! Names of codes, for callers in C.

use crate::joint::Mode;
use motord_client::{Cause, Fault, Limit, MotorMode};
use std::ffi::{CString, c_char};
use std::ptr;
use std::sync::OnceLock;

/// Each code with its name.
type Names = OnceLock<Vec<(u32, CString)>>;

fn name(names: &'static Names, number: u32, all: impl Iterator<Item = (u32, &'static str)>) -> *const c_char {
    let text = |(number, name)| (number, CString::new(name).unwrap_or_default());
    let names = names.get_or_init(|| all.map(text).collect());
    names.iter().find(|(known, _)| *known == number).map_or(ptr::null(), |(_, name)| name.as_ptr())
}

/// Returns the name of a `motord_mode`; null for a number that is none.
pub(crate) fn mode_name(mode: u32) -> *const c_char {
    static NAMES: Names = OnceLock::new();
    let unknown = (Mode::Unknown as u32, "unknown");
    let known = MotorMode::ALL.iter().map(|mode| (Mode::from(Some(*mode)) as u32, mode.name()));
    name(&NAMES, mode, known.chain([unknown]))
}

/// Returns the name of a `motord_fault`; null for a number that is none.
pub(crate) fn fault_name(fault: u32) -> *const c_char {
    static NAMES: Names = OnceLock::new();
    name(&NAMES, fault, Fault::ALL.iter().map(|fault| (fault.bit(), fault.name())))
}

/// Returns the name of a `motord_limit`; null for a number that is none.
pub(crate) fn limit_name(limit: u32) -> *const c_char {
    static NAMES: Names = OnceLock::new();
    name(&NAMES, limit, Limit::ALL.iter().map(|limit| (limit.bit(), limit.name())))
}

/// Returns the name of a cause.
pub(crate) fn cause_name(cause: Cause) -> *const c_char {
    static NAMES: Names = OnceLock::new();
    name(&NAMES, cause.code(), Cause::ALL.iter().map(|cause| (cause.code(), cause.name())))
}
