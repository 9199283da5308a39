//! Text that motord reads: possibly damaged files, and answers of another process.

use motord_bus::candump::{self, LogLine};
use motord_bus::frame::{Content, Frame, FrameId};
use motord_bus::{Duration, Instant, Refusal};
use motord_checker::log;
use motord_checker::robot::Wiring;
use motord_client::{Histograms, RobotDescription, Telemetry};
use motord_configuration::lock::{Lock, findings, mismatches};
use motord_configuration::{Machine, parse};
use motord_core::stopper::{BusFrames, Outlet};
use motord_deadman::channel::Request;
use motord_deadman::interfaces::{Interface, Interfaces};
use motord_deadman::safe_frames::InterfaceFrames;
use motord_deadman::switch::Switch;
use motord_settings::plan::BusPlan;
use motord_settings::settings::MotorSettings;
use motord_simulator::{BusSettings, FaultVerb, SimulatedBus};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// Reads a configuration file. Every error names the file. Accepted settings are valid, and every
/// motor in them has a frame that stops it.
pub fn config(bytes: &[u8]) {
    let machine = Machine { processors: vec![0, 1], priority_max: 98 };
    let settings = match parse(Path::new("fuzz.toml"), bytes, &machine) {
        Ok(loaded) => loaded.settings,
        Err(error) => return assert!(error.to_string().contains("fuzz.toml"), "{error}"),
    };
    let _plan = BusPlan::of(&settings);
    for motor in &settings.motors {
        assert!(motor.bus < settings.buses.len(), "{}", motor.name);
        assert!(sane(motor), "{motor:?}");
    }
    let stopped = |bus| BusFrames::of(&settings, bus).stop.len();
    assert_eq!((0..settings.buses.len()).map(stopped).sum::<usize>(), settings.motors.len());
    let mut grouped: Vec<usize> = settings.groups.iter().flat_map(|group| group.motors.clone()).collect();
    grouped.sort_unstable();
    assert!(grouped.into_iter().eq(0..settings.motors.len()), "each motor is in one group");
}

/// Returns `true` when every limit is a number, and no range is empty.
fn sane(motor: &MotorSettings) -> bool {
    let limits = &motor.limits;
    let bounds = [limits.velocity, limits.torque, limits.kp, limits.kd, motor.damping_kd];
    limits.position[0] <= limits.position[1]
        && limits.position.iter().chain(&bounds).all(|value| value.is_finite())
        && bounds.iter().all(|bound| *bound >= 0.0)
}

/// Reads the lock file of a configuration, and compares its motors with their settings.
pub fn lock(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else { return };
    let Ok(lock) = toml::from_str::<Lock>(text) else { return };
    let settings = crate::robot::mixed();
    for finding in mismatches(settings, &lock) {
        assert!(!finding.to_string().is_empty());
    }
    for motor in &settings.motors {
        let _compared = findings(settings, motor, lock.motor(&motor.name));
    }
}

/// Reads logs of candump, and the marks of a rig between them. A frame that was read is printed as
/// it was written, except for the case of its digits, and the ignored flags of CAN FD.
pub fn candump(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else { return };
    for line in text.lines() {
        let Ok(LogLine { content: Content::Frame(frame), .. }) = LogLine::parse(line) else { continue };
        let printed = frame.to_string();
        assert_eq!(candump::frame(&printed), Some(frame), "{line}");
        let (id, payload) =
            printed.split_at_checked(printed.len() - 2 * frame.payload().len()).expect("it is ASCII");
        let line = line.to_ascii_uppercase();
        assert!(line.contains(payload), "{line}: {frame:?}");
        assert!(line.contains(id.trim_end_matches(|last| last != '#')), "{line}: {frame:?}");
    }
    let _marks = log::marks(text);
    let _wiring = Wiring::parse(text);
}

/// Reads the JSON answers of the daemon as the client library does. A client must be able to
/// request any limits in them.
pub fn description(bytes: &[u8]) {
    if let Ok(robot) = serde_json::from_slice::<RobotDescription>(bytes) {
        let _period = robot.period();
        for joint in &robot.joints {
            for position in [f32::NAN, f32::NEG_INFINITY, -1.0, 0.0, 1.0, f32::MAX] {
                let clamped = joint.limits.clamp_position(position);
                let _allowed = (joint.limits.allow(position), joint.limits.allow(clamped));
                assert!(!joint.outside(position).is_empty());
            }
        }
    }
    let _read = (serde_json::from_slice::<Telemetry>(bytes), serde_json::from_slice::<Histograms>(bytes));
}

/// Reads a registration with the dead man's switch, and sends its frames at their times. Of an
/// accepted registration, only frames that it contains are sent, however long its damping lasts.
pub fn registration(bytes: &[u8]) {
    let Ok(Request::Register(frames)) = serde_json::from_slice(bytes) else { return };
    let sent = Arc::new(Mutex::new(Vec::new()));
    let mut open = |_: &str, _| Ok(Box::new(Recorder(Arc::clone(&sent))) as Box<dyn Outlet>);
    // A port would be opened; its frames are still checked.
    let can = frames.buses.iter().map(|bus| InterfaceFrames { baud: None, ..bus.clone() });
    let Ok(opened) = can.map(|bus| Interface::open(&bus, &mut open)).collect::<Result<Vec<_>, _>>() else {
        return;
    };
    let mut now = Instant::from_nanos(1_000_000_000);
    let mut switch = Switch::new(frames.heartbeat_timeout, 1, now);
    switch.step(now, false, 1);
    let mut interfaces = Interfaces::new(opened, frames.damp);
    interfaces.begin(now);
    for _ in 0..ROUNDS_MAX {
        let Some(due) = interfaces.due() else { break };
        now = due.max(now);
        switch.step(now, false, 1);
        interfaces.round(now);
    }
    let named =
        frames.buses.iter().flat_map(|bus| bus.damp.iter().flatten().chain(&bus.stop)).collect::<Vec<_>>();
    let is_named = |frame: &Frame| named.iter().any(|text| candump::frame(text) == Some(*frame));
    let sent = sent.lock().unwrap_or_else(PoisonError::into_inner);
    assert!(sent.iter().all(is_named), "{sent:?}");
}

/// Most rounds of one registration: damping and stopping are two kinds of them.
const ROUNDS_MAX: usize = 64;

/// An interface that accepts every frame.
struct Recorder(Arc<Mutex<Vec<Frame>>>);

impl Outlet for Recorder {
    fn send_round(&mut self, _: Instant, frames: &[Frame]) -> Option<Refusal> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend(frames);
        None
    }

    fn find(&mut self) -> bool {
        true
    }
}

/// Reads the lines of `motorctl sim`, which inject faults into simulated buses. The simulated bus
/// continues after any line.
pub fn sim(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else { return };
    let settings = motord_simulator::MotorSettings::default();
    let mut bus = SimulatedBus::new(BusSettings::default(), vec![settings], 1);
    let mut now = Instant::from_nanos(1_000_000_000);
    for line in text.lines().take(8) {
        let Ok(verb) = line.parse::<FaultVerb>() else { continue };
        let _unknown = bus.inject(now, &verb);
        let stop = Frame::classic(FrameId::from(1), [255, 255, 255, 255, 255, 255, 255, 0xFD]);
        let mut inbox = motord_bus::Inbox::new();
        motord_bus::Bus::send(&mut bus, now, &[stop]);
        now = now + Duration::from_millis(1);
        motord_bus::Bus::receive(&mut bus, now, &mut inbox);
    }
}
