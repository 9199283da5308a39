//! Replays a recorded run into the cycle.
//!
//! Method: a log of `candump -L` holds both directions. On virtual time, cycles, arrivals and the
//! client's enable occur at their recorded times. The frames that the cycle sends must equal the
//! recorded ones, byte by byte. `verify/rigs/record-log` records the log. Its velocity codes are
//! computed: the run is older than the rule that carries their rounding error.

#![expect(clippy::unwrap_used, reason = "a test may panic")]
#![expect(clippy::disallowed_types, reason = "the test reads what its bus recorded")]

use motord_bus::candump::{InvalidLine, LogLine};
use motord_bus::time::nanos;
use motord_bus::{Arrival, Bus, Content, Duration, Frame, Inbox, Instant, Readiness, Sent};
use motord_harness::robot;
use motord_harness::robot::Robot;
use motord_harness::robot::random::Random;
use motord_settings::settings::Settings;
use motord_shared::{AdminRequest, JointSetpoint, Operation};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

const ROBOT: &str = include_str!("logs/two-legs.toml");
const LOG: &str = include_str!("logs/two-legs.log");
/// Stiffness and damping that the client of the log requested: those of the client's example
/// `hold`.
const GAINS: (f32, f32) = (20.0, 0.5);
/// Time from a tick of the daemon to the first frame of its cycle, when that was not late.
const LEAD: Duration = Duration::from_micros(300);

/// A frame, and its time on the bus.
type Stamped<T> = (Instant, T);

/// The traffic of one bus in a log.
#[derive(Debug, Clone, Default)]
struct Track {
    commands: Vec<Stamped<Frame>>,
    arrivals: VecDeque<Arrival>,
}

/// A bus on which all arrivals occur as recorded, whatever is sent.
struct RecordedBus {
    arrivals: VecDeque<Arrival>,
    sent: Arc<Mutex<Vec<Frame>>>,
}

impl Bus for RecordedBus {
    fn send(&mut self, _now: Instant, frames: &[Frame]) -> Sent {
        self.sent.lock().unwrap().extend(frames);
        Sent::all(frames.len())
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        while inbox.free() > 0 && self.arrivals.front().is_some_and(|next| next.at <= now) {
            inbox.push(self.arrivals.pop_front().unwrap()).unwrap();
        }
    }

    fn readiness(&self) -> Readiness<'_> {
        self.arrivals.front().map_or(Readiness::Never, |next| Readiness::At(next.at))
    }
}

/// Parses a log. Returns the number of the first bad line, counted from 1, as an error.
fn read(log: &str) -> Result<Vec<LogLine<'_>>, (usize, InvalidLine)> {
    let lines = log.lines().enumerate();
    lines.map(|(index, line)| LogLine::parse(line).map_err(|wrong| (index + 1, wrong))).collect()
}

/// Separates commands from arrivals, by bus.
fn tracks(settings: &Settings, log: &[LogLine<'_>]) -> Vec<Track> {
    let mut tracks = vec![Track::default(); settings.buses.len()];
    for line in log {
        let mut buses = settings.buses.iter();
        let Some(bus) = buses.position(|bus| bus.interface() == Some(line.interface)) else { continue };
        let goes_to_motor = |frame: &Frame| {
            let mut motors = settings.motors.iter().filter(|motor| motor.bus == bus);
            motors.any(|motor| motor.addresses().commands.matches(frame.id()))
        };
        let at = Instant::from_nanos(nanos(line.at));
        match line.content {
            Content::Frame(frame) if goes_to_motor(&frame) => tracks[bus].commands.push((at, frame)),
            content => tracks[bus].arrivals.push_back(Arrival { at, content }),
        }
    }
    for track in &mut tracks {
        track.commands.sort_by_key(|command| command.0);
        track.arrivals.make_contiguous().sort_by_key(|arrival| arrival.at);
    }
    tracks
}

/// Returns `true` when the motor stays without torque (MIT document 1.1: stop, get and clear
/// fault).
fn leaves_alone(frame: &Frame) -> bool {
    frame.payload().starts_with(&[0xFF; 6]) && frame.payload().last() != Some(&0xFC)
}

/// Runs the cycle on the replies of `log`, and returns the frames sent on each bus.
fn replay(settings: &Settings, log: &[LogLine<'_>]) -> Vec<Vec<Frame>> {
    let tracks = tracks(settings, log);
    let mut commands: Vec<_> = tracks.iter().flat_map(|track| track.commands.iter().copied()).collect();
    commands.sort_by_key(|command| command.0);
    let begun = commands.first().map_or(Instant::ZERO, |command| command.0);
    let enabled = commands.iter().find(|command| !leaves_alone(&command.1)).map(|command| command.0);

    let sent: Vec<Arc<Mutex<Vec<Frame>>>> = tracks.iter().map(|_| Arc::default()).collect();
    let buses = tracks.iter().zip(&sent).map(|(track, sent)| {
        Box::new(RecordedBus { arrivals: track.arrivals.clone(), sent: Arc::clone(sent) }) as Box<dyn Bus>
    });
    let mut robot = Robot::on(buses.collect(), begun - LEAD, settings.clone());
    let mut client = Client::default();
    Client::ask(&mut robot, Operation::Claim);
    // The first command after a tick determines the begin of its cycle.
    while let Some(&(woke, _)) = commands.get(commands.partition_point(|command| command.0 < robot.next())) {
        robot.oversleep(woke.since(robot.next()));
        client.act(&mut robot, enabled.is_some_and(|enabled| enabled <= woke));
        robot.step();
        Client::receive_replies(&mut robot);
    }
    sent.iter().map(|sent| std::mem::take(&mut *sent.lock().unwrap())).collect()
}

/// The client of the log, which holds every joint at its position.
#[derive(Default)]
struct Client {
    setpoints: Vec<JointSetpoint>,
    has_enabled: bool,
}

impl Client {
    fn ask(robot: &mut Robot, operation: Operation) {
        robot.post(AdminRequest { operation: operation.code(), group: 0, ..Default::default() });
    }

    fn act(&mut self, robot: &mut Robot, enables: bool) {
        if !self.has_enabled {
            self.setpoints = robot.hold(GAINS.0, GAINS.1);
        }
        if enables && !self.has_enabled {
            Self::ask(robot, Operation::Enable);
            self.has_enabled = true;
        }
        robot.send(&self.setpoints);
    }

    fn receive_replies(robot: &mut Robot) {
        while robot.take_answer().is_some() {}
    }
}

#[test]
fn recorded_run_is_sent_again_identically() {
    let settings = robot::settings(ROBOT);
    let log = read(LOG).unwrap();
    let sent = replay(&settings, &log);
    for (bus, (sent, track)) in sent.iter().zip(tracks(&settings, &log)).enumerate() {
        assert!(track.commands.len() > 100, "the log shows bus {bus}");
        let differs = sent.iter().zip(&track.commands).position(|(sent, command)| *sent != command.1);
        if let Some(index) = differs {
            panic!(
                "bus {bus}, command {index}: sent {:?}, recorded {:?}",
                sent[index], track.commands[index]
            );
        }
        assert_eq!(sent.len(), track.commands.len(), "bus {bus}");
    }
}

#[test]
fn replay_is_deterministic_whatever_was_done() {
    let settings = robot::settings(ROBOT);
    let whole = read(LOG).unwrap();
    robot::for_each_seed("robot replay", 200, |seed| {
        let mut random = Random::new(seed);
        let mut log = whole.clone();
        (0..=random.below(40)).for_each(|_| mutate(&mut log, &mut random));
        let sent = replay(&settings, &log);
        assert_eq!(sent, replay(&settings, &log));
        for frames in &sent {
            assert!(frames.iter().all(is_allowed), "no zero was requested, and zeros are not a command");
        }
    });
}

fn is_allowed(frame: &Frame) -> bool {
    let payload = frame.payload();
    payload != [0; 8] && payload != [255, 255, 255, 255, 255, 255, 255, 0xFE]
}

/// Simulates a bad recording or a bad wire.
fn mutate(log: &mut Vec<LogLine<'_>>, random: &mut Random) {
    let (one, other) = (random.below(log.len()), random.below(log.len()));
    match random.below(6) {
        0 => drop(log.remove(one)),
        1 => log.swap(one, other),
        2 => (log[one].at, log[other].at) = (log[other].at, log[one].at),
        3 => log.insert(other, log[one]),
        4 => log.truncate(log.len() - one / 8),
        _ => corrupt(&mut log[one].content, random),
    }
}

/// Changes one bit in a frame that is still delivered.
fn corrupt(content: &mut Content, random: &mut Random) {
    if let Content::Frame(frame) = content {
        let mut payload = frame.payload().to_vec();
        let index = random.below(payload.len());
        payload[index] ^= 1 << random.below(8);
        *frame = Frame::new(frame.id(), &payload).unwrap();
    }
}

#[test]
fn garbage_line_is_refused_by_number() {
    let lines: Vec<_> = LOG.lines().collect();
    for (garbage, wrong) in [
        ("", InvalidLine::Shape),
        ("interface = vcan0, family = 29", InvalidLine::Time),
        ("(1795264038.344596) vcan0 001#FFFFFFFFFFFFFFF", InvalidLine::Data),
        ("(1795264038.344596) vcan0 0x1#FFFFFFFFFFFFFFFD", InvalidLine::Id),
        ("\u{0}\u{FFFD}", InvalidLine::Time),
    ] {
        let corrupted = [&lines[..41], &[garbage], &lines[41..]].concat().join("\n");
        assert_eq!(read(&corrupted), Err((42, wrong)), "{garbage}");
    }
    let cut = LOG.len() - 2;
    assert_eq!(read(&LOG[..cut]), Err((lines.len(), InvalidLine::Data)), "a log that was cut off");
}
