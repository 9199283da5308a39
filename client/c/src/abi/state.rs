//! States: waiting for them and reading them.

use crate::arrays::{ImuValues, Number, read};
use crate::generated::Quantity;
use crate::handle::{
    ClaimHandle, ClientHandle, StateHandle, array_mut, borrow, give, guarded, guarded_or, put,
};
use crate::joint::{JointInfo, cause_name, fault_name, limit_name, mode_name};
use crate::status::{Failure, Status, fail};
use motord_client::{Client, Error, GroupView, Phase, State};
use std::ffi::c_char;
use std::ptr;
use std::sync::Mutex;
use std::time::Duration;

/// Phase of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub enum GroupPhase {
    /// Every motor is stopped.
    Disarmed = 0,
    /// The motors are being started.
    Starting = 1,
    /// The group follows setpoints.
    Active = 2,
    /// The group is being damped and will be stopped.
    Damping = 3,
    /// This library does not know the phase.
    Unknown = 4,
}

impl From<Option<Phase>> for GroupPhase {
    fn from(phase: Option<Phase>) -> Self {
        match phase {
            Some(Phase::Disarmed) => Self::Disarmed,
            Some(Phase::Starting) => Self::Starting,
            Some(Phase::Active) => Self::Active,
            Some(Phase::Damping) => Self::Damping,
            None => Self::Unknown,
        }
    }
}

/// Creates an empty state. Free it with `motord_state_free`. Null while 65 536 states exist, which `motord_error_message` says. In a
/// 32-bit program: while 256 exist, and once 2²⁵ were created.
#[unsafe(no_mangle)]
pub extern "C" fn motord_state_new() -> *mut StateHandle {
    give(StateHandle(Mutex::default())).unwrap_or_else(|failure| {
        fail(failure);
        ptr::null_mut()
    })
}

/// Frees a state. Null is no error.
///
/// # Safety
/// `state` is null, or a state that is no longer in use.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_state_free(state: *mut StateHandle) {
    // SAFETY: by the contract of this function.
    unsafe { crate::handle::free(state) }
}

/// Sleeps until a state arrives that this client has not returned before, at most `timeout_ns`, and stores it.
///
/// After `MOTORD_STATUS_RESTARTED` connect again if the configuration may have changed, and claim again.
///
/// # Safety
/// `client` is a client, `state` a state.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_wait(
    client: *mut ClientHandle,
    timeout_ns: u64,
    state: *mut StateHandle,
) -> Status {
    // SAFETY: by the contract of this function.
    unsafe { receive(client, state, |client| client.wait(Duration::from_nanos(timeout_ns))) }
}

/// Sleeps as `motord_wait`, until the state of a cycle whose number is a multiple of `cycles` arrives. Stores the state of a later cycle
/// when that one was missed by the daemon, or when a still newer one arrived before this thread ran: `motord_state_cycle` returns its
/// number. The next call waits for the next multiple. The first call stores the next state. For a controller that runs at an integer
/// part of the daemon's rate; `timeout_ns` must be longer than `cycles` cycles.
///
/// # Safety
/// As `motord_wait`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_wait_cycles(
    client: *mut ClientHandle,
    cycles: u32,
    timeout_ns: u64,
    state: *mut StateHandle,
) -> Status {
    // SAFETY: by the contract of this function.
    unsafe { receive(client, state, |client| client.wait_cycles(cycles, Duration::from_nanos(timeout_ns))) }
}

/// Waits as `motord_wait` without a sleep: faster, and uses a processor whole.
///
/// # Safety
/// As `motord_wait`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_spin(
    client: *mut ClientHandle,
    timeout_ns: u64,
    state: *mut StateHandle,
) -> Status {
    // SAFETY: by the contract of this function.
    unsafe { receive(client, state, |client| client.spin(Duration::from_nanos(timeout_ns))) }
}

/// Stores the newest state if this client has not returned it before; `is_new` becomes true if there is one. Does not wait. A lack of
/// states is no error here: `publish_ns` of `motord_cycle` shows their age.
///
/// # Safety
/// `client` is a client, `state` a state; `is_new` leads to a place for a bool.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_newest(
    client: *mut ClientHandle,
    state: *mut StateHandle,
    is_new: *mut bool,
) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let (client, state) = (unsafe { borrow(client) }?, unsafe { borrow(state) }?);
        let newest = client.client.newest()?;
        // SAFETY: by the contract of this function.
        unsafe { put(is_new, newest.is_some()) }?;
        newest.map_or(Ok(()), |newest| state.put(newest))
    })
}

/// # Safety
/// As `motord_wait`.
unsafe fn receive(
    client: *mut ClientHandle,
    state: *mut StateHandle,
    wait: impl FnOnce(&Client) -> Result<State, Error>,
) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let client = unsafe { borrow(client) }?;
        // SAFETY: by the contract of this function.
        let state = unsafe { borrow(state) }?;
        state.put(wait(&client.client)?)
    })
}

/// The cycle of a state.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct CycleInfo {
    /// Number of the cycle, from 1. It counts ticks: missed ticks leave a gap.
    pub cycle: u64,
    /// The tick with the number of the cycle, ns of `CLOCK_MONOTONIC`: periods apart, also after missed ticks.
    pub tick_ns: u64,
    /// Time when the states were complete, ns of `CLOCK_MONOTONIC`.
    pub publish_ns: u64,
    /// Ticks missed since the start of the daemon.
    pub overruns: u64,
    /// The emergency stop is latched.
    pub emergency_stop: bool,
    /// The cycle has real-time scheduling and locked memory.
    pub realtime: bool,
    /// The daemon is shutting down.
    pub shutting_down: bool,
}

/// Reads the cycle of a state.
///
/// # Safety
/// `state` is a state; `cycle` leads to a place for it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_state_cycle(state: *mut StateHandle, cycle: *mut CycleInfo) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let info = unsafe { borrow(state) }?.with(|state| {
            Ok(CycleInfo {
                cycle: state.cycle(),
                tick_ns: state.tick_ns(),
                publish_ns: state.publish_ns(),
                overruns: state.overruns(),
                emergency_stop: state.emergency_stop(),
                realtime: state.realtime(),
                shutting_down: state.shutting_down(),
            })
        })?;
        // SAFETY: by the contract of this function.
        unsafe { put(cycle, info) }
    })
}

/// Reads a `motord_quantity` of every joint of a group, in the order of the claim; NaN while it is unknown.
///
/// # Safety
/// `state` is a state, `claim` a claim; `values` leads to `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_read(
    state: *mut StateHandle,
    claim: *mut ClaimHandle,
    quantity: u32,
    count: usize,
    values: *mut f64,
) -> Status {
    // SAFETY: by the contract of this function.
    unsafe { read_group(state, claim, quantity, count, values) }
}

/// As `motord_read`, with numbers of single precision.
///
/// # Safety
/// As `motord_read`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_read_f32(
    state: *mut StateHandle,
    claim: *mut ClaimHandle,
    quantity: u32,
    count: usize,
    values: *mut f32,
) -> Status {
    // SAFETY: by the contract of this function.
    unsafe { read_group(state, claim, quantity, count, values) }
}

/// A group after a cycle.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct GroupInfo {
    /// Its phase.
    pub phase: GroupPhase,
    /// Its owner is this claim.
    pub owned: bool,
    /// It was stopped and needs a reset.
    pub latched: bool,
    /// The cause of the stop, such as `motor-lost`; null without a stop.
    pub cause: *const c_char,
    /// The joint that caused the stop, by index in the robot; -1 for none.
    pub cause_joint: i32,
    /// Age of the setpoint in use when the cycle began, s; NaN for none.
    pub setpoint_age: f64,
    /// Setpoint messages accepted, modulo 2³².
    pub accepted: u32,
    /// Accepted messages that missed the first cycle after the one that they answer, modulo 2³².
    pub late: u32,
}

/// Reads the group of a claim.
///
/// # Safety
/// `state` is a state, `claim` a claim; `group` leads to a place for it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_state_group(
    state: *mut StateHandle,
    claim: *mut ClaimHandle,
    group: *mut GroupInfo,
) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let (state, claim) = (unsafe { borrow(state) }?, unsafe { borrow(claim) }?);
        let info = claim.with(|claim| {
            state.with(|state| {
                let group = state.group(claim.index()).ok_or(Error::Restarted)?;
                Ok(GroupInfo {
                    phase: group.phase.into(),
                    owned: state.of(claim).is_ok(),
                    latched: group.latched,
                    cause: group.cause.map_or(ptr::null(), cause_name),
                    cause_joint: group.cause_joint.and_then(|joint| i32::try_from(joint).ok()).unwrap_or(-1),
                    setpoint_age: group.setpoint_age.map_or(f64::NAN, |age| age.as_secs_f64()),
                    accepted: group.accepted,
                    late: group.late,
                })
            })
        })?;
        // SAFETY: by the contract of this function.
        unsafe { put(group, info) }
    })
}

/// Checks that the group of a claim follows its setpoints: call it after each wait.
///
/// # Safety
/// `state` is a state, `claim` a claim.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_must_be_active(state: *mut StateHandle, claim: *mut ClaimHandle) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let (state, claim) = (unsafe { borrow(state) }?, unsafe { borrow(claim) }?);
        claim.with(|claim| {
            state.with(|state| Ok(state.of(claim).and_then(|view: GroupView<'_>| view.must_be_active())?))
        })
    })
}

/// Reads a joint, by its index in the robot: `motord_find` and `motord_claim_joints` return it.
///
/// # Safety
/// `state` is a state; `joint` leads to a place for it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_state_joint(
    state: *mut StateHandle,
    index: usize,
    joint: *mut JointInfo,
) -> Status {
    guarded(|| {
        let unknown = || Failure::new(Status::Unknown, format!("there is no joint with index {index}"));
        // SAFETY: by the contract of this function.
        let info = unsafe { borrow(state) }?
            .with(|state| Ok(JointInfo::new(&state.joint(index).ok_or_else(unknown)?)))?;
        // SAFETY: by the contract of this function.
        unsafe { put(joint, info) }
    })
}

/// Returns the name of a `motord_mode`, such as `active`; null for a number that is none.
#[unsafe(no_mangle)]
pub extern "C" fn motord_mode_name(mode: u32) -> *const c_char {
    guarded_or(ptr::null(), || mode_name(mode))
}

/// Returns the name of a `motord_fault`, such as `over-voltage`; null for a number that is none.
#[unsafe(no_mangle)]
pub extern "C" fn motord_fault_name(fault: u32) -> *const c_char {
    guarded_or(ptr::null(), || fault_name(fault))
}

/// Returns the name of a `motord_limit`, such as `torque-slew`; null for a number that is none.
#[unsafe(no_mangle)]
pub extern "C" fn motord_limit_name(limit: u32) -> *const c_char {
    guarded_or(ptr::null(), || limit_name(limit))
}

/// Reads an IMU, by its index in the robot.
///
/// # Safety
/// `state` is a state; `imu` leads to a place for it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_state_imu(
    state: *mut StateHandle,
    index: usize,
    imu: *mut ImuValues,
) -> Status {
    guarded(|| {
        let unknown = || Failure::new(Status::Unknown, format!("there is no IMU with index {index}"));
        // SAFETY: by the contract of this function.
        let values = unsafe { borrow(state) }?
            .with(|state| Ok(ImuValues::from(&state.imu(index).ok_or_else(unknown)?)))?;
        // SAFETY: by the contract of this function.
        unsafe { put(imu, values) }
    })
}

/// # Safety
/// As `motord_read`.
unsafe fn read_group<N: Number>(
    state: *mut StateHandle,
    claim: *mut ClaimHandle,
    quantity: u32,
    count: usize,
    values: *mut N,
) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let (state, claim) = (unsafe { borrow(state) }?, unsafe { borrow(claim) }?);
        // SAFETY: by the contract of this function.
        let values = unsafe { array_mut(values, count) }?;
        let quantity = Quantity::numbered(quantity)?;
        claim.with(|claim| state.with(|state| read(state, claim.joints(), quantity, values)))
    })
}
