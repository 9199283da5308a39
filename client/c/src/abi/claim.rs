//! The ownership of a group: setpoints, enabling and disabling.

use crate::arrays::{Number, Setpoints, check_count, numbered};
use crate::handle::{
    ClaimHandle, ClientHandle, StateHandle, array, array_mut, borrow, guarded, guarded_or, put_new, text,
};
use crate::status::{Failure, Status};
use motord_client::Phase;
use std::ffi::c_char;
use std::sync::Mutex;
use std::time::Duration;

/// Claims a group. Free the claim with `motord_claim_free`. The claim ends with its process; in a forked process calls with it return
/// `MOTORD_STATUS_FORKED`.
///
/// # Safety
/// `client` is a client, `group` a text that ends with a null byte; `claim` leads to a place for a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_claim_group(
    client: *mut ClientHandle,
    group: *const c_char,
    claim: *mut *mut ClaimHandle,
) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let client = unsafe { borrow(client) }?;
        // SAFETY: by the contract of this function.
        let group = unsafe { text(group) }?;
        // SAFETY: by the contract of this function.
        unsafe { put_new(claim, || Ok(ClaimHandle(Mutex::new(Some(client.client.claim(group)?))))) }
    })
}

/// Frees a claim, and releases its group: an active group is stopped. Null is no error.
///
/// # Safety
/// `claim` is null, or a claim that is no longer in use.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_claim_free(claim: *mut ClaimHandle) {
    // SAFETY: by the contract of this function.
    unsafe { crate::handle::free(claim) }
}

/// Releases the group of a claim, and reports whether the daemon did it. The claim must still be freed.
///
/// # Safety
/// `claim` is a claim.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_release(claim: *mut ClaimHandle) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        Ok(unsafe { borrow(claim) }?.take()?.release()?)
    })
}

/// Returns the number of joints of a claim; 0 for a claim that is none, or was released.
///
/// # Safety
/// `claim` is a claim.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_claim_count(claim: *mut ClaimHandle) -> usize {
    // SAFETY: by the contract of this function.
    let claim = unsafe { borrow(claim) };
    guarded_or(0, || claim.and_then(|claim| claim.with(|claim| Ok(claim.joints().len()))).unwrap_or(0))
}

/// Reads the indices in the robot of the joints of a claim, in its order.
///
/// # Safety
/// `claim` is a claim; `joints` leads to `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_claim_joints(
    claim: *mut ClaimHandle,
    count: usize,
    joints: *mut usize,
) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let (claim, joints) = (unsafe { borrow(claim) }?, unsafe { array_mut(joints, count) }?);
        claim.with(|claim| {
            check_count(claim.joints().len(), joints.len())?;
            joints.copy_from_slice(claim.joints());
            Ok(())
        })
    })
}

/// Stores for each joint the setpoint that holds its position in `state`, with the stiffness `kp`, N·m/rad, and the damping `kd`,
/// N·m·s/rad. Send it with `motord_commit`.
///
/// # Safety
/// `claim` is a claim, `state` a state.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_hold(
    claim: *mut ClaimHandle,
    state: *mut StateHandle,
    kp: f64,
    kd: f64,
) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let (state, claim) = (unsafe { borrow(state) }?, unsafe { borrow(claim) }?);
        claim.with(|claim| state.with(|state| Ok(claim.hold(state, kp as f32, kd as f32)?)))
    })
}

/// Sets the horizon of the setpoints that are sent from now on: the daemon moves position, velocity and torque linearly from the
/// present command to the setpoint within `horizon_ns` after it was sent, inside all limits. 0, the initial value, applies setpoints
/// immediately. The setpoint timeout begins at the end of the horizon. For a controller slower than the cycle.
/// `MOTORD_STATUS_BAD_SETPOINT` when it is longer than `setpoint-horizon-max-ms` of the configuration. Neither allocates nor waits.
///
/// # Safety
/// `claim` is a claim.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_set_horizon(claim: *mut ClaimHandle, horizon_ns: u64) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        unsafe { borrow(claim) }?.with(|claim| Ok(claim.set_horizon(Duration::from_nanos(horizon_ns))?))
    })
}

/// Sends the stored setpoints again. Call it in every cycle of the controller, even if nothing changed. `MOTORD_STATUS_STOPPED` with
/// each call after a stop of the group that this claim had started, until a reset.
///
/// # Safety
/// `claim` is a claim.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_commit(claim: *mut ClaimHandle) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        unsafe { borrow(claim) }?.with(|claim| Ok(claim.commit()?))
    })
}

/// Stores and sends a setpoint for each joint of the group, in the order of the claim: position, rad; velocity, rad/s; stiffness,
/// N·m/rad; damping, N·m·s/rad; torque, N·m. A null pointer for an array is 0 for every joint. Does not wait. The motor's torque is
/// `kp · (position - p) + kd · (velocity - v) + torque`, within the limits of the joint. `MOTORD_STATUS_BAD_SETPOINT`: a value is not
/// finite, or a gain is negative; then nothing is stored or sent. `MOTORD_STATUS_BAD_ARGUMENT`: a position without stiffness or a
/// velocity without damping, by which the joints would be limp. `MOTORD_STATUS_STOPPED` with each call after a stop of the group
/// that this claim had started, until a reset.
///
/// # Safety
/// `claim` is a claim; each array is null or leads to `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_send(
    claim: *mut ClaimHandle,
    count: usize,
    position: *const f64,
    velocity: *const f64,
    kp: *const f64,
    kd: *const f64,
    torque: *const f64,
) -> Status {
    // SAFETY: by the contract of this function.
    unsafe { send(claim, count, [position, velocity, kp, kd, torque]) }
}

/// As `motord_send`, with numbers of single precision.
///
/// # Safety
/// As `motord_send`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_send_f32(
    claim: *mut ClaimHandle,
    count: usize,
    position: *const f32,
    velocity: *const f32,
    kp: *const f32,
    kd: *const f32,
    torque: *const f32,
) -> Status {
    // SAFETY: by the contract of this function.
    unsafe { send(claim, count, [position, velocity, kp, kd, torque]) }
}

/// Starts the motors of the group towards the last setpoints sent, which must be near the positions of the joints. Continue to
/// send afterwards, or wait with `motord_wait_for`.
///
/// # Safety
/// `claim` is a claim.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_enable(claim: *mut ClaimHandle) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        unsafe { borrow(claim) }?.with(|claim| Ok(claim.enable()?))
    })
}

/// Sleeps until the group is in a `motord_phase` or past it, at most `timeout_ns`, and repeats the last setpoints in each cycle. Once
/// the group is active, the daemon keeps them for `setpoint-horizon-max-ms` and the setpoint timeout: send the next ones before.
///
/// # Safety
/// `claim` is a claim.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_wait_for(claim: *mut ClaimHandle, phase: u32, timeout_ns: u64) -> Status {
    guarded(|| {
        let phase = numbered(Phase::ALL, phase, "motord_phase")?;
        // SAFETY: by the contract of this function.
        unsafe { borrow(claim) }?.with(|claim| Ok(claim.wait_for(phase, Duration::from_nanos(timeout_ns))?))
    })
}

/// Damps and stops the motors of the group.
///
/// # Safety
/// `claim` is a claim.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_disable(claim: *mut ClaimHandle) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        unsafe { borrow(claim) }?.with(|claim| Ok(claim.disable()?))
    })
}

/// Clears the latched cause of a stop. The group must be disarmed. A controller should leave this to a person who has inspected the
/// robot.
///
/// # Safety
/// `claim` is a claim.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_reset(claim: *mut ClaimHandle) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        unsafe { borrow(claim) }?.with(|claim| Ok(claim.reset()?))
    })
}

/// # Safety
/// As `motord_send`.
unsafe fn send<N: Number>(claim: *mut ClaimHandle, count: usize, arrays: [*const N; 5]) -> Status {
    guarded(|| {
        let [position, velocity, kp, kd, _] = arrays.map(|array| !array.is_null());
        if position && !kp {
            return Err(Failure::bad_argument(
                "positions without kp: give a stiffness, or the joints are limp",
            ));
        }
        if velocity && !kd {
            return Err(Failure::bad_argument(
                "velocities without kd: give a damping, or they have no effect",
            ));
        }
        // SAFETY: by the contract of this function.
        let claim = unsafe { borrow(claim) }?;
        let mut values = [None; 5];
        for (values, pointer) in values.iter_mut().zip(arrays) {
            // SAFETY: by the contract of this function.
            *values = unsafe { array(pointer, count) }?;
        }
        claim.with(|claim| Ok(Setpoints { values }.send(claim, count)?))
    })
}
