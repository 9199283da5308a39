//! Listens for another sender of commands before the daemon sends its first frame.
//!
//! The lock of a bus holds within a network namespace. Another daemon may command the same motors
//! from another namespace, over `vxcan` or a gateway, or from another computer. It sends a frame to
//! each motor in every cycle.
//!
//! A daemon that died leaves a few frames in the queues, and its dead man's switch damps and stops
//! its motors. The new daemon waits until that is over.

use motord_bus::transport::Hardware;
use motord_bus::{Bus, Clock, Content, Duration, Frame, IdSet, Inbox, Instant, Readiness};
use motord_core::stopper::{BusFrames, REFUSAL_TIMEOUT};
use motord_settings::settings::Settings;

/// Frames are counted by windows of this length.
const WINDOW: Duration = Duration::from_millis(100);
/// The last windows, by which a sender is checked.
const WINDOWS: usize = 3;
/// Fewer frames in these windows are no sender: a daemon with 17 cycles a second sends more.
const FRAMES_MIN: u32 = 5;

/// Another sender commands the motors of a bus.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "bus {bus}: another program or device commands its motors: {frames} frames in {} ms, the last one {frame}. Perhaps another motord in \
     another network namespace or container, or on another computer: stop it first, or take it off the bus",
    WINDOWS as u128 * WINDOW.as_millis()
)]
pub struct OtherSender {
    /// The bus.
    pub bus: String,
    /// The number of frames.
    pub frames: u32,
    /// The last of them, as `candump` writes it.
    pub frame: Frame,
}

/// How the daemon ended to listen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Listened {
    /// The daemon may send.
    Silence,
    /// The daemon was asked to end.
    Interruption,
}

/// The frames of one window.
#[derive(Debug, Clone, Copy, Default)]
struct Counts {
    all: u32,
    /// Those that the dead man's switch does not send.
    commands: u32,
}

/// A CAN bus with motors.
struct Monitor<'a> {
    name: &'a str,
    bus: &'a mut dyn Bus,
    commands: Vec<IdSet>,
    safe: BusFrames,
    /// The daemon starts beside the sender of its commands.
    is_tolerant: bool,
    /// The current window first.
    windows: [Counts; WINDOWS],
    last: Frame,
}

/// Returns when no other sender commands a motor of `settings` on the buses that show other
/// senders, or soon after `is_ended` returns true. Blocks for 0.3 s, or at most 1.1 s longer than
/// damping takes while safe frames arrive. Asks `is_ended` every 0.1 s.
///
/// An excluded motor may have another sender. Without `stop-on-foreign-master` every motor may, and
/// the log names that sender.
///
/// # Errors
///
/// A sender that continues.
pub fn listen(
    settings: &Settings,
    buses: &mut [Box<dyn Bus>],
    clock: &mut dyn Clock,
    is_ended: impl FnMut() -> bool,
) -> Result<Listened, OtherSender> {
    let shows_others =
        |index: usize| settings.buses[index].kind.hardware().is_some_and(Hardware::shows_other_senders);
    let monitors = buses.iter_mut().enumerate().filter(|(index, _)| shows_others(*index));
    let monitors = monitors.map(|(index, bus)| Monitor::new(settings, index, bus.as_mut()));
    await_silence(&mut monitors.collect::<Vec<_>>(), settings, clock, is_ended)
}

fn await_silence(
    monitors: &mut [Monitor<'_>],
    settings: &Settings,
    clock: &mut dyn Clock,
    mut is_ended: impl FnMut() -> bool,
) -> Result<Listened, OtherSender> {
    if monitors.is_empty() {
        return Ok(Listened::Silence);
    }
    let begin = clock.now();
    let end = begin + settings.safety.damp + REFUSAL_TIMEOUT;
    loop {
        listen_for_window(monitors, clock);
        if is_ended() {
            return Ok(Listened::Interruption);
        }
        let now = clock.now();
        let is_over = now >= end;
        let others =
            monitors.iter_mut().filter(|monitor| monitor.is_commanded() || is_over && monitor.is_used());
        for monitor in others {
            monitor.report_sender(settings.safety.stop_on_foreign_master)?;
        }
        let is_used = monitors.iter().any(Monitor::is_used);
        if is_over || now >= begin + WINDOW * WINDOWS as u32 && !is_used {
            return Ok(Listened::Silence);
        }
    }
}

/// Counts the frames of the next window.
fn listen_for_window(monitors: &mut [Monitor<'_>], clock: &mut dyn Clock) {
    let (mut now, end) = (clock.now(), clock.now() + WINDOW);
    monitors.iter_mut().for_each(Monitor::begin_window);
    while now < end {
        let readiness: Vec<Readiness<'_>> = monitors.iter().map(|monitor| monitor.bus.readiness()).collect();
        clock.wait(&readiness, end);
        now = clock.now();
        monitors.iter_mut().for_each(|monitor| monitor.read(now));
    }
}

impl<'a> Monitor<'a> {
    fn new(settings: &'a Settings, index: usize, bus: &'a mut dyn Bus) -> Self {
        let motors = settings.motors.iter().filter(|motor| motor.bus == index && !motor.excluded);
        Self {
            name: &settings.buses[index].name,
            bus,
            commands: motors.map(|motor| motor.addresses().commands).collect(),
            safe: BusFrames::of(settings, index),
            is_tolerant: false,
            windows: [Counts::default(); WINDOWS],
            last: Frame::EMPTY,
        }
    }

    /// Returns the sender as an error. Only reports it, once, unless it `stops` the daemon.
    fn report_sender(&mut self, stops: bool) -> Result<(), OtherSender> {
        let other = self.other_sender();
        if stops {
            return Err(other);
        }
        if !self.is_tolerant {
            tracing::warn!(
                see = "foreign-master",
                "{other}. Starting beside it: stop-on-foreign-master is false"
            );
        }
        self.is_tolerant = true;
        Ok(())
    }

    fn begin_window(&mut self) {
        self.windows.rotate_right(1);
        self.windows[0] = Counts::default();
    }

    /// Counts the commands that have arrived by `now`.
    fn read(&mut self, now: Instant) {
        let mut inbox = Inbox::new();
        self.bus.receive(now, &mut inbox);
        for arrival in inbox.arrivals() {
            let Content::Frame(frame) = arrival.content else { continue };
            if !self.commands.iter().any(|ids| ids.matches(frame.id())) {
                continue;
            }
            self.windows[0].all += 1;
            self.windows[0].commands += u32::from(!self.safe.contains(&frame));
            self.last = frame;
        }
    }

    fn frames(&self) -> u32 {
        self.windows.iter().map(|window| window.all).sum()
    }

    fn commands(&self) -> u32 {
        self.windows.iter().map(|window| window.commands).sum()
    }

    /// Returns whether a sender, perhaps a dead man's switch, sent to its motors in the last
    /// windows. Beside a sender that is tolerated only a switch counts.
    fn is_used(&self) -> bool {
        let tolerated = if self.is_tolerant { self.commands() } else { 0 };
        self.frames() - tolerated >= FRAMES_MIN
    }

    /// Returns whether a sender that is no dead man's switch sent in each of the last windows.
    fn is_commanded(&self) -> bool {
        self.frames() >= FRAMES_MIN && self.windows.iter().all(|window| window.commands > 0)
    }

    fn other_sender(&self) -> OtherSender {
        OtherSender { bus: self.name.to_owned(), frames: self.frames(), frame: self.last }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::FrameId;
    use motord_bus::{Arrival, Refusal, Sent, VirtualClock};
    use motord_configuration::{Machine, parse};
    use std::path::Path;

    const START: Instant = Instant::from_nanos(1_000_000_000);
    /// The code of full stiffness at half a turn: no frame of a switch (MIT document 1.2).
    const COMMAND: [u8; 8] = [0x90, 0, 0x80, 0x0F, 0xFF, 0, 0x08, 0];

    /// A bus on which another node sends frames, each at its time.
    struct Foreign(std::vec::IntoIter<(Instant, Frame)>);

    impl Bus for Foreign {
        fn send(&mut self, _now: Instant, _frames: &[Frame]) -> Sent {
            Sent { accepted: 0, refusal: Some(Refusal::Gone) }
        }

        fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
            while let Some((at, frame)) = self.0.as_slice().first().copied().filter(|(at, _)| *at <= now) {
                if inbox.push(Arrival { at, content: Content::Frame(frame) }).is_err() {
                    return;
                }
                let _sent = self.0.next();
            }
        }

        fn readiness(&self) -> Readiness<'_> {
            self.0.as_slice().first().map_or(Readiness::Never, |(at, _)| Readiness::At(*at))
        }
    }

    fn settings() -> Settings {
        settings_with("")
    }

    /// The settings of one motor, with `keys` before its tables.
    fn settings_with(keys: &str) -> Settings {
        let text = "[[bus]]\nname = 'leg'\ntype = 'socketcan'\ninterface = 'nocan7'\n[[motor]]\nname = 'hip'\nbus = 'leg'\n\
            id = 1\nprotocol = 'mit'\nmodel = 'GIM8108-8'\n[motor.limits]\nposition-rad = [-1, 1]\nvelocity-rad-s = 5\n\
            torque-nm = 5\ntorque-slew-nm-per-s = 50\n";
        let text = format!("{keys}{text}");
        parse(Path::new("robot.toml"), text.as_bytes(), &Machine::here()).expect("it is valid").settings
    }

    /// Frames with the id `id` every `period`, from `begin` after the start.
    fn every(begin: Duration, period: Duration, count: u32, frame: Frame) -> Vec<(Instant, Frame)> {
        (0..count).map(|number| (START + begin + number * period, frame)).collect()
    }

    /// The outcome for a bus with these frames, and the time until then.
    fn outcome_of(frames: Vec<(Instant, Frame)>) -> (Result<Listened, OtherSender>, Duration) {
        outcome_with(&settings(), frames, u32::MAX)
    }

    /// The same with these settings. The daemon is asked to end after this number of windows.
    fn outcome_with(
        settings: &Settings,
        frames: Vec<(Instant, Frame)>,
        mut windows: u32,
    ) -> (Result<Listened, OtherSender>, Duration) {
        let mut clock = VirtualClock::new(START);
        let is_ended = || {
            windows -= 1;
            windows == 0
        };
        let outcome = listen(settings, &mut [Box::new(Foreign(frames.into_iter()))], &mut clock, is_ended);
        (outcome, clock.now().since(START))
    }

    fn command(id: u16, payload: [u8; 8]) -> Frame {
        Frame::classic(FrameId::new(id).expect("it has 11 bits"), payload)
    }

    const MILLI: Duration = Duration::from_millis(1);

    #[test]
    fn second_daemon_is_refused_within_half_second() {
        for period in [MILLI, 20 * MILLI, 50 * MILLI] {
            let (outcome, after) = outcome_of(every(Duration::ZERO, period, 5000, command(1, COMMAND)));
            let error = outcome.expect_err("it commands the hip");
            assert!(error.to_string().contains("another network namespace"), "{error}");
            assert!(after <= 500 * MILLI, "{after:?}");
        }
    }

    #[test]
    fn second_daemon_with_stopped_motors_is_refused() {
        let stop = BusFrames::of(&settings(), 0).stop[0];
        let (outcome, after) = outcome_of(every(Duration::ZERO, MILLI, 10_000, stop));
        assert!(outcome.is_err());
        assert!(after <= 3500 * MILLI, "{after:?}");
    }

    /// Goal: a daemon that died, and its switch, keep no successor away. Method: the frames of its
    /// queue; then its switch damps for 2 s.
    #[test]
    fn dead_daemon_and_its_switch_are_waited_for() {
        let BusFrames { damp, stop } = BusFrames::of(&settings(), 0);
        let queue = every(Duration::ZERO, Duration::from_micros(300), 10, command(1, COMMAND));
        let switch =
            [every(5 * MILLI, 10 * MILLI, 200, damp[0][0]), every(2005 * MILLI, 10 * MILLI, 3, stop[0])];
        let (outcome, after) = outcome_of([queue, switch.concat()].concat());
        assert_eq!(outcome, Ok(Listened::Silence));
        assert!((2000 * MILLI..2500 * MILLI).contains(&after), "{after:?}");
    }

    /// Replies, frames to other motors, and the heartbeat of an ODrive with node 0, every 100 ms.
    #[test]
    fn frames_that_command_no_motor_delay_nothing() {
        for (id, period) in [(0x101, MILLI), (2, MILLI), (1, 100 * MILLI)] {
            let (outcome, after) = outcome_of(every(Duration::ZERO, period, 1000, command(id, [0; 8])));
            assert_eq!((outcome, after), (Ok(Listened::Silence), 300 * MILLI), "{id:#x}");
        }
    }

    /// A person tries an excluded motor with the vendor's tool.
    #[test]
    fn sender_to_excluded_motor_delays_nothing() {
        let mut settings = settings();
        settings.motors[0].excluded = true;
        let frames = every(Duration::ZERO, MILLI, 1000, command(1, COMMAND));
        assert_eq!(outcome_with(&settings, frames, u32::MAX), (Ok(Listened::Silence), 300 * MILLI));
    }

    const TOLERANT: &str = "[safety]\nstop-on-foreign-master = false\n";

    #[test]
    fn setting_lets_daemon_start_beside_sender() {
        let stop = BusFrames::of(&settings(), 0).stop[0];
        for (frame, expected) in [(command(1, COMMAND), 300 * MILLI), (stop, 3000 * MILLI)] {
            let frames = every(Duration::ZERO, MILLI, 10_000, frame);
            let outcome = outcome_with(&settings_with(TOLERANT), frames, u32::MAX);
            assert_eq!(outcome, (Ok(Listened::Silence), expected), "{frame}");
        }
    }

    /// Goal: the setting cuts no damping short. Method: a device chatters while a switch damps for
    /// 2 s.
    #[test]
    fn switch_beside_tolerated_sender_is_waited_for() {
        let damp = BusFrames::of(&settings(), 0).damp[0][0];
        let chatter = every(Duration::ZERO, 10 * MILLI, 1000, command(1, COMMAND));
        let mut frames = [chatter, every(5 * MILLI, 10 * MILLI, 200, damp)].concat();
        frames.sort_by_key(|(at, _)| *at);
        let (outcome, after) = outcome_with(&settings_with(TOLERANT), frames, u32::MAX);
        assert_eq!(outcome, Ok(Listened::Silence));
        assert!((2000 * MILLI..2500 * MILLI).contains(&after), "{after:?}");
    }

    #[test]
    fn daemon_that_listens_can_be_ended() {
        let damp = BusFrames::of(&settings(), 0).damp[0][0];
        for frame in [damp, command(1, COMMAND)] {
            let frames = every(Duration::ZERO, MILLI, 10_000, frame);
            assert_eq!(outcome_with(&settings(), frames, 2), (Ok(Listened::Interruption), 200 * MILLI));
        }
    }
}
