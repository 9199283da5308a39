//! Mistakes of a caller in C end with a status and a sentence.

#![expect(unsafe_code, clippy::multiple_unsafe_ops_per_block, reason = "it plays a caller in C")]

use motord_c::abi::*;
use motord_c::status::Status;
use std::ffi::{CStr, c_char, c_int};
use std::ptr;

unsafe extern "C" {
    fn fork() -> c_int;
    fn waitpid(child: c_int, status: *mut c_int, options: c_int) -> c_int;
    fn _exit(status: c_int) -> !;
}

/// The sentence of the last failure.
fn sentence() -> String {
    // SAFETY: never null, and ends with a null byte.
    unsafe { CStr::from_ptr(motord_error_message()) }.to_string_lossy().into_owned()
}

fn assert_refused(status: Status, part: &str) {
    assert_eq!(status, Status::BadArgument);
    assert!(sentence().contains(part), "{part} is not in {}", sentence());
}

#[test]
fn null_pointers_are_refused_by_name() {
    // SAFETY: null pointers are within the contract.
    unsafe {
        assert_refused(motord_wait(ptr::null_mut(), 0, ptr::null_mut()), "motord_client is a null pointer");
        assert_refused(motord_commit(ptr::null_mut()), "motord_claim is a null pointer");
        assert_refused(motord_connect(ptr::null(), ptr::null_mut()), "name is a null pointer");
        assert_refused(
            motord_state_cycle(ptr::null_mut(), ptr::null_mut()),
            "motord_state is a null pointer",
        );
        assert_refused(motord_connect(c"x".as_ptr(), ptr::null_mut()), "pointer for the result is null");
        assert_eq!((motord_count(ptr::null_mut(), 0), motord_claim_count(ptr::null_mut())), (0, 0));
        assert!(motord_name(ptr::null_mut(), 0, 0).is_null() && motord_rate_hz(ptr::null_mut()).is_nan());
        motord_client_free(ptr::null_mut());
        motord_claim_free(ptr::null_mut());
        motord_state_free(ptr::null_mut());
    }
}

/// A joint with a position and no stiffness is limp.
#[test]
fn setpoints_that_move_nothing_are_refused() {
    let values = [0.5];
    let (given, null) = (values.as_ptr(), ptr::null());
    // SAFETY: the arrays have one number, and null pointers are within the contract.
    unsafe {
        let of = |q, dq, kp, kd| motord_send(ptr::null_mut(), 1, q, dq, kp, kd, null);
        assert_refused(of(given, null, null, null), "positions without kp");
        assert_refused(of(given, null, null, given), "positions without kp");
        assert_refused(of(null, given, null, null), "velocities without kd");
        assert_refused(of(given, given, given, null), "velocities without kd");
        assert_refused(of(given, null, given, null), "motord_claim is a null pointer");
        assert_refused(of(null, null, null, null), "motord_claim is a null pointer");
    }
}

#[test]
fn null_publishers_and_descriptors_are_refused() {
    // SAFETY: null pointers are within the contract.
    unsafe {
        assert_eq!(motord_emergency_stop_signal_safe(ptr::null_mut()), Status::BadArgument);
        let new = motord_imu_publisher_new(ptr::null_mut(), c"base".as_ptr(), ptr::null_mut());
        assert_refused(new, "motord_client is a null pointer");
        let sent = motord_imu_publisher_send(ptr::null_mut(), ptr::null());
        assert_refused(sent, "motord_imu_publisher is a null pointer");
        assert!(!motord_imu_publisher_is_used(ptr::null_mut()));
        motord_imu_publisher_free(ptr::null_mut());
        let opened = motord_file_descriptor(ptr::null_mut(), ptr::null_mut());
        assert_refused(opened, "motord_client is a null pointer");
        let newest = motord_newest(ptr::null_mut(), ptr::null_mut(), ptr::null_mut());
        assert_refused(newest, "motord_client is a null pointer");
    }
}

#[test]
fn empty_state_says_to_wait() {
    let state = motord_state_new();
    // SAFETY: a state, and places for the results.
    unsafe {
        let mut cycle = std::mem::zeroed();
        assert_refused(motord_state_cycle(state, &mut cycle), "is empty: wait for the first state");
        let mut imu = std::mem::zeroed();
        assert_refused(motord_state_imu(state, 0, &mut imu), "is empty");
        motord_state_free(state);
    }
}

#[test]
fn handle_of_another_kind_is_refused() {
    let state = motord_state_new();
    // SAFETY: a live object of this library.
    unsafe {
        assert_refused(motord_commit(state.cast()), "was freed, or is no motord_claim");
        assert_refused(motord_wait(state.cast(), 0, state), "was freed, or is no motord_client");
        motord_client_free(state.cast());
        motord_state_free(state);
    }
}

#[test]
fn freed_handle_is_refused_after_memory_is_reused() {
    // SAFETY: live and freed objects of this library.
    unsafe {
        let mut cycle = std::mem::zeroed();
        let freed: Vec<_> = (0..200)
            .map(|_| {
                let state = motord_state_new();
                motord_state_free(state);
                state
            })
            .collect();
        let live = motord_state_new();
        for state in freed {
            assert_refused(motord_state_cycle(state, &mut cycle), "this motord_state was freed");
            assert_refused(motord_hold(ptr::null_mut(), state, 1.0, 1.0), "this motord_state was freed");
            motord_state_free(state);
        }
        assert_refused(motord_state_cycle(live, &mut cycle), "is empty: wait for the first state");
        motord_state_free(live);
    }
}

/// Goal: a pointer to anything else is an error, and is not followed.
#[test]
fn pointer_that_is_no_handle_is_refused() {
    let mut memory = [0_u64; 8];
    let own = ptr::from_mut(&mut memory).cast::<u8>();
    for pointer in
        [own, own.wrapping_add(3), ptr::without_provenance_mut(0x1000), ptr::without_provenance_mut(8)]
    {
        // SAFETY: the library follows no pointer of a handle.
        unsafe {
            assert_refused(motord_commit(pointer.cast()), "was freed, or is no motord_claim");
            assert_refused(motord_wait(pointer.cast(), 0, ptr::null_mut()), "or is no motord_client");
            assert_eq!(motord_emergency_stop_signal_safe(pointer.cast()), Status::BadArgument);
            assert!(!motord_imu_publisher_is_used(pointer.cast()));
            motord_client_free(pointer.cast());
            motord_claim_free(pointer.cast());
        }
    }
}

#[test]
fn codes_have_names_and_other_numbers_none() {
    let name = |text: *const c_char| {
        // SAFETY: null, or ends with a null byte.
        (!text.is_null()).then(|| unsafe { CStr::from_ptr(text) }.to_str().unwrap())
    };
    assert_eq!([3, 7, 8].map(|mode| name(motord_mode_name(mode))), [Some("active"), Some("unknown"), None]);
    assert_eq!(
        [2, 3, 1 << 5].map(|fault| name(motord_fault_name(fault))),
        [Some("over-voltage"), None, None]
    );
    assert_eq!(
        [256, 0, u32::MAX].map(|limit| name(motord_limit_name(limit))),
        [Some("torque-slew"), None, None]
    );
}

#[test]
fn empty_state_has_no_joint() {
    let state = motord_state_new();
    // SAFETY: a state, and a place for the result.
    unsafe {
        let mut joint = std::mem::zeroed();
        assert_refused(motord_state_joint(state, 0, &mut joint), "is empty");
        motord_state_free(state);
    }
}

#[test]
fn forked_process_is_refused_and_frees_nothing() {
    let state = motord_state_new();
    // SAFETY: live objects of this library; the child ends by `_exit`.
    unsafe {
        let mut cycle = std::mem::zeroed();
        let child = fork();
        if child == 0 {
            let refused = motord_state_cycle(state, &mut cycle);
            let is_refused = refused == Status::Forked && sentence().contains("connect again");
            motord_state_free(state);
            motord_state_free(state);
            let own = motord_state_cycle(motord_state_new(), &mut cycle);
            _exit(c_int::from(!is_refused || own != Status::BadArgument));
        }
        let mut status = -1;
        assert_eq!((waitpid(child, &mut status, 0), status), (child, 0));
        assert_refused(motord_state_cycle(state, &mut cycle), "is empty: wait for the first state");
        motord_state_free(state);
    }
}

#[test]
fn missing_daemon_and_bad_names_are_explained() {
    let directory = std::env::temp_dir().join(format!("motord-c-{}", std::process::id()));
    let runtime = format!("{}\0", directory.display());
    let mut client = ptr::null_mut();
    // SAFETY: texts that end with a null byte, and a place for the result.
    let mut connect = |instance: &[u8]| unsafe {
        motord_connect_in(runtime.as_ptr().cast(), instance.as_ptr().cast::<c_char>(), &mut client)
    };
    assert_eq!(connect(b"robot\0"), Status::NotRunning);
    assert!(sentence().contains("start it with `motord run`"), "{}", sentence());
    assert_refused(connect(b"\xff\xfe\0"), "not UTF-8");
    assert!(client.is_null());
}
