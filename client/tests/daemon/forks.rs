//! Objects in a process that was forked from the one that created them.

use super::fake_daemon::Running;
use super::{INSTANCE, TIMEOUT, connect, directory, spawn, until};
use motord_client::{Claim, Client, Error, Phase, Records, Setpoint, State};
use motord_shared::CycleRecord;
use nix::sys::wait::{WaitStatus, waitpid};
use nix::unistd::{ForkResult, alarm, fork, pipe, write};
use std::fs::File;
use std::io::Read as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// A child that waits for a lock of a thread that does not exist there ends after this number of
/// seconds.
const HANGS_SECONDS: u32 = 20;
/// Forks while another thread uses the same client.
const FORKS: u32 = 20;

/// Runs `call` in a forked process. Returns its error, or how the process ended.
fn in_child(call: impl FnOnce() -> Result<(), String>) -> Result<(), String> {
    let (reader, writer) = pipe().unwrap();
    // SAFETY: the child uses this library, memory and a pipe, and ends by `_exit`.
    let ForkResult::Parent { child } = unsafe { fork() }.unwrap() else {
        alarm::set(HANGS_SECONDS);
        let outcome = catch_unwind(AssertUnwindSafe(call)).unwrap_or_else(|_| Err("it panics".into()));
        let text = outcome.err().unwrap_or_default();
        let _ = write(&writer, text.as_bytes());
        // SAFETY: ends the process without destructors of the parent's test.
        unsafe { nix::libc::_exit(i32::from(!text.is_empty())) };
    };
    drop(writer);
    let mut text = String::new();
    File::from(reader).read_to_string(&mut text).unwrap();
    match waitpid(child, None).unwrap() {
        WaitStatus::Exited(_, 0) => Ok(()),
        ended => Err(format!("{text} {ended:?}")),
    }
}

/// The objects of a process, and its newest state.
struct Objects {
    claim: Claim,
    records: Records,
    state: State,
    client: Client,
}

impl Objects {
    fn of(directory: &tempfile::TempDir) -> Self {
        let client = connect(directory);
        let mut claim = client.claim("leg").unwrap();
        client.file_descriptor().unwrap();
        let state = client.wait(TIMEOUT).unwrap();
        claim.hold(&state, 1.0, 1.0).unwrap();
        claim.commit().unwrap();
        Self { claim, records: client.records().unwrap(), state, client }
    }

    /// Returns what each call with the client returns.
    fn call_client(&self) -> Vec<(&'static str, Option<Error>)> {
        let client = &self.client;
        vec![
            ("check_process", client.check_process().err()),
            ("newest", client.newest().err()),
            ("wait", client.wait(TIMEOUT).err()),
            ("wait_cycles", client.wait_cycles(2, TIMEOUT).err()),
            ("spin", client.spin(TIMEOUT).err()),
            ("file_descriptor", client.file_descriptor().err()),
            ("records", client.records().err()),
            ("claim", client.claim("leg").err()),
            ("enable", client.enable("leg").err()),
            ("disable", client.disable("leg").err()),
            ("reset", client.reset("leg").err()),
            ("wait_for", client.wait_for("leg", Phase::Disarmed, TIMEOUT).err()),
            ("offline_joints", client.offline_joints(None, TIMEOUT).err()),
            ("force_release", client.force_release("leg").err()),
            ("set_zero", client.set_zero("hip").err()),
            ("clear_fault", client.clear_fault("hip").err()),
            ("exclude", client.exclude("hip").err()),
            ("include", client.include("hip").err()),
            ("telemetry", client.telemetry().err()),
            ("histograms", client.histograms().err()),
            ("reset_telemetry", client.reset_telemetry().err()),
            ("publish_imu", client.publish_imu("base").err()),
        ]
    }

    /// Returns what each call with the claim and the records returns.
    fn call_claim(&mut self) -> Vec<(&'static str, Option<Error>)> {
        let Self { claim, records, state, .. } = self;
        vec![
            ("set", claim.set("hip", Setpoint::damping(1.0)).err()),
            ("hold", claim.hold(state, 1.0, 1.0).err()),
            ("set_horizon", claim.set_horizon(Duration::ZERO).err()),
            ("commit", claim.commit().err()),
            ("keep_for", claim.keep_for(TIMEOUT).err()),
            ("send", claim.send(&[Setpoint::damping(1.0); 2]).err()),
            ("enable", claim.enable().err()),
            ("wait_for", claim.wait_for(Phase::Active, TIMEOUT).err()),
            ("disable", claim.disable().err()),
            ("reset", claim.reset().err()),
            ("take", records.take(&mut CycleRecord::default()).err()),
        ]
    }

    /// Checks that each call fails with [`Error::Forked`], and ends every object.
    fn are_refused(mut self) -> Result<(), String> {
        let outcomes = [self.call_client(), self.call_claim()].concat();
        let wrong = outcomes.into_iter().find(|(_, error)| *error != Some(Error::Forked));
        let Self { claim, records, client, .. } = self;
        match (wrong, claim.release(), client.description().joints.len()) {
            (None, Err(Error::Forked), 2) => {}
            (wrong, released, joints) => {
                return Err(format!("{wrong:?}, release {released:?}, {joints} joints"));
            }
        }
        drop(records);
        drop(client);
        Ok(())
    }
}

/// Returns all files below `folder`.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut found: Vec<_> =
        entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect();
    found.sort();
    found
}

/// Goal: a child that uses and ends what it inherited changes nothing for its parent.
#[test]
fn forked_process_is_refused_and_changes_nothing() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let mut objects = Objects::of(&directory);
    until("the setpoint of the parent", || daemon.setpoints().first().map(drop));
    let (before, setpoints) = (files(directory.path()), daemon.setpoints().len());
    // The child owns its copy of the objects.
    let copy = std::ptr::from_ref(&objects);
    // SAFETY: the parent drops the original, and the child, which never drops it, this copy.
    in_child(|| unsafe { copy.read() }.are_refused()).unwrap();
    assert_eq!(files(directory.path()), before);
    assert_eq!(daemon.setpoints().len(), setpoints, "the child sent nothing");
    for _ in 0..20 {
        objects.client.wait(TIMEOUT).unwrap().of(&objects.claim).unwrap();
        objects.claim.commit().unwrap();
    }
    objects.records.take(&mut CycleRecord::default()).unwrap();
    objects.claim.release().unwrap();
}

/// A fork copies the locks that other threads hold, and not the threads.
#[test]
fn fork_beside_waiting_threads_hangs_no_child() {
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let (client, end) = (connect(&directory), AtomicBool::new(false));
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !end.load(Ordering::Relaxed) {
                    client.spin(TIMEOUT).unwrap();
                    let _ = client.description();
                }
            });
        }
        let refused = || match (client.newest().err(), client.description().joints.len()) {
            (Some(Error::Forked), 2) => Ok(()),
            other => Err(format!("{other:?}")),
        };
        let ended = (0..FORKS).try_for_each(|_| in_child(refused));
        end.store(true, Ordering::Relaxed);
        ended.unwrap();
    });
}

/// Runs the ignored test `body` in a process without a daemon: the daemon's threads would hold
/// locks of iceoryx2 in a fork.
fn in_controller(body: &str) {
    let directory = directory();
    let mut daemon = spawn("killed_daemon", &directory, 1);
    let ended = spawn(body, &directory, 1).wait();
    daemon.kill().unwrap();
    daemon.wait().unwrap();
    assert!(ended.unwrap().success(), "{body}");
}

/// Returns the runtime directory of a process that [`in_controller`] started, once its daemon runs.
fn controller() -> Option<PathBuf> {
    let runtime = PathBuf::from(std::env::var_os("MOTORD_TEST_RUNTIME")?);
    until("a connection", || Client::connect_in(&runtime, INSTANCE).ok());
    Some(runtime)
}

/// Connects in a forked process and waits for a state.
fn connect_anew(runtime: &Path) -> Result<Client, String> {
    let own = Client::connect_in(runtime, INSTANCE).map_err(|error| error.to_string())?;
    own.wait(TIMEOUT).map_err(|error| error.to_string())?;
    Ok(own)
}

#[test]
fn forked_process_connects_and_stops_anew() {
    in_controller("forks::controller_whose_child_stops");
}

#[test]
#[ignore = "the body of a process"]
fn controller_whose_child_stops() {
    let Some(runtime) = controller() else { return };
    let inherited = Client::connect_in(&runtime, INSTANCE).unwrap();
    let claim = inherited.claim("leg").unwrap();
    in_child(|| {
        let own = connect_anew(&runtime)?;
        in_child(
            || if own.newest() == Err(Error::Forked) { Ok(()) } else { Err("a grandchild reads".into()) },
        )?;
        let owned = own.claim("leg").err().filter(|error| matches!(error, Error::Refused { .. }));
        owned.ok_or("the group of the parent was claimed")?;
        inherited.emergency_stop().map_err(|error| error.to_string())
    })
    .unwrap();
    inherited.wait(TIMEOUT).unwrap().of(&claim).unwrap();
}

/// A fork copies the locks of iceoryx2 that other threads hold while they connect and disconnect.
#[test]
fn fork_beside_connecting_threads_hangs_no_child() {
    in_controller("forks::controller_with_connecting_threads");
}

#[test]
#[ignore = "the body of a process"]
fn controller_with_connecting_threads() {
    let Some(runtime) = controller() else { return };
    let end = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !end.load(Ordering::Relaxed) {
                    drop(Client::connect_in(&runtime, INSTANCE).unwrap());
                }
            });
        }
        let ended = (0..FORKS).try_for_each(|_| in_child(|| connect_anew(&runtime).map(drop)));
        end.store(true, Ordering::Relaxed);
        ended.unwrap();
    });
}
