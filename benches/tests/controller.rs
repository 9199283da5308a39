//! Goal: the template `client/examples/controller.rs` survives all failures of its daemon and its
//! motors in one process. It never starts a stopped robot by itself.
//!
//! Method: the built example, a daemon in a separate process with simulated motors, and an operator
//! that resets and enables. The test injects the faults.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

use motord::buses::{self, Buses};
use motord::threads::Daemon;
use motord_bus::{Bus, clock};
use motord_client::{Cause, Client, Error, Phase, RUNTIME_DIR_VARIABLE, State};
use motord_configuration::{self as config, Machine};
use motord_harness::daemon::{TIMEOUT, simulated_bus, until};
use motord_ports::instance::Instance;
use motord_simulator::{FaultVerb, SharedBus};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::io::{BufRead, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Tolerates stalls of a shared machine, except those of a second.
const CONFIG: &str = r#"
[daemon]
instance = "robot"
[cycle]
rate-hz = 250
max-lateness-ms = 500.0
max-skipped-percent = 100.0
[safety]
setpoint-timeout-ms = 500.0
lost-cycles = 50
deadman-ms = 2000.0
start-timeout-ms = 5000.0
"#;
const LEG: &str = "[[group]]\nname = 'leg'\njoints = ['hip', 'knee']\n";
const GROUP: &str = "leg";
/// Longer than the retry interval of the example, 0.5 s: a start of the robot by the example would
/// be seen.
const WATCH: Duration = Duration::from_secs(1);

/// A child process that is killed with its test.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _exited = self.0.kill();
        let _status = self.0.wait();
    }
}

impl Process {
    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.0.id().try_into().unwrap()), signal).unwrap();
    }

    /// Checks that the same process is still running.
    fn must_run(&mut self) {
        assert_eq!(self.0.try_wait().unwrap(), None, "it has ended");
    }

    /// Writes a line to its standard input.
    fn send_line(&mut self, line: &str) {
        writeln!(self.0.stdin.as_mut().unwrap(), "{line}").unwrap();
    }
}

/// Runs a daemon that reads faults from standard input; an empty line ends it like SIGTERM.
#[test]
#[ignore = "the process that the other tests disturb"]
fn daemon_process() {
    let Some(runtime) = std::env::var_os(RUNTIME_DIR_VARIABLE) else { return };
    let text = CONFIG.to_owned() + &simulated_bus(&["hip", "knee"]) + LEG;
    let settings =
        config::parse(Path::new("robot.toml"), text.as_bytes(), &Machine::here()).unwrap().settings;
    let bus = SharedBus::new(buses::simulate(&settings, 0, 1));
    let lock = Arc::new(Instance::below(Path::new(&runtime), "robot").unwrap().lock().unwrap());
    let opened: Vec<Box<dyn Bus>> = vec![Box::new(bus.clone())];
    let daemon = Daemon::start(settings, None, Buses::of(opened), &lock, None).unwrap();
    for line in std::io::stdin().lock().lines().map_while(Result::ok).take_while(|line| !line.is_empty()) {
        bus.lock().inject(clock::monotonic(), &line.parse::<FaultVerb>().unwrap()).unwrap();
    }
    daemon.end().unwrap();
}

fn daemon(runtime: &TempDir) -> Process {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--ignored", "--exact", "daemon_process"]).env(RUNTIME_DIR_VARIABLE, runtime.path());
    Process(command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
}

fn controller(runtime: &TempDir) -> Process {
    let here = std::env::current_exe().unwrap();
    let program = here.parent().unwrap().with_file_name("examples").join("controller");
    assert!(program.is_file(), "{} is missing: cargo build -p motord-client --examples", program.display());
    let mut command = Command::new(program);
    command.args(["--instance", "robot", "--group", GROUP]).env(RUNTIME_DIR_VARIABLE, runtime.path());
    Process(command.spawn().unwrap())
}

fn connect(runtime: &TempDir) -> Client {
    until("a connection", || Client::connect_in(runtime.path(), "robot").ok())
}

fn state(client: &Client) -> State {
    until("a state", || client.wait(Duration::from_secs(1)).ok())
}

/// Waits until every joint follows the controller's law: stiff, with an oscillating setpoint.
fn await_motion(client: &Client) {
    let mut seen = [[f32::INFINITY, f32::NEG_INFINITY]; 2];
    until("motion", || {
        let state = state(client);
        for (seen, joint) in seen.iter_mut().zip(state.joints()) {
            let stiff = state.group(0)?.phase == Some(Phase::Active) && joint.applied.kp > 39.0;
            let position = joint.applied.position;
            *seen = if stiff { [seen[0].min(position), seen[1].max(position)] } else { *seen };
        }
        seen.iter().all(|[low, high]| high - low > 0.1).then_some(())
    });
}

/// Waits until the group is stopped for `cause`, and checks that it stays stopped.
fn await_stop(client: &Client, cause: Option<Cause>) {
    until("the stop", || {
        let group = state(client).group(0)?;
        (group.phase == Some(Phase::Disarmed) && group.cause == cause).then_some(())
    });
    let begun = Instant::now();
    while begun.elapsed() < WATCH {
        assert_eq!(state(client).group(0).unwrap().phase, Some(Phase::Disarmed), "it was started again");
    }
}

/// Starts the group as an operator, once the controller owns it.
fn start_again(client: &Client) {
    until("the start", || {
        let _nothing_latched = client.reset(GROUP);
        client.enable(GROUP).ok()?;
        client.wait_for(GROUP, Phase::Active, TIMEOUT).ok()
    });
    await_motion(client);
}

/// Waits for a stop with any of several causes: which one is first depends on the machine when the
/// whole process stalls.
fn await_any_stop(client: &Client) {
    let cause = until("the stop", || {
        let group = client.wait(Duration::from_secs(1)).ok()?.group(0)?;
        group.cause.filter(|_| group.phase == Some(Phase::Disarmed))
    });
    assert!(matches!(cause, Cause::TimeBase | Cause::SetpointTimeout), "{cause}");
    await_stop(client, Some(cause));
}

/// A controller that moves a robot.
struct Scene {
    runtime: TempDir,
    controller: Process,
    daemon: Process,
    client: Client,
}

impl Scene {
    fn new() -> Self {
        let runtime = TempDir::new().unwrap();
        let controller = controller(&runtime);
        let daemon = daemon(&runtime);
        let client = connect(&runtime);
        await_motion(&client);
        Self { runtime, controller, daemon, client }
    }

    /// Starts the next daemon. No cause is latched, and no joint moves.
    fn start_next_daemon(&mut self) {
        self.daemon = daemon(&self.runtime);
        let is_restarted = || matches!(self.client.wait(Duration::from_secs(1)), Err(Error::Restarted));
        until("the restart", || is_restarted().then_some(()));
        await_stop(&self.client, None);
        start_again(&self.client);
    }

    /// The same controller has survived, and stops the motors when a signal ends it.
    fn end(mut self) {
        self.controller.must_run();
        self.controller.signal(Signal::SIGTERM);
        assert!(self.controller.0.wait().unwrap().success(), "a signal ends it");
        let end = state(&self.client).group(0).unwrap();
        let stopped = (Some(Phase::Disarmed), None);
        assert_eq!((end.phase, end.cause), stopped, "it has stopped the motors, and nothing is wrong");
    }
}

#[test]
fn template_controller_survives_stops_by_people() {
    let scene = Scene::new();
    let client = &scene.client;
    client.emergency_stop().unwrap();
    await_stop(client, Some(Cause::EmergencyStop));
    start_again(client);
    client.disable(GROUP).unwrap();
    await_stop(client, Some(Cause::Disabled));
    start_again(client);
    client.force_release(GROUP).unwrap();
    await_stop(client, Some(Cause::OwnerLost));
    start_again(client);
    scene.end();
}

#[test]
fn template_controller_survives_stops_by_motors() {
    let mut scene = Scene::new();
    scene.daemon.send_line("hip fault 0x02");
    await_stop(&scene.client, Some(Cause::MotorFault));
    scene.daemon.send_line("hip ok");
    until("the end of the fault", || scene.client.clear_fault("hip").ok());
    start_again(&scene.client);
    scene.daemon.send_line("knee off");
    await_stop(&scene.client, Some(Cause::MotorLost));
    scene.daemon.send_line("knee ok");
    start_again(&scene.client);
    scene.end();
}

#[test]
fn template_controller_survives_daemon_that_stands_still() {
    let scene = Scene::new();
    scene.daemon.signal(Signal::SIGSTOP);
    std::thread::sleep(Duration::from_secs(2));
    scene.daemon.signal(Signal::SIGCONT);
    await_any_stop(&scene.client);
    start_again(&scene.client);
    scene.end();
}

#[test]
fn template_controller_survives_daemons_that_end_or_die() {
    let mut scene = Scene::new();
    scene.daemon.send_line("");
    assert!(scene.daemon.0.wait().unwrap().success(), "the daemon ends by itself");
    scene.start_next_daemon();
    scene.daemon.0.kill().unwrap();
    scene.daemon.0.wait().unwrap();
    scene.start_next_daemon();
    scene.end();
}

#[test]
fn template_controller_has_about_a_hundred_lines() {
    let text = include_str!("../../client/examples/controller.rs");
    assert!(text.lines().count() < 110, "{}", text.lines().count());
}
