//! Connections, names, limits and emergency stops.

use crate::arrays::numbered;
use crate::handle::{ClientHandle, borrow, found, guarded, guarded_or, put, put_new, text};
use crate::status::{Failure, Status, joint, message};
use motord_client::{Client, emergency_stop};
use std::ffi::{CStr, CString, c_char, c_int};
use std::os::fd::AsRawFd;
use std::path::Path;
use std::ptr;

/// Limits of the setpoints of a joint.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct JointLimits {
    /// Lowest position, rad.
    pub position_min: f64,
    /// Highest position, rad.
    pub position_max: f64,
    /// Largest speed, rad/s.
    pub velocity: f64,
    /// Largest torque, N·m.
    pub torque: f64,
    /// Largest stiffness, N·m/rad.
    pub kp: f64,
    /// Largest damping, N·m·s/rad.
    pub kd: f64,
}

/// Returns the version of this library, such as `0.1.0`. Never null.
#[unsafe(no_mangle)]
pub extern "C" fn motord_version() -> *const c_char {
    const VERSION: &CStr =
        match CStr::from_bytes_with_nul(concat!(env!("CARGO_PKG_VERSION"), "\0").as_bytes()) {
            Ok(version) => version,
            Err(_) => c"",
        };
    VERSION.as_ptr()
}

/// Returns a sentence about the last failure of this thread, in UTF-8: what failed, and what to do. Empty before the first failure,
/// never null. Valid until the next failure of this thread.
#[unsafe(no_mangle)]
pub extern "C" fn motord_error_message() -> *const c_char {
    message(CStr::as_ptr)
}

/// Returns the name of a joint of the last failure of this thread, in UTF-8; null for an index beyond the last. After
/// `MOTORD_STATUS_MOTORS_OFFLINE` these are the joints whose motors do not answer; other failures name none. Valid until the next
/// failure of this thread.
#[unsafe(no_mangle)]
pub extern "C" fn motord_error_joint(index: usize) -> *const c_char {
    joint(index, CStr::as_ptr).unwrap_or(ptr::null())
}

/// Connects to the daemon of `instance`. Takes milliseconds. Free the client with `motord_client_free`.
///
/// # Safety
/// `instance` is a text that ends with a null byte; `client` leads to a place for a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_connect(instance: *const c_char, client: *mut *mut ClientHandle) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let instance = unsafe { text(instance) }?;
        // SAFETY: by the contract of this function.
        unsafe { put_new(client, || connected(Client::connect(instance)?)) }
    })
}

/// Connects to the daemon of `instance` in another runtime directory.
///
/// # Safety
/// As `motord_connect`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_connect_in(
    runtime: *const c_char,
    instance: *const c_char,
    client: *mut *mut ClientHandle,
) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let runtime = unsafe { text(runtime) }?;
        // SAFETY: by the contract of this function.
        let instance = unsafe { text(instance) }?;
        // SAFETY: by the contract of this function.
        unsafe { put_new(client, || connected(Client::connect_in(Path::new(runtime), instance)?)) }
    })
}

fn connected(client: Client) -> Result<ClientHandle, Failure> {
    let robot = client.description();
    let text = |name: &String| {
        CString::new(name.as_str()).map_err(|_| Failure::bad_argument("a name has a null byte"))
    };
    let joints = robot.joints.iter().map(|joint| text(&joint.name)).collect::<Result<_, _>>()?;
    let groups = robot.groups.iter().map(|group| text(&group.name)).collect::<Result<_, _>>()?;
    let imus = robot.imus.iter().map(|imu| text(&imu.name)).collect::<Result<_, _>>()?;
    Ok(ClientHandle { client, names: [joints, groups, imus] })
}

/// Frees a client. Its claims and publishers stay valid. Null is no error.
///
/// # Safety
/// `client` is null, or one of `motord_connect` that is no longer in use.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_client_free(client: *mut ClientHandle) {
    // SAFETY: by the contract of this function.
    unsafe { crate::handle::free(client) }
}

/// The lists of names of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub enum NameList {
    /// Joints.
    Joints = 0,
    /// Groups of joints.
    Groups = 1,
    /// IMUs.
    Imus = 2,
}

const LISTS: [NameList; 3] = [NameList::Joints, NameList::Groups, NameList::Imus];

/// Returns the number of names of a `motord_list`; 0 for a client that is no client.
///
/// # Safety
/// `client` is a client.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_count(client: *mut ClientHandle, list: u32) -> usize {
    // SAFETY: by the contract of this function.
    let client = unsafe { borrow(client) };
    client.map_or(0, |client| client.names.get(list as usize).map_or(0, Vec::len))
}

/// Returns a name of a `motord_list` as it was at the connection; null for an index of none. Valid as long as the client.
///
/// # Safety
/// `client` is a client.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_name(client: *mut ClientHandle, list: u32, index: usize) -> *const c_char {
    // SAFETY: by the contract of this function.
    let client = unsafe { borrow(client) };
    let name = client.ok().and_then(|client| client.names.get(list as usize)?.get(index));
    name.map_or(ptr::null(), |name| name.as_ptr())
}

/// Finds the index of a name of a `motord_list`.
///
/// # Safety
/// `client` is a client, `name` a text that ends with a null byte; `index` leads to a place for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_find(
    client: *mut ClientHandle,
    list: u32,
    name: *const c_char,
    index: *mut usize,
) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let client = &unsafe { borrow(client) }?.client;
        // SAFETY: by the contract of this function.
        let name = unsafe { text(name) }?;
        let found = match numbered(&LISTS, list, "motord_list")? {
            NameList::Joints => client.joint_named(name),
            NameList::Groups => client.group_named(name),
            NameList::Imus => client.imu_named(name),
        };
        // SAFETY: by the contract of this function.
        unsafe { put(index, found?) }
    })
}

/// Returns the cycles per second of the daemon; NaN for a client that is no client.
///
/// # Safety
/// `client` is a client.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_rate_hz(client: *mut ClientHandle) -> f64 {
    // SAFETY: by the contract of this function.
    let client = unsafe { borrow(client) };
    guarded_or(f64::NAN, || client.map_or(f64::NAN, |client| client.client.description().rate_hz))
}

/// Reads the limits of the setpoints of a joint, by its index in the robot.
///
/// # Safety
/// `client` is a client; `limits` leads to a place for them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_limits(
    client: *mut ClientHandle,
    joint: usize,
    limits: *mut JointLimits,
) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let robot = unsafe { borrow(client) }?.client.description();
        let unknown = || Failure::new(Status::Unknown, format!("there is no joint with index {joint}"));
        let known = &robot.joints.get(joint).ok_or_else(unknown)?.limits;
        let [position_min, position_max] = known.position.map(f64::from);
        let [velocity, torque, kp, kd] = [known.velocity, known.torque, known.kp, known.kd].map(f64::from);
        // SAFETY: by the contract of this function.
        unsafe { put(limits, JointLimits { position_min, position_max, velocity, torque, kp, kd }) }
    })
}

/// Damps and stops every motor of `instance`, over a connection of its own. Any thread may call it; no other call delays it.
/// Usually takes some cycles, 0.3 s longer while motors do not answer, and at most little more than two seconds. `MOTORD_STATUS_OK`
/// means that each motor answered after the stop: otherwise motors may still move, so cut the power. After
/// `MOTORD_STATUS_MOTORS_OFFLINE` `motord_error_joint` names the silent ones. It is not async-signal-safe: see
/// `motord_emergency_stop_signal_safe`.
///
/// # Safety
/// `instance` is a text that ends with a null byte.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_emergency_stop(instance: *const c_char) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        Ok(emergency_stop(unsafe { text(instance) }?)?)
    })
}

/// Damps and stops every motor of the robot of a client, as `motord_emergency_stop` does. It works in a forked process too, over a
/// connection of its own.
///
/// # Safety
/// `client` is a client.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_client_emergency_stop(client: *mut ClientHandle) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        match unsafe { found(client) } {
            Some(client) => Ok(client.client.emergency_stop()?),
            // SAFETY: by the contract of this function.
            None => unsafe { borrow(client) }.map(|_| ()),
        }
    })
}

/// Damps and stops every motor of the robot of a client, from a signal handler too: async-signal-safe. It allocates nothing, takes no
/// lock, keeps `errno`, sets no message, and uses the stack and system calls of signal-safety(7) only. It needs one free file descriptor.
/// Any thread may call it, at any time between `motord_connect` and `motord_client_free`, and so may a forked process; no other call
/// delays it.
///
/// Usually takes a cycle or two, at most 0.2 s. `MOTORD_STATUS_OK` means that the daemon sent the commands: otherwise motors may still
/// move, so cut the power. It cannot know whether each motor received them: one without power or bus does not answer. Call
/// `motord_client_emergency_stop` after the handler, which names these motors. It sends the request over one path, the daemon's socket for emergency stops; outside of signal handlers
/// `motord_client_emergency_stop` tries a second one.
///
/// # Safety
/// `client` is a client.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_emergency_stop_signal_safe(client: *mut ClientHandle) -> Status {
    // SAFETY: by the contract of this function.
    match unsafe { found(client) } {
        Some(client) => client.client.emergency_stop_signal_safe().map_or_else(Status::from, |()| Status::Ok),
        None => Status::BadArgument,
    }
}

/// Returns a file descriptor that becomes readable with each state, for an event loop: `poll`, `epoll`, `select`. Read the state with
/// `motord_newest`. The descriptor belongs to the client, which closes it, and survives a restart of the daemon.
///
/// The first call takes milliseconds. From then on each call that returns a state makes one or two further system calls, and the
/// daemon makes one in each cycle. The descriptor may be readable without a new state, and an ended daemon leaves it unreadable: use a
/// timeout, after which `motord_wait` returns the reason.
///
/// # Safety
/// `client` is a client; `descriptor` leads to a place for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn motord_file_descriptor(client: *mut ClientHandle, descriptor: *mut c_int) -> Status {
    guarded(|| {
        // SAFETY: by the contract of this function.
        let opened = unsafe { borrow(client) }?.client.file_descriptor()?;
        // SAFETY: by the contract of this function.
        unsafe { put(descriptor, opened.as_raw_fd()) }
    })
}
