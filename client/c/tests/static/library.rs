//! Another Rust library of a program that links libmotord.a: it unwinds, and starts a thread and a
//! process.

use std::ffi::c_int;

/// Returns 3: a thread, a caught panic and a process.
#[no_mangle]
pub extern "C" fn other_library() -> c_int {
    std::panic::set_hook(Box::new(|_| {}));
    let thread = std::thread::spawn(|| 1);
    let panic = std::panic::catch_unwind(|| panic!("caught")).is_err();
    let process = std::process::Command::new("sleep").arg("0").status().is_ok_and(|status| status.success());
    thread.join().unwrap_or(0) + c_int::from(panic) + c_int::from(process)
}
