//! The dead man's switch, between real processes. Its bus is a recorder: interfaces are for
//! `verify/rigs/test-deaths`.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use crate::player::Player;
use crate::safe_stop::{SIMULATED, can, configuration, motord, no_can, text};
use motord_bus::{BusLock, Frame, Instant, Refusal as BusRefusal, candump, clock};
use motord_core::stopper::Outlet;
use motord_deadman::channel::{Answer, Channel, Listener, Refusal, Request, TIMEOUT as SWITCH_TIMEOUT};
use motord_deadman::heartbeat::{Heartbeat, Pulse};
use motord_deadman::safe_frames::{InterfaceError, InterfaceFrames, SafeFrames};
use motord_deadman::server::Server;
use motord_harness::daemon::until;
use motord_ports::instance::Instance;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::sys::signal::{Signal, kill};
use nix::sys::socket::{ControlMessage, MsgFlags, send, sendmsg};
use nix::unistd::Pid;
use std::io::{BufRead, BufReader, IoSlice, Read};
use std::os::fd::{AsFd, AsRawFd};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::Duration;
use tempfile::TempDir;

/// Longer than a shared machine stalls a process, so only the test triggers the switch.
const TIMEOUT: Duration = Duration::from_millis(400);
const DAMP: Duration = Duration::from_millis(200);
pub(crate) const DAMPING: &str = "001#64616D70696E6721";
const STOPPING: &str = "001#73746F7070696E67";
/// Runtime directory of a child that plays the daemon.
const PLAY: &str = "MOTORD_TEST_PLAY_DAEMON";

/// The interface of the child, unless it is `can0`.
const PLAY_ON: &str = "MOTORD_TEST_PLAY_ON";
/// An interface that a successor drives, in one test.
const SUCCEEDED: &str = "succeeded";

/// The motor on `can0`.
const FIRST: u8 = 1;
/// The motor on `can1`, which can be jammed.
const SECOND: u8 = 2;

pub(crate) fn safe_frames() -> SafeFrames {
    let bus = InterfaceFrames {
        interface: "can0".into(),
        baud: None,
        damp: [vec![DAMPING.into()], vec![DAMPING.into()]],
        stop: vec![STOPPING.into()],
    };
    SafeFrames { heartbeat_timeout: TIMEOUT, damp: DAMP, buses: vec![bus] }
}

/// The same frames, and a motor on `can1`.
fn safe_frames_of_two() -> SafeFrames {
    let mut frames = safe_frames();
    let [damp, stop] = [DAMPING, STOPPING].map(|first| vec![first.replace("001#", "002#")]);
    frames.buses.push(InterfaceFrames {
        interface: "can1".into(),
        baud: None,
        damp: [damp.clone(), damp],
        stop,
    });
    frames
}

/// Reports sent frames with their times. Accepts nothing while it is jammed.
pub(crate) struct Recorder {
    sent: Sender<(Instant, Frame)>,
    jammed: Arc<AtomicBool>,
}

impl Recorder {
    pub(crate) fn new(sent: &Sender<(Instant, Frame)>) -> Self {
        Self { sent: sent.clone(), jammed: Arc::default() }
    }

    pub(crate) fn jammed() -> Self {
        Self { sent: channel().0, jammed: Arc::new(AtomicBool::new(true)) }
    }
}

impl Outlet for Recorder {
    fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<BusRefusal> {
        if self.jammed.load(Ordering::Relaxed) {
            return Some(BusRefusal::Full);
        }
        frames.iter().for_each(|frame| self.sent.send((now, *frame)).unwrap());
        None
    }

    fn find(&mut self) -> bool {
        unreachable!("it is never gone")
    }
}

/// A switch in a separate thread, for `instance`.
pub(crate) struct Switch {
    pub(crate) sent: Receiver<(Instant, Frame)>,
    /// `true` while `can1` accepts nothing.
    jammed: Arc<AtomicBool>,
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Switch {
    pub(crate) fn start(instance: &Instance) -> Self {
        let (recorder, sent) = channel();
        let recorder = Mutex::new(recorder);
        let jammed = Arc::new(AtomicBool::new(false));
        let can1 = Arc::clone(&jammed);
        let open = move |interface: &str, _frames: u32| -> Result<Box<dyn Outlet>, InterfaceError> {
            let recorder = Recorder::new(&recorder.lock().unwrap());
            match interface {
                "can0" | SUCCEEDED => Ok(Box::new(recorder)),
                "can1" => Ok(Box::new(Recorder { jammed: Arc::clone(&can1), ..recorder })),
                _ => Err(InterfaceError::Open { reason: format!("{interface} is not there") }),
            }
        };
        let mut server = Server::new(Listener::bind(instance).unwrap(), open);
        let end = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&end);
        let thread = spawn(move || {
            while !ended.load(Ordering::Relaxed) {
                server.turn(clock::monotonic() + Duration::from_millis(20));
            }
        });
        Self { sent, jammed, end, thread: Some(thread) }
    }

    fn sends_nothing_for(&self, time: Duration) {
        assert_eq!(self.sent.recv_timeout(time), Err(RecvTimeoutError::Timeout));
    }

    /// Checks the damping and the stops of the motor on `can0`. Returns their start.
    fn stops_the_first(&self) -> Instant {
        self.serves(FIRST)
    }

    /// Checks the damping of one motor for [`DAMP`] and three stops, without further frames.
    /// Returns its start.
    fn serves(&self, id: u8) -> Instant {
        let mut frames = Vec::new();
        while let Ok(sent) = self.sent.recv_timeout(Duration::from_millis(1000)) {
            frames.push(sent);
        }
        let (damped, stopped) = frames.split_at(frames.len() - 3);
        let payloads = |frames: &[(Instant, Frame)], of: &str| {
            let of = candump::frame(of).unwrap();
            frames.iter().all(|(_, frame)| frame.id().byte() == Some(id) && frame.payload() == of.payload())
        };
        assert!(!damped.is_empty() && payloads(damped, DAMPING) && payloads(stopped, STOPPING), "{frames:?}");
        assert!(damped.len() <= 20, "100 Hz at most");
        // The rounds are on a grid, and the first one of a reconnected bus may be late.
        assert!(stopped[0].0.since(damped[0].0) >= DAMP - Duration::from_millis(10));
        damped[0].0
    }
}

impl Drop for Switch {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        let _panicked = self.thread.take().map(JoinHandle::join);
    }
}

pub(crate) fn runtime() -> (TempDir, Instance) {
    let directory = TempDir::new().unwrap();
    let instance = Instance::below(directory.path(), "test").unwrap();
    (directory, instance)
}

/// Registers as this process.
fn register(instance: &Instance, frames: SafeFrames, pulse: &Pulse) -> (Channel, Answer) {
    let switch = Channel::connect(instance, SWITCH_TIMEOUT).unwrap();
    switch.send(&Request::Register(frames), Some(pulse)).unwrap();
    let (answer, _) = switch.receive().unwrap();
    (switch, answer)
}

/// A running daemon, as a process that can be killed.
struct Daemon(Player);

impl Daemon {
    fn start(runtime: &Path) -> Self {
        Self::start_on(runtime, "can0")
    }

    fn start_on(runtime: &Path, interface: &str) -> Self {
        let variables = [(PLAY, runtime.as_os_str()), (PLAY_ON, interface.as_ref())];
        Self(Player::start("deadman::plays_the_daemon", &variables, "registered"))
    }

    fn signal(&self, signal: Signal) -> Instant {
        let now = clock::monotonic();
        kill(Pid::from_raw(self.0.id() as i32), signal).unwrap();
        now
    }
}

/// Runs in the process of [`Daemon`]; not a test of its own.
#[test]
fn plays_the_daemon() {
    let Some(runtime) = std::env::var_os(PLAY) else { return };
    let instance = Instance::below(&PathBuf::from(runtime), "test").unwrap();
    let (heartbeat, pulse) = Heartbeat::create().unwrap();
    heartbeat.beat(1);
    let mut frames = safe_frames();
    frames.buses[0].interface = std::env::var(PLAY_ON).unwrap();
    let (_switch, answer) = register(&instance, frames, &pulse);
    assert_eq!(answer, Answer::Registered);
    println!("registered");
    for cycle in 2..u64::MAX {
        heartbeat.beat(cycle);
        sleep(Duration::from_millis(1));
    }
}

#[test]
fn killed_daemon_leaves_motors_damped_then_stopped() {
    let (directory, instance) = runtime();
    let switch = Switch::start(&instance);
    let daemon = Daemon::start(directory.path());
    switch.sends_nothing_for(2 * TIMEOUT);
    let killed = daemon.signal(Signal::SIGKILL);
    let latency = switch.stops_the_first().since(killed);
    println!("from SIGKILL to the first damping frame: {latency:?}");
    assert!(latency < TIMEOUT, "the closed connection tells, not the heartbeat: {latency:?}");
}

/// Goal: a switch that was stopped and continues does not damp the motors of a successor.
/// Method: this process holds the interface, like a successor that waits for its registration.
#[test]
fn switch_leaves_successor_of_dead_daemon_alone() {
    let (directory, instance) = runtime();
    let switch = Switch::start(&instance);
    let daemon = Daemon::start_on(directory.path(), SUCCEEDED);
    let successor = BusLock::interface(SUCCEEDED.parse().unwrap()).unwrap();
    daemon.signal(Signal::SIGKILL);
    switch.sends_nothing_for(2 * TIMEOUT);
    assert_eq!(unserved(&instance), [""; 0]);
    drop(successor);
    let next = Daemon::start_on(directory.path(), SUCCEEDED);
    next.signal(Signal::SIGKILL);
    switch.stops_the_first();
}

#[test]
fn switch_signals_life_to_watched_daemon() {
    let (_directory, instance) = runtime();
    let _switch = Switch::start(&instance);
    let (heartbeat, pulse) = beating();
    let (channel, answer) = register(&instance, safe_frames(), &pulse);
    assert_eq!(answer, Answer::Registered);
    let (mut beats, begun) = (0, clock::monotonic());
    for cycle in 2.. {
        heartbeat.beat(cycle);
        beats += u32::from(channel.take_beats().unwrap());
        if beats == 5 {
            break;
        }
        assert!(clock::monotonic().since(begun) < Duration::from_secs(20), "{beats} beats");
        sleep(Duration::from_millis(1));
    }
    heartbeat.rest();
}

/// Goal: a switch that hangs does not prevent `motord safe-stop`.
/// Method: its socket accepts connections, like that of a stopped process, but sends no answer.
#[test]
fn safe_stop_ignores_a_hanging_switch() {
    let (directory, instance) = runtime();
    let _hangs = Listener::bind(&instance).unwrap();
    let config = configuration(directory.path(), &can(&no_can("hang")));
    let begun = clock::monotonic();
    let output = motord(directory.path(), &["safe-stop"], &config).output().unwrap();
    println!("a safe stop beside a switch that hangs: {:?}", clock::monotonic().since(begun));
    assert!(text(&output).contains("not told to stop"), "it tries by itself: {}", text(&output));
}

#[test]
fn stalled_daemon_is_damped_until_it_resumes() {
    let (directory, instance) = runtime();
    let switch = Switch::start(&instance);
    let daemon = Daemon::start(directory.path());
    let stopped = daemon.signal(Signal::SIGSTOP);
    let (first, frame) = switch.sent.recv().unwrap();
    assert_eq!(candump::frame(DAMPING), Some(frame));
    assert!(first.since(stopped) >= TIMEOUT - Duration::from_millis(100));
    daemon.signal(Signal::SIGCONT);
    sleep(Duration::from_millis(100));
    while switch.sent.try_recv().is_ok() {}
    switch.sends_nothing_for(2 * TIMEOUT);
}

/// Plays a daemon in this process that registers and exits.
fn dies(instance: &Instance, frames: SafeFrames) {
    let (_heartbeat, pulse) = beating();
    let (_connection, answer) = register(instance, frames, &pulse);
    assert_eq!(answer, Answer::Registered);
}

/// Returns the interfaces that the switch has not served.
fn unserved(instance: &Instance) -> Vec<String> {
    let switch = Channel::connect(instance, SWITCH_TIMEOUT).unwrap();
    switch.send(&Request::AskWhetherActing, None).unwrap();
    match switch.receive().unwrap().0 {
        Answer::Acting(unserved) => unserved,
        other => panic!("{other:?}"),
    }
}

/// Returns a switch whose daemon died while `can1` accepts nothing.
pub(crate) fn dead_with_a_jam() -> (TempDir, Instance, Switch) {
    let (directory, instance) = runtime();
    let switch = Switch::start(&instance);
    switch.jammed.store(true, Ordering::Relaxed);
    dies(&instance, safe_frames_of_two());
    (directory, instance, switch)
}

#[test]
fn jammed_bus_is_damped_and_stopped_when_possible() {
    let (_directory, instance, switch) = dead_with_a_jam();
    switch.serves(FIRST);
    assert_eq!(unserved(&instance), ["can1"], "long after the damping was over");
    switch.jammed.store(false, Ordering::Relaxed);
    switch.serves(SECOND);
    assert_eq!(unserved(&instance), [""; 0]);
}

#[test]
fn next_daemon_clears_debt_to_jammed_bus() {
    let (directory, _instance, switch) = dead_with_a_jam();
    switch.serves(FIRST);
    let _next = Daemon::start(directory.path());
    switch.jammed.store(false, Ordering::Relaxed);
    switch.sends_nothing_for(TIMEOUT);
}

#[test]
fn jammed_bus_does_not_delay_switch_exit() {
    let (_directory, instance) = runtime();
    let open = |_: &str, _| -> Result<Box<dyn Outlet>, InterfaceError> { Ok(Box::new(Recorder::jammed())) };
    let mut server = Server::new(Listener::bind(&instance).unwrap(), open);
    let (_heartbeat, pulse) = beating();
    let daemon = Channel::connect(&instance, SWITCH_TIMEOUT).unwrap();
    daemon.send(&Request::Register(safe_frames()), Some(&pulse)).unwrap();
    server.turn(clock::monotonic() + TIMEOUT);
    server.turn(clock::monotonic() + TIMEOUT);
    drop(daemon);
    // A signal to this process may end a turn before it has done anything.
    until("the action", || {
        server.turn(clock::monotonic() + TIMEOUT);
        server.is_acting().then_some(())
    });
    assert_eq!(server.finish(clock::monotonic() + 2 * DAMP), ["can0"]);
}

#[test]
fn clean_exit_of_daemon_causes_no_frame() {
    let (_directory, instance) = runtime();
    let switch = Switch::start(&instance);
    let (heartbeat, pulse) = Heartbeat::create().unwrap();
    heartbeat.beat(1);
    let (connection, _) = register(&instance, safe_frames(), &pulse);
    heartbeat.rest();
    drop((connection, pulse));
    switch.sends_nothing_for(2 * TIMEOUT);
}

#[test]
fn second_daemon_is_refused_then_watched_after_death() {
    let (directory, instance) = runtime();
    let switch = Switch::start(&instance);
    let first = Daemon::start(directory.path());
    let (_heartbeat, pulse) = beating();
    let busy = Answer::Refused(Refusal::Busy { pid: first.0.id() as i32 });
    assert_eq!(register(&instance, safe_frames(), &pulse).1, busy);
    first.signal(Signal::SIGKILL);
    assert_eq!(switch.sent.recv().map(|(_, frame)| Some(frame) == candump::frame(DAMPING)), Ok(true));

    let unfit = SafeFrames {
        buses: vec![InterfaceFrames {
            interface: "can9".into(),
            baud: None,
            damp: Default::default(),
            stop: vec![],
        }],
        ..safe_frames()
    };
    assert!(matches!(register(&instance, unfit, &pulse).1, Answer::Refused(Refusal::SafeFrames(_))));
    assert!(
        switch.sent.recv().is_ok(),
        "a registration that failed does not end the action for the dead daemon"
    );

    let second = Daemon::start(directory.path());
    while switch.sent.try_recv().is_ok() {}
    switch.sends_nothing_for(TIMEOUT);
    second.signal(Signal::SIGKILL);
    switch.stops_the_first();
}

pub(crate) fn beating() -> (Heartbeat, Pulse) {
    let (heartbeat, pulse) = Heartbeat::create().unwrap();
    heartbeat.beat(1);
    (heartbeat, pulse)
}

#[test]
fn a_registration_needs_a_heartbeat_that_has_begun() {
    let (_directory, instance) = runtime();
    let _switch = Switch::start(&instance);
    let (_heartbeat, at_rest) = Heartbeat::create().unwrap();
    assert_eq!(register(&instance, safe_frames(), &at_rest).1, Answer::Refused(Refusal::NoHeartbeat));
    let channel = Channel::connect(&instance, SWITCH_TIMEOUT).unwrap();
    channel.send(&Request::Register(safe_frames()), None).unwrap();
    assert_eq!(channel.receive::<Answer>().unwrap().0, Answer::Refused(Refusal::NoHeartbeat));
}

#[test]
fn nonsense_and_silence_do_not_keep_others_out() {
    let (directory, instance) = runtime();
    let switch = Switch::start(&instance);
    let _silent = Channel::connect(&instance, SWITCH_TIMEOUT).unwrap();
    let nonsense = Channel::connect(&instance, SWITCH_TIMEOUT).unwrap();
    nonsense.send(&vec![0; 1000], None).unwrap();
    assert!(matches!(nonsense.receive().unwrap().0, Answer::Refused(Refusal::Request { .. })));
    assert!(nonsense.receive::<Answer>().is_err(), "hung up on");
    let too_wide = SafeFrames {
        buses: vec![InterfaceFrames {
            interface: "can0".into(),
            baud: None,
            damp: [vec!["800#00".into()], vec![]],
            stop: vec![],
        }],
        ..safe_frames()
    };
    let (_heartbeat, pulse) = beating();
    let refused = Answer::Refused(Refusal::SafeFrames(InterfaceError::Frame { text: "800#00".into() }));
    assert_eq!(register(&instance, too_wide, &pulse).1, refused);
    let daemon = Daemon::start(directory.path());
    daemon.signal(Signal::SIGKILL);
    switch.stops_the_first();
}

/// Goal: after an update of one side, the other mistakes no sign of life for a request, and no
/// missing one for a death.
#[test]
fn daemon_and_switch_versions_refuse_each_other_clearly() {
    let (_directory, instance) = runtime();
    let _switch = Switch::start(&instance);
    for request in ["{\"Register\":null}", "motord-deadman 1\n\"AskWhetherActing\""] {
        let daemon = Channel::connect(&instance, SWITCH_TIMEOUT).unwrap();
        send(daemon.as_fd().as_raw_fd(), request.as_bytes(), MsgFlags::empty()).unwrap();
        let Answer::Refused(refusal) = daemon.receive().unwrap().0 else { panic!("it is served") };
        assert!(refusal.to_string().contains("different versions"), "{refusal}");
    }
}

#[test]
fn answer_of_other_version_is_reported() {
    let (_directory, instance) = runtime();
    let switch = Listener::bind(&instance).unwrap();
    let daemon = Channel::connect(&instance, SWITCH_TIMEOUT).unwrap();
    let other = switch.accept().unwrap();
    send(other.as_fd().as_raw_fd(), b"\"Registered\"", MsgFlags::empty()).unwrap();
    let error = daemon.receive::<Answer>().unwrap_err();
    assert!(error.to_string().contains("different versions"), "{error}");
}

#[test]
fn instance_has_one_switch_that_exits_on_request() {
    let directory = TempDir::new().unwrap();
    let config = configuration(directory.path(), SIMULATED);
    let mut first = motord(directory.path(), &["deadman"], &config).spawn().unwrap();
    let mut log = BufReader::new(first.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert!(log.any(|line| line.contains("ready")));
    let second = motord(directory.path(), &["deadman"], &config).output().unwrap();
    assert_eq!(second.status.code(), Some(75), "{}", text(&second));
    kill(Pid::from_raw(first.id() as i32), Signal::SIGTERM).unwrap();
    assert!(first.wait().unwrap().success());
    let mut next = motord(directory.path(), &["deadman"], &config).spawn().unwrap();
    let mut log = BufReader::new(next.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert!(log.any(|line| line.contains("ready")), "the socket of the one before is no obstacle");
    kill(Pid::from_raw(next.id() as i32), Signal::SIGTERM).unwrap();
    assert!(next.wait().unwrap().success());
}

/// Otherwise each message with several descriptors would leak them, until the switch can accept no
/// connection.
#[test]
fn only_used_descriptors_of_messages_stay_open() {
    let (_directory, instance) = runtime();
    let listener = Listener::bind(&instance).unwrap();
    let sender = Channel::connect(&instance, SWITCH_TIMEOUT).unwrap();
    let receiver = listener.accept().unwrap();
    for count in [1, 2, 3, 253] {
        let (mut mark, file) = std::io::pipe().unwrap();
        let files = vec![file.as_raw_fd(); count];
        let (text, control) = ([IoSlice::new(b"any")], [ControlMessage::ScmRights(&files)]);
        sendmsg::<()>(sender.as_fd().as_raw_fd(), &text, &control, MsgFlags::empty(), None).unwrap();
        drop(file);
        assert!(receiver.receive::<Request>().is_err());
        fcntl(&mark, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).unwrap();
        // The child of another test holds a copy until it executes its program.
        let read = until(&format!("the end of {count} files"), || mark.read(&mut [0]).ok());
        assert_eq!(read, 0, "one of {count} files is still open");
    }
}
