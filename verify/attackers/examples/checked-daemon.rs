//! The whole daemon with simulated buses; each frame on the wire is checked.
//! `verify/rigs/test-malice` runs it.
//!
//! ```text
//! checked-daemon CONFIG GROUP
//! ```
//!
//! A line on standard input names the next action on the robot. The program then prints the figures
//! of the previous action. After `confirmed` no joint of GROUP may receive a motion command until
//! the next line. At the end of the input the daemon shuts down as after a signal. The exit status
//! is 1 when a motor received a forbidden frame.

use motord::buses::{self, Buses};
use motord::host::log::Log;
use motord::run_error::RunError;
use motord::threads::Daemon;
use motord_bus::{Bus, Instant, clock};
use motord_checker::protocol::mit::Meaning;
use motord_configuration as config;
use motord_harness::robot::ranges::ranges;
use motord_ports::instance::Instance;
use motord_realtime::descriptors::raise_descriptors;
use motord_realtime::{SchedulingRequest, granted, prepare_thread};
use motord_settings::settings::{MotorSettings, Settings};
use motord_simulator::{BusSettings, Direction, Recorded, SharedBus, SimulatedBus};
use std::io::BufRead;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::Duration;
use tracing_subscriber::filter::LevelFilter;

/// Frames of a bus that are buffered until the check: two seconds.
const RECORDED: usize = 1 << 14;
/// Period of the checks.
const TURN: Duration = Duration::from_millis(5);
/// Priority below the cycle, which waits for the check of a bus.
const PRIORITY: u8 = 60;
/// Limit on the printed complaints.
const COMPLAINTS_MAX: usize = 20;

fn main() -> ExitCode {
    let [path, group] = [1, 2].map(|index| std::env::args().nth(index).expect("a configuration and a group"));
    let log = Log::to_stderr().expect("a thread for the log");
    log.capture_tracing(LevelFilter::INFO);
    log.capture_panics();
    let ended = run(Path::new(&path), &group);
    if let Err(error) = &ended {
        log.error(&format!("checked-daemon: {error}"));
    }
    log.finish();
    match ended {
        Ok(0) => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(error) => ExitCode::from(error.exit_status()),
    }
}

/// Returns the number of forbidden frames.
fn run(path: &Path, group: &str) -> Result<usize, RunError> {
    let settings = config::load(path)?.settings;
    let _raised = raise_descriptors()?;
    let lock = Arc::new(Instance::find(&settings.instance)?.lock()?);
    let buses: Vec<SharedBus> = (0..settings.buses.len()).map(|bus| recorded(&settings, bus)).collect();
    let boxed = buses.iter().map(|bus| Box::new(bus.clone()) as Box<dyn Bus>).collect();
    let opened = Buses::of(boxed);
    let mut check = FrameCheck::new(settings.clone(), group, buses);
    let daemon = Daemon::start(settings, None, opened, &lock, None)?;
    let realtime = granted(daemon.realtime());
    println!("ready; {realtime}");
    let _refused_like_the_cycle = prepare_thread(SchedulingRequest { cpu: None, priority: Some(PRIORITY) });
    let marks = marks();
    while !daemon.has_ended() {
        match marks.try_recv() {
            Ok(mark) => check.begin(mark),
            Err(TryRecvError::Empty) => {}
            Err(TryRecvError::Disconnected) => daemon.stop(),
        }
        std::thread::sleep(TURN);
        check.check();
    }
    let ended = daemon.end();
    check.check();
    check.begin("the end".into());
    ended.map(|()| check.wrong)
}

fn recorded(settings: &Settings, bus: usize) -> SharedBus {
    let (bus, motors) = buses::physics(settings, bus);
    SharedBus::new(SimulatedBus::new(BusSettings { record: RECORDED, ..bus }, motors, 1))
}

fn marks() -> Receiver<String> {
    let (sender, marks) = channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            let _ended = sender.send(line);
        }
    });
    marks
}

/// Checks the frames to the motors.
struct FrameCheck {
    settings: Settings,
    buses: Vec<SharedBus>,
    /// The motors of the group.
    stopped: Vec<usize>,
    mark: String,
    /// Time after which a frame must not move them.
    still_from: Option<Instant>,
    frames: usize,
    forbidden: usize,
    /// Forbidden frames of all marks.
    wrong: usize,
}

impl FrameCheck {
    fn new(settings: Settings, group: &str, buses: Vec<SharedBus>) -> Self {
        let group = settings.groups.iter().find(|known| known.name == group).expect("a group");
        let (stopped, mark) = (group.motors.clone(), "start".into());
        Self { settings, stopped, buses, mark, still_from: None, frames: 0, forbidden: 0, wrong: 0 }
    }

    fn begin(&mut self, mark: String) {
        println!("{}: {} frames to motors, {} forbidden", self.mark, self.frames, self.forbidden);
        self.still_from = (mark == "confirmed").then(clock::monotonic);
        (self.mark, self.frames, self.forbidden) = (mark, 0, 0);
    }

    fn check(&mut self) {
        for (index, bus) in self.buses.clone().iter().enumerate() {
            let frames: Vec<Recorded> = bus.lock().take_record().collect();
            if frames.len() == RECORDED {
                self.complain("frames were not checked: this program stalled");
            }
            let commands = frames.iter().filter(|frame| frame.direction == Direction::ToMotor);
            commands.for_each(|frame| self.check_frame(index, frame));
        }
    }

    fn check_frame(&mut self, bus: usize, frame: &Recorded) {
        self.frames += 1;
        let id = frame.frame.id();
        let is_it = |motor: &MotorSettings| motor.bus == bus && motor.addresses().commands.matches(id);
        let motor = self.settings.motors.iter().position(is_it);
        let is_late = self.still_from.is_some_and(|from| frame.ready > from);
        let complaint = match (motor, frame.frame.payload().try_into()) {
            (Some(motor), Ok(bytes)) => {
                let is_still = is_late && self.stopped.contains(&motor);
                complaint(&self.settings.motors[motor], bytes, is_still)
            }
            _ => Some("no motor receives it"),
        };
        if let Some(complaint) = complaint {
            self.complain(&format!("{complaint}: bus {bus}, {:?}", frame.frame));
        }
    }

    fn complain(&mut self, complaint: &str) {
        self.forbidden += 1;
        self.wrong += 1;
        if self.wrong <= COMPLAINTS_MAX {
            println!("{}: {complaint}", self.mark);
        }
    }
}

/// Returns the reason why the motor must not receive these bytes.
fn complaint(motor: &MotorSettings, bytes: [u8; 8], is_still: bool) -> Option<&'static str> {
    let ranges = ranges(motor);
    let meaning = Meaning::of(bytes, &ranges);
    match meaning {
        _ if bytes == [0; 8] => Some("all zeros"),
        Meaning::SetZero => Some("a new zero, which no client requested"),
        _ if is_still && !meaning.is_safe() => Some("it moves after the emergency stop"),
        Meaning::Control { position, velocity, kp, kd, torque, .. } => {
            let (limits, codes) = (&motor.limits, ranges.codes());
            let joint = f64::from(motor.transmission.position_to_joint(position as f32));
            let [low, high] = limits.position.map(f64::from);
            let within = |value: f64, most: f32, code: f64| value.abs() <= f64::from(most) + code;
            let holds = (kp == 0.0 || (low - codes.position..=high + codes.position).contains(&joint))
                && within(velocity, limits.velocity, codes.velocity)
                && within(kp, limits.kp, codes.kp)
                && within(kd, limits.kd.max(motor.damping_kd), codes.kd)
                && within(torque, limits.torque, codes.torque);
            (!holds).then_some("beyond the limits")
        }
        _ => None,
    }
}
