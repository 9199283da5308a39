//! The client against a daemon that is only its ports: what it says, what it survives.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use iceoryx2::prelude::{Config, FileName, NodeBuilder, SemanticString as _, ServiceName, ZeroCopySend};
use motord_client::{
    Cause, Claim, Client, Error, InstanceError, JointLimits, Obstacle, Phase, Refusal, Rejection, Setpoint,
    State, Stop,
};
use motord_ports::{DaemonPorts, Housekeeper, Instance, Request, clock};
use motord_shared::description::{GroupDescription, JointDescription, RobotDescription, Telemetry};
use motord_shared::limits::CONTROLLERS_MAX;
use motord_shared::message::{
    AdminReply, GroupState, JOINT_VALID, JointState, SetpointMessage, StateMessage,
};
use motord_shared::{JointSetpoint, Lease, MotorMode, Operation};
use std::os::unix::ffi::OsStrExt as _;
use std::path::Path;
use std::process::{Child, Command};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tempfile::TempDir;

const INSTANCE: &str = "robot";
/// Long enough for a machine that stalls.
const PATIENCE: Duration = Duration::from_secs(5);

/// The daemon of a test: it serves the client, and records the setpoints that it received.
struct FakeDaemon {
    ports: DaemonPorts,
    boot_id: u64,
    cycle: u64,
    owner: u64,
    epoch: u32,
    sequence: u64,
    seen: Arc<Mutex<Vec<SetpointMessage>>>,
    silent: Arc<AtomicBool>,
    /// The second joint is not heard.
    mute: Arc<AtomicBool>,
    /// The second joint is excluded.
    excluded: Arc<AtomicBool>,
    /// Code of the cause that is latched, for the second joint.
    cause: Arc<AtomicU32>,
    phase: Phase,
    /// Requests that get no answer.
    held: Vec<Request>,
    /// As described: it cycles at 1 kHz all the same.
    rate_hz: f64,
}

impl FakeDaemon {
    /// Serves requests before it looks at setpoints: a client must not rely on the order it sent them in.
    fn cycle(&mut self, joint_count: u32) {
        self.cycle += 1;
        while let Some(request) = self.ports.next_request().unwrap() {
            if request.payload().operation == Operation::ClearFault.code() {
                self.held.push(request);
                continue;
            }
            let (reply, text) = self.answer(request.payload().operation, request.payload().lease);
            let _ = request.reply(reply, &text);
        }
        let take = |setpoint: &SetpointMessage| {
            self.sequence = setpoint.sequence;
            self.seen.lock().unwrap().push(*setpoint);
        };
        self.ports.take_setpoint(take).unwrap();
        if self.silent.load(Ordering::Relaxed) {
            return;
        }
        let mut state = StateMessage {
            boot_id: self.boot_id,
            cycle: self.cycle,
            tick_ns: clock::now_ns(),
            publish_ns: clock::now_ns(),
            joint_count,
            group_count: 1,
            ..StateMessage::default()
        };
        for (place, joint) in state.joints.iter_mut().enumerate() {
            let is_heard = place != 1 || !self.mute.load(Ordering::Relaxed);
            let (position, flags) = if is_heard { (0.5 + place as f32, JOINT_VALID) } else { (f32::NAN, 0) };
            let is_excluded = place == 1 && self.excluded.load(Ordering::Relaxed);
            let mode = if is_excluded { MotorMode::Excluded } else { MotorMode::Idle }.code();
            *joint = JointState { position, flags, mode, ..JointState::default() };
        }
        let cause = self.cause.load(Ordering::Relaxed);
        self.phase = match self.phase {
            _ if cause != 0 => Phase::Disarmed,
            Phase::Starting if self.cycle.is_multiple_of(5) => Phase::Active,
            phase => phase,
        };
        state.groups[0] = GroupState {
            lease: self.owner,
            sequence: self.sequence,
            phase: self.phase.code(),
            cause,
            cause_joint: 1,
            ..GroupState::default()
        };
        self.ports.publish(&state).unwrap();
        self.ports.notify().unwrap();
    }

    fn answer(&mut self, operation: u32, lease: u64) -> (AdminReply, Vec<u8>) {
        let done = AdminReply::default();
        match Operation::try_from(operation) {
            Ok(Operation::Describe) => (done, serde_json::to_vec(&self.description()).unwrap()),
            Ok(Operation::Telemetry) => (done, serde_json::to_vec(&Telemetry::default()).unwrap()),
            Ok(Operation::Claim) if self.owner == 0 => {
                self.epoch += 1;
                self.sequence = 0;
                self.owner = granted(self.boot_id, self.epoch);
                (AdminReply { lease: self.owner, ..done }, vec![])
            }
            Ok(Operation::Claim) => {
                (AdminReply { refusal: Refusal::Owned.code(), detail: 4321, ..done }, vec![])
            }
            Ok(Operation::Release) if lease == self.owner => {
                self.owner = 0;
                (done, vec![])
            }
            Ok(Operation::ForceRelease) => {
                self.owner = 0;
                (done, vec![])
            }
            Ok(Operation::Enable) if self.sequence == 0 => {
                (AdminReply { refusal: Refusal::NoSetpoint.code(), ..done }, vec![])
            }
            Ok(Operation::Enable) if lease == self.owner => {
                self.phase = Phase::Starting;
                (done, vec![])
            }
            Ok(Operation::Disable) => {
                self.phase = Phase::Disarmed;
                (done, vec![])
            }
            Ok(Operation::EmergencyStop) => (done, vec![]),
            _ => (AdminReply { refusal: Refusal::Busy.code(), ..done }, vec![]),
        }
    }

    fn description(&self) -> RobotDescription {
        let joint = |name: &str| JointDescription { name: name.into(), ..JointDescription::default() };
        RobotDescription {
            pid: std::process::id(),
            boot_id: self.boot_id,
            rate_hz: self.rate_hz,
            joints: vec![joint("hip"), joint("knee")],
            groups: vec![GroupDescription { name: "leg".into(), joints: vec![0, 1] }],
            ..RobotDescription::default()
        }
    }
}

fn granted(boot_id: u64, epoch: u32) -> u64 {
    Lease::new(boot_id, epoch, 0).unwrap().raw()
}

/// The daemon cleans up after dead clients four times a second.
const CLEANING_CYCLES: u64 = 250;

/// A fake daemon on a thread of its own, until it is dropped.
struct Running {
    stop: Arc<AtomicBool>,
    /// Publishes no states; everything else goes on.
    silent: Arc<AtomicBool>,
    mute: Arc<AtomicBool>,
    excluded: Arc<AtomicBool>,
    cause: Arc<AtomicU32>,
    seen: Arc<Mutex<Vec<SetpointMessage>>>,
    thread: Option<JoinHandle<()>>,
}

impl Running {
    fn start(runtime: &Path, boot_id: u64) -> Self {
        Self::start_with(runtime, boot_id, 2, 1000.0)
    }

    fn start_with(runtime: &Path, boot_id: u64, joint_count: u32, rate_hz: f64) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (seen, silent) = (Arc::default(), Arc::<AtomicBool>::default());
        let (mute, excluded) = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
        let cause = Arc::<AtomicU32>::default();
        let (running, runtime) = (Arc::new(AtomicBool::new(false)), runtime.to_owned());
        let thread = std::thread::spawn({
            let (stop, seen, running) = (Arc::clone(&stop), Arc::clone(&seen), Arc::clone(&running));
            let (silent, mute) = (Arc::clone(&silent), Arc::clone(&mute));
            let (excluded, cause) = (Arc::clone(&excluded), Arc::clone(&cause));
            move || {
                let lock = Instance::below(&runtime, INSTANCE).unwrap().lock().unwrap();
                let ports = DaemonPorts::open(&lock).unwrap();
                let housekeeper = Housekeeper::open(&lock).unwrap();
                let mut daemon = FakeDaemon {
                    ports,
                    boot_id,
                    cycle: 0,
                    owner: 0,
                    epoch: 0,
                    sequence: 0,
                    seen,
                    silent,
                    mute,
                    excluded,
                    cause,
                    phase: Phase::Disarmed,
                    held: vec![],
                    rate_hz,
                };
                let mut tick = Instant::now();
                while !stop.load(Ordering::Relaxed) {
                    daemon.cycle(joint_count);
                    if daemon.cycle.is_multiple_of(CLEANING_CYCLES) {
                        let _removed = housekeeper.clean();
                    }
                    running.store(true, Ordering::Relaxed);
                    tick = Instant::now().max(tick + Duration::from_millis(1));
                    std::thread::sleep(tick.saturating_duration_since(Instant::now()));
                }
            }
        });
        while !running.load(Ordering::Relaxed) && !thread.is_finished() {
            std::thread::sleep(Duration::from_millis(1));
        }
        Self { stop, silent, mute, excluded, cause, seen, thread: Some(thread) }
    }

    fn setpoints(&self) -> Vec<SetpointMessage> {
        self.seen.lock().unwrap().clone()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap();
    }
}

fn place() -> TempDir {
    tempfile::tempdir_in("/tmp").unwrap()
}

fn connect(place: &TempDir) -> Client {
    let client = Client::connect_in(place.path(), INSTANCE).unwrap();
    client.set_silence(Duration::from_millis(500));
    client
}

/// Runs the ignored test `role` of this file in a process of its own.
fn spawn(role: &str, place: &TempDir, boot_id: u64) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", role])
        .env("MOTORD_TEST_RUNTIME", place.path())
        .env("MOTORD_TEST_BOOT_ID", boot_id.to_string())
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap()
}

fn until<T>(what: &str, mut attempt: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(done) = attempt() {
            return done;
        }
        assert!(begun.elapsed() < 4 * PATIENCE, "{what} did not happen");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
#[ignore = "the body of a process that other tests kill"]
fn killed_controller() {
    let Some(runtime) = std::env::var_os("MOTORD_TEST_RUNTIME") else { return };
    let client = Client::connect_in(Path::new(&runtime), INSTANCE).unwrap();
    // The places of the dead are free within a quarter of a second; a quick computer kills sixteen controllers in less.
    let mut claim = until("a place", || client.claim("leg").ok());
    let end = Instant::now() + 4 * PATIENCE;
    // Until it is killed. The fake daemon is silent while it cleans up, which is no reason to leave.
    while Instant::now() < end {
        let _silent = client.wait(PATIENCE);
        let _ = claim.send(&[Setpoint::damping(1.0); 2]);
    }
}

#[test]
#[ignore = "the body of a process that other tests kill"]
fn killed_daemon() {
    let Some(runtime) = std::env::var_os("MOTORD_TEST_RUNTIME") else { return };
    let boot_id = std::env::var("MOTORD_TEST_BOOT_ID").unwrap().parse().unwrap();
    let _daemon = Running::start(Path::new(&runtime), boot_id);
    std::thread::sleep(Duration::from_secs(60));
}

#[test]
fn where_no_daemon_runs_connecting_says_so() {
    let place = place();
    for runtime in [place.path().to_owned(), place.path().join("missing")] {
        let error = Client::connect_in(&runtime, INSTANCE).unwrap_err();
        assert!(matches!(error, Error::NotRunning { .. }), "{error}");
        assert!(error.to_string().contains(&runtime.display().to_string()), "{error}");
        assert_eq!(error.exit_status(), 69);
    }
}

#[test]
fn connecting_after_daemon_exit_reports_none_running() {
    let place = place();
    drop(Running::start(place.path(), 1));
    let error = Client::connect_in(place.path(), INSTANCE).unwrap_err();
    assert!(matches!(error, Error::NotRunning { .. }), "{error}");
}

#[test]
fn names_that_could_leave_the_directory_are_refused() {
    let place = place();
    for name in ["", "..", "a/b", "A", "a b", "a\n", "0123456789012345678901234567890123"] {
        let error = Client::connect_in(place.path(), name).unwrap_err();
        assert_eq!(error.exit_status(), 64, "{name:?}: {error}");
    }
}

#[test]
fn sleeping_and_spinning_clients_receive_states() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    assert_eq!((client.joint("knee"), client.group("leg"), client.joint("toe")), (Some(1), Some(0), None));
    let mut last = 0;
    for turn in 0..200 {
        let state = if turn % 2 == 0 { client.wait(PATIENCE) } else { client.spin(PATIENCE) }.unwrap();
        assert!(state.cycle() > last, "no state is given twice, none is older than the one before");
        last = state.cycle();
    }
    assert_eq!(client.telemetry().unwrap(), Telemetry::default());
}

#[test]
fn setpoints_arrive_whole_with_rising_sequence() {
    let place = place();
    let daemon = Running::start(place.path(), 7);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    for turn in 0..50_u8 {
        client.wait(PATIENCE).unwrap();
        claim.send(&[Setpoint::torque(f32::from(turn)), Setpoint::damping(f32::from(turn))]).unwrap();
    }
    until("the last setpoint", || daemon.setpoints().last().filter(|last| last.sequence == 50).copied());
    let seen = daemon.setpoints();
    assert!(seen.windows(2).all(|pair| pair[0].sequence < pair[1].sequence));
    assert!(seen.windows(2).all(|pair| pair[0].time_ns <= pair[1].time_ns));
    for setpoint in &seen {
        assert_eq!((setpoint.lease, setpoint.joint_count), (granted(7, 1), 2));
        assert_eq!(setpoint.joints[0].torque.to_bits(), setpoint.joints[1].kd.to_bits());
        assert!(setpoint.cycle > 0);
    }
}

/// The setpoints of the last message, hip and knee.
fn last_of(daemon: &Running, sequence: u64) -> [JointSetpoint; 2] {
    let last =
        until("the setpoint", || daemon.setpoints().last().filter(|last| last.sequence == sequence).copied());
    [last.joints[0], last.joints[1]]
}

#[test]
fn setpoints_by_name_and_slot_reach_their_joints() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    let [knee, hip] = claim.slots(["knee", "hip"]).unwrap()[..] else { panic!("two slots") };
    claim.set("knee", Setpoint::torque(2.0)).unwrap();
    claim.set(hip, Setpoint::torque(1.0)).unwrap();
    claim.commit().unwrap();
    assert_eq!(last_of(&daemon, 1).map(|joint| joint.torque), [1.0, 2.0]);
    claim.set(knee, Setpoint::torque(3.0)).unwrap();
    claim.commit().unwrap();
    assert_eq!(last_of(&daemon, 2).map(|joint| joint.torque), [1.0, 3.0], "the hip keeps what it was given");
    assert_eq!(claim.setpoint("knee"), Ok(Setpoint::torque(3.0)));
    assert_eq!(claim.limits(knee), Ok(JointLimits::default()));
    let unknown = claim.set("toe", Setpoint::torque(0.0)).unwrap_err();
    assert!(unknown.to_string().contains("hip, knee"), "{unknown}");
}

/// The daemon would reject the whole group, and stop it a setpoint timeout later for a cause that hides the mistake.
#[test]
fn invalid_setpoint_is_reported_immediately_and_changes_nothing() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    claim.set("knee", Setpoint::torque(1.0)).unwrap();
    for (bad, rejection) in [
        (Setpoint::torque(f32::NAN), Rejection::NotFinite),
        (Setpoint::hold(f32::INFINITY, 1.0, 1.0), Rejection::NotFinite),
        (Setpoint::damping(-1.0), Rejection::Negative),
    ] {
        assert_eq!(claim.set("knee", bad), Err(Error::BadSetpoint { joint: "knee".into(), rejection }));
    }
    let state = client.wait(PATIENCE).unwrap();
    assert!(matches!(claim.hold(&state, f32::NAN, 0.5), Err(Error::BadSetpoint { .. })));
    assert!(matches!(claim.hold(&state, 5.0, -0.5), Err(Error::BadSetpoint { .. })));
    assert_eq!(claim.setpoint("knee"), Ok(Setpoint::torque(1.0)));
}

/// A joint without a setpoint would be limp.
#[test]
fn group_is_not_sent_before_all_joints_set() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    claim.set("hip", Setpoint::damping(1.0)).unwrap();
    assert_eq!(claim.commit(), Err(Error::NotSet { joint: "knee".into() }));
    client.wait(PATIENCE).unwrap();
    assert_eq!(daemon.setpoints(), []);
    claim.set("knee", Setpoint::damping(1.0)).unwrap();
    claim.commit().unwrap();
}

/// After a restart with another configuration it could be another joint.
#[test]
fn a_slot_of_another_claim_is_refused() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let old = client.claim("leg").unwrap().slot("knee").unwrap();
    let mut claim = client.claim("leg").unwrap();
    assert_eq!(claim.set(old, Setpoint::torque(1.0)), Err(Error::OtherClaim));
    assert_eq!(claim.limits(old), Err(Error::OtherClaim));
    let state = client.wait(PATIENCE).unwrap();
    assert_eq!(state.of(&claim).unwrap().joint(old), Err(Error::OtherClaim));
}

/// The next state whose second joint is heard or not.
fn state_with(client: &Client, is_heard: bool) -> State {
    until("such a state", || {
        Some(client.wait(PATIENCE).unwrap())
            .filter(|state| state.joint(1).unwrap().position().is_some() == is_heard)
    })
}

#[test]
fn hold_needs_a_state_of_every_joint() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    daemon.mute.store(true, Ordering::Relaxed);
    let state = state_with(&client, false);
    let silent = Error::NotHeard { joint: "knee".into() };
    assert_eq!(claim.hold(&state, 5.0, 0.5), Err(silent.clone()));
    assert!(matches!(claim.commit(), Err(Error::NotSet { .. })), "nothing was set");
    let leg = state.of(&claim).unwrap();
    assert_eq!((leg.position("hip"), leg.position("knee"), leg.is_heard()), (Ok(0.5), Err(silent), false));
    daemon.mute.store(false, Ordering::Relaxed);
    let state = state_with(&client, true);
    claim.hold(&state, 5.0, 0.5).unwrap();
    claim.commit().unwrap();
    assert_eq!(
        last_of(&daemon, 1).map(|joint| (joint.position, joint.kp, joint.kd)),
        [(0.5, 5.0, 0.5), (1.5, 5.0, 0.5)]
    );
    let leg = state.of(&claim).unwrap();
    assert_eq!(leg.positions(), Ok(vec![0.5, 1.5]));
    assert_eq!(leg.joints().map(|(name, _)| name.to_owned()).collect::<Vec<_>>(), ["hip", "knee"]);
}

#[test]
fn group_holds_without_its_absent_excluded_joint() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    daemon.excluded.store(true, Ordering::Relaxed);
    daemon.mute.store(true, Ordering::Relaxed);
    let state = state_with(&client, false);
    let leg = state.of(&claim).unwrap();
    assert!(leg.is_heard() && leg.joint("knee").unwrap().is_excluded());
    claim.hold(&state, 5.0, 0.5).unwrap();
    claim.commit().unwrap();
    assert_eq!(last_of(&daemon, 1).map(|joint| (joint.position, joint.kp)), [(0.5, 5.0), (0.0, 0.0)]);
}

#[test]
fn states_report_a_claim_taken_away() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let (client, other) = (connect(&place), connect(&place));
    let claim = client.claim("leg").unwrap();
    for _ in 0..20 {
        client.wait(PATIENCE).unwrap().of(&claim).unwrap();
    }
    other.force_release("leg").unwrap();
    let lost = until("the loss", || client.wait(PATIENCE).unwrap().of(&claim).err());
    assert_eq!(lost, Error::ClaimLost { group: "leg".into() });
    assert!(lost.is_transient());
}

#[test]
fn setpoints_continue_while_waiting_for_the_group() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let (client, operator) = (connect(&place), connect(&place));
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    claim.enable().unwrap();
    let before = daemon.setpoints().len();
    claim.wait_for(Phase::Active, PATIENCE).unwrap();
    operator.wait_for("leg", Phase::Starting, PATIENCE).unwrap();
    assert!(client.wait(PATIENCE).unwrap().of(&claim).unwrap().must_be_active().is_ok());
    assert!(daemon.setpoints().len() > before, "the owner was heard while it waited");
    let expected = Error::NotReached {
        group: "leg".into(),
        phase: Some(Phase::Active),
        expected: Phase::Disarmed,
        waited: Duration::from_millis(20),
    };
    assert_eq!(operator.wait_for("leg", Phase::Disarmed, Duration::from_millis(20)), Err(expected));
    claim.disable().unwrap();
    claim.wait_for(Phase::Disarmed, PATIENCE).unwrap();
}

#[test]
fn starting_group_asks_for_patience_not_enable() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    let error = until("a start", || {
        claim.enable().unwrap();
        let state = client.wait(PATIENCE).unwrap();
        let group = state.of(&claim).unwrap();
        group.must_be_active().err().filter(|_| group.phase() == Some(Phase::Starting))
    });
    assert_eq!(error.to_string(), "group leg does not follow setpoints yet: it is starting");
    assert!(error.is_transient());
}

#[test]
fn stop_during_start_reports_cause_and_joint() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    claim.enable().unwrap();
    daemon.cause.store(Cause::MotorLost.code(), Ordering::Relaxed);
    let stop = Stop::Cause { cause: Cause::MotorLost, joint: Some("knee".into()), pid: None };
    let stopped = Error::Stopped { group: "leg".into(), stop: stop.clone() };
    client.wait(PATIENCE).unwrap();
    assert_eq!(claim.wait_for(Phase::Active, 4 * PATIENCE), Err(stopped.clone()));
    assert_eq!(client.wait(PATIENCE).unwrap().of(&claim).unwrap().must_be_active(), Err(stopped.clone()));
    assert_eq!(client.wait(PATIENCE).unwrap().of(&claim).unwrap().stop(), Some(stop));
    assert_eq!(
        stopped.to_string(),
        "group leg was stopped: A motor stopped answering (joint knee). Check the motor's power, its CAN cable and its id, \
         then reset the group"
    );
    claim.wait_for(Phase::Disarmed, PATIENCE).unwrap();
}

/// How often this thread has slept.
fn sleeps() -> u64 {
    let status = std::fs::read_to_string("/proc/thread-self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("voluntary_ctxt_switches")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
fn slow_controller_sleeps_through_other_states() {
    const N: u32 = 20;
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let first = client.wait_cycles(N, PATIENCE).unwrap().cycle();
    let (mut last, before) = (first, sleeps());
    for _ in 0..20 {
        let cycle = client.wait_cycles(N, PATIENCE).unwrap().cycle();
        assert!(cycle / u64::from(N) > last / u64::from(N), "{cycle} follows {last}");
        last = cycle;
    }
    let slept = sleeps() - before;
    assert!(slept < (last - first) / 2, "{slept} sleeps in {} cycles", last - first);
}

#[test]
fn slow_controller_notices_restart_and_silence() {
    hears_of_a_restart_and_of_silence(|client| client.wait_cycles(2, PATIENCE));
}

#[test]
fn spinning_controller_notices_restart_and_silence() {
    hears_of_a_restart_and_of_silence(|client| client.spin(PATIENCE));
}

fn hears_of_a_restart_and_of_silence(take: fn(&Client) -> Result<State, Error>) {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    take(&client).unwrap();
    daemon.silent.store(true, Ordering::Relaxed);
    let error = until("silence", || take(&client).err());
    assert!(matches!(error, Error::Silent { .. }), "{error}");
    drop(daemon);
    let _successor = Running::start(place.path(), 2);
    until("the restart", || (take(&client) == Err(Error::Restarted)).then_some(()));
    take(&client).unwrap();
}

#[test]
fn setpoint_with_wrong_joint_count_is_not_sent() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    assert_eq!(claim.send(&[Setpoint::damping(1.0)]), Err(Error::SetpointCount { expected: 2, received: 1 }));
    client.wait(PATIENCE).unwrap();
    assert_eq!(daemon.setpoints(), []);
}

#[test]
fn one_setpoint_is_enough_to_enable() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    for _ in 0..20 {
        let mut claim = client.claim("leg").unwrap();
        let early = claim.enable().unwrap_err();
        assert!(matches!(early, Error::Refused { refusal: Refusal::NoSetpoint, .. }), "{early}");
        claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
        claim.enable().unwrap();
    }
}

#[test]
fn a_dropped_claim_leaves_the_group_to_others() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let (first, second) = (connect(&place), connect(&place));
    let claim = first.claim("leg").unwrap();
    let refused = second.claim("leg").unwrap_err();
    assert!(matches!(refused, Error::Refused { refusal: Refusal::Owned, .. }), "{refused}");
    assert!(refused.to_string().contains("process 4321"), "{refused}");
    drop(claim);
    second.claim("leg").unwrap().release().unwrap();
    first.claim("leg").unwrap();
    let unknown = first.claim("arm").unwrap_err();
    assert!(unknown.to_string().contains("leg"), "{unknown}");
}

#[test]
fn a_restart_is_told_once_and_survived() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    client.wait(PATIENCE).unwrap();
    drop(daemon);
    let daemon = Running::start(place.path(), 2);
    let error = until("the restart", || match client.wait(PATIENCE) {
        Ok(_) | Err(Error::Silent { .. } | Error::Timeout { .. }) => None,
        Err(error) => Some(error),
    });
    assert_eq!(error, Error::Restarted);
    client.wait(PATIENCE).unwrap();
    assert_eq!(client.description().boot_id, 2);
    for _ in 0..3 {
        assert_eq!(
            claim.send(&[Setpoint::damping(1.0); 2]),
            Err(Error::Restarted),
            "a void claim stays void"
        );
    }
    assert_eq!(claim.enable(), Err(Error::Restarted));
    assert_eq!(daemon.setpoints(), []);
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    until("the setpoint", || {
        daemon.setpoints().first().filter(|first| first.lease == granted(2, 1)).copied()
    });
}

/// Five cycles of the successor take longer than the silence that the caller has set.
#[test]
fn configured_silence_outlives_a_slower_daemon() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = Client::connect_in(place.path(), INSTANCE).unwrap();
    client.set_silence(Duration::from_millis(200));
    client.wait(PATIENCE).unwrap();
    drop(daemon);
    let daemon = Running::start_with(place.path(), 2, 2, 0.1);
    until("the restart", || matches!(client.wait(PATIENCE), Err(Error::Restarted)).then_some(()));
    client.wait(PATIENCE).unwrap();
    daemon.silent.store(true, Ordering::Relaxed);
    assert!(matches!(until("an error", || client.wait(PATIENCE).err()), Error::Silent { .. }));
}

#[test]
fn request_after_restart_reports_it_and_acts_not() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    client.wait(PATIENCE).unwrap();
    drop(daemon);
    let _successor = Running::start(place.path(), 2);
    until("the restart", || matches!(client.enable("leg"), Err(Error::Restarted)).then_some(()));
    assert!(matches!(client.enable("leg"), Err(Error::Refused { refusal: Refusal::NoSetpoint, .. })));
}

#[test]
fn silent_daemon_is_reported_within_few_silence_times() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    let mut claim = client.claim("leg").unwrap();
    client.wait(PATIENCE).unwrap();
    drop(daemon);
    let begun = Instant::now();
    let error = until("an error", || client.wait(PATIENCE).err());
    assert!(
        matches!(error, Error::Silent { .. }),
        "this process lives, so its states are merely silent: {error}"
    );
    assert!(
        begun.elapsed() < PATIENCE,
        "waiting ends when the silence is noticed, not when its time is over"
    );
    assert!(claim.send(&[Setpoint::damping(1.0); 2]).is_err());
}

#[test]
fn killed_daemon_is_noticed_and_successor_found() {
    let place = place();
    let mut daemon = spawn("killed_daemon", &place, 1);
    let client = until("a daemon", || Client::connect_in(place.path(), INSTANCE).ok());
    client.set_silence(Duration::from_millis(500));
    client.wait(PATIENCE).unwrap();
    daemon.kill().unwrap();
    daemon.wait().unwrap();
    let error = until("an error", || client.wait(PATIENCE).err());
    assert!(matches!(error, Error::NotRunning { .. }), "{error}");
    let mut daemon = spawn("killed_daemon", &place, 2);
    let error = until("the restart", || match client.wait(PATIENCE) {
        Err(Error::NotRunning { .. } | Error::Timeout { .. }) => None,
        other => Some(other),
    });
    assert_eq!(error.unwrap_err(), Error::Restarted);
    assert!(client.wait(PATIENCE).is_ok());
    client.claim("leg").unwrap().release().unwrap();
    daemon.kill().unwrap();
    daemon.wait().unwrap();
}

/// Goal: a process that is killed blocks nobody, and its places become free.
/// Method: more kills, one after the other, than there are places for controllers.
#[test]
fn killed_controllers_neither_block_nor_keep_slots() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    for _ in 0..=CONTROLLERS_MAX {
        let before = daemon.setpoints().len();
        let mut controller = spawn("killed_controller", &place, 0);
        until("setpoints", || (daemon.setpoints().len() > before).then_some(()));
        controller.kill().unwrap();
        controller.wait().unwrap();
        client.wait(PATIENCE).unwrap();
        client.emergency_stop().unwrap();
        client.force_release("leg").unwrap();
    }
    client.claim("leg").unwrap().send(&[Setpoint::damping(1.0); 2]).unwrap();
}

#[test]
fn second_daemon_learns_who_runs_the_instance() {
    let place = place();
    let instance = Instance::below(place.path(), INSTANCE).unwrap();
    let lock = instance.lock().unwrap();
    let error = instance.lock().unwrap_err();
    assert!(
        matches!(error, InstanceError::AlreadyRunning { pid, .. } if pid == std::process::id()),
        "{error}"
    );
    Instance::below(place.path(), "other").unwrap().lock().unwrap();
    drop(lock);
    instance.lock().unwrap();
}

#[test]
fn watcher_that_never_reads_leaks_no_memory() {
    let place = place();
    let lock = Instance::below(place.path(), INSTANCE).unwrap().lock().unwrap();
    let ports = DaemonPorts::open(&lock).unwrap();
    let housekeeper = Housekeeper::open(&lock).unwrap();
    let attach = || motord_ports::ClientPorts::open(lock.instance().attach().unwrap().unwrap()).unwrap();
    let (idle, reader) = (attach(), attach());
    assert!(idle.newest_state().unwrap().is_none() && reader.newest_state().unwrap().is_none());
    for cycle in 1..=10_000 {
        ports.publish(&StateMessage { cycle, ..StateMessage::default() }).unwrap();
        ports.notify().unwrap();
        assert_eq!(reader.newest_state().unwrap().map(|state| state.cycle), Some(cycle));
    }
    assert_eq!(idle.newest_state().unwrap().map(|state| state.cycle), Some(10_000), "the newest wins");
    assert_eq!(housekeeper.clean(), 0, "the living are left alone");
}

#[test]
fn a_lying_joint_count_reaches_nobody() {
    let place = place();
    let _daemon = Running::start_with(place.path(), 1, u32::MAX, 1000.0);
    let client = connect(&place);
    assert_eq!(client.wait(PATIENCE).unwrap().joints().count(), 64);
}

/// Removes the file of the service `record`: a daemon that is older than that service has none.
fn forget_records(directory: &Path) {
    for entry in std::fs::read_dir(directory).unwrap().map(Result::unwrap) {
        let path = entry.path();
        if path.is_dir() {
            forget_records(&path);
        } else if std::fs::read(&path)
            .is_ok_and(|text| String::from_utf8_lossy(&text).contains("robot/record"))
        {
            std::fs::remove_file(&path).unwrap();
        }
    }
}

#[test]
fn daemon_without_records_is_reported_as_other_version() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    forget_records(&place.path().join("iox"));
    let error = client.records().unwrap_err();
    assert!(matches!(error, Error::Version { service: "record", .. }), "{error}");
}

#[test]
fn another_layout_is_told_as_another_version() {
    #[derive(Debug, Clone, Copy, ZeroCopySend)]
    #[type_name("motord.State.v9")]
    #[repr(C)]
    struct Newer(u64);

    let place = place();
    let lock = Instance::below(place.path(), INSTANCE).unwrap().lock().unwrap();
    let mut config = Config::default();
    let root = place.path().join("iox").join(INSTANCE);
    config.global.set_root_path(&iceoryx2::prelude::Path::new(root.as_os_str().as_bytes()).unwrap());
    config.global.prefix = FileName::new(b"m_").unwrap();
    let node = NodeBuilder::new().config(&config).create::<motord_ports::service::Service>().unwrap();
    let name = ServiceName::new("motord/robot/state").unwrap();
    let _newer = node.service_builder(&name).publish_subscribe::<Newer>().create().unwrap();
    let error = Client::connect_in(place.path(), INSTANCE).unwrap_err();
    assert!(matches!(&error, Error::Version { daemon, .. } if daemon == "motord.State.v9"), "{error}");
    let error = DaemonPorts::open(&lock).unwrap_err();
    assert_eq!(error.obstacle, Obstacle::Version, "{error}");
}

/// Threads may share a client, and hand a claim on.
const _: () = {
    const fn must_be_shared_by_threads<T: Send + Sync>() {}
    must_be_shared_by_threads::<Client>();
    must_be_shared_by_threads::<Claim>();
};

/// A daemon that serves but publishes nothing, a client that has read its last state, and the client's claim.
fn silent_daemon(place: &TempDir) -> (Running, Client, Claim) {
    let daemon = Running::start(place.path(), 1);
    let client = connect(place);
    client.set_silence(4 * PATIENCE);
    let claim = client.claim("leg").unwrap();
    daemon.silent.store(true, Ordering::Relaxed);
    until("the last state", || client.wait(Duration::from_millis(50)).is_err().then_some(()));
    (daemon, client, claim)
}

/// Goal: a thread that waits for a state keeps no other thread from sending or from an emergency stop.
/// Method: the daemon serves but publishes nothing, so that one thread sleeps in `wait` until the others are done.
#[test]
fn waiting_thread_blocks_neither_send_nor_stop() {
    let place = place();
    let (daemon, client, mut claim) = silent_daemon(&place);
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| client.wait(3 * PATIENCE));
        std::thread::sleep(Duration::from_millis(50));
        for _ in 0..20 {
            claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
            client.emergency_stop().unwrap();
        }
        until("the setpoints", || daemon.setpoints().last().filter(|last| last.sequence == 20).copied());
        assert!(!waiting.is_finished(), "there was no state yet");
        daemon.silent.store(false, Ordering::Relaxed);
        waiting.join().unwrap().unwrap();
    });
}

#[test]
fn spinning_thread_blocks_neither_send_nor_stop() {
    let place = place();
    let (daemon, client, mut claim) = silent_daemon(&place);
    std::thread::scope(|scope| {
        let spinning = scope.spawn(|| client.spin(3 * PATIENCE));
        for _ in 0..20 {
            claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
            client.emergency_stop().unwrap();
        }
        assert!(!spinning.is_finished(), "there was no state yet");
        daemon.silent.store(false, Ordering::Relaxed);
        spinning.join().unwrap().unwrap();
    });
}

#[test]
fn pending_request_blocks_no_emergency_stop() {
    let place = place();
    let _daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    client.wait(PATIENCE).unwrap();
    std::thread::scope(|scope| {
        let asking = scope.spawn(|| client.clear_fault("hip"));
        std::thread::sleep(Duration::from_millis(50));
        client.emergency_stop().unwrap();
        assert!(!asking.is_finished(), "it waits for its answer for a second");
        assert!(matches!(asking.join().unwrap(), Err(Error::NoAnswer { .. })));
    });
}

/// Goal: each state is given to one thread, and no thread waits longer than it wants to because another one sleeps.
#[test]
fn two_threads_that_wait_share_the_states() {
    let place = place();
    let daemon = Running::start(place.path(), 1);
    let client = connect(&place);
    client.set_silence(4 * PATIENCE);
    let cycles = || (0..100).map(|_| client.wait(PATIENCE).unwrap().cycle()).collect::<Vec<_>>();
    let mut seen = std::thread::scope(|scope| {
        let (one, other) = (scope.spawn(cycles), scope.spawn(cycles));
        [one.join().unwrap(), other.join().unwrap()].concat()
    });
    seen.sort_unstable();
    assert!(seen.windows(2).all(|pair| pair[0] < pair[1]), "no state is given twice");
    daemon.silent.store(true, Ordering::Relaxed);
    until("the last state", || client.wait(Duration::from_millis(50)).is_err().then_some(()));
    std::thread::scope(|scope| {
        let patient = scope.spawn(|| client.wait(3 * PATIENCE));
        std::thread::sleep(Duration::from_millis(50));
        let error = client.wait(Duration::from_millis(20)).unwrap_err();
        assert!(matches!(error, Error::Timeout { .. }), "{error}");
        assert!(!patient.is_finished());
        daemon.silent.store(false, Ordering::Relaxed);
        patient.join().unwrap().unwrap();
    });
}
