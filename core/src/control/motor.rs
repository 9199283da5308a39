//! One motor, as far as it can be known: its drive tells position, speed and torque, and its faults only when asked.
//!
//! ```text
//!              state told                 group starts                  neutral heard, start told
//!   Offline ───────────────▶ Idle ───────────────────────▶ Starting ───────────────────────────▶ Active
//!      ▲                    ▲    ▲                             │                                    │
//!      │ silent for         │    │ at rest, or long enough     │ group stops                        │ group stops
//!      │ `lost_cycles`      │    └──────────── Damping ◀───────┴────────────────────────────────────┘
//!   (any mode)              │
//!                           └── fault cleared on request ── Fault ◀── fault told (any mode)
//! ```

use super::Command;
use super::errand::{Errand, Kind};
use super::heat::Heat;
use super::plausibility::{Expectation, Plausibility, Verdict};
use crate::joint::{Impedance, Joint, Measured};
use crate::settings::MotorSettings;
use motord_bus::{Duration, Instant};
use motord_protocol::FaultBits;
use motord_shared::{Applied, JointState, MotorMode, SetpointMode, message};

/// Neutral commands that a motor hears before it is started.
const NEUTRAL_CYCLES: u32 = 10;
/// A motor that is offline is asked this often whether it is back.
const PROBE_PERIOD: Duration = Duration::from_millis(100);
/// One of so many such questions is for its faults: in fault it may answer nothing else.
const PROBES_PER_FAULT: u32 = 5;
/// A motor that has been silent for this many cycles is asked for its faults instead.
const SILENT_CYCLES: u32 = 5;

/// Where a motor is between `Idle` and `Active`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Start {
    /// So many neutral commands were sent.
    Neutral(u32),
    /// The start command is sent until it is answered.
    Told,
    /// It answered the start command.
    Heard,
    /// It answered a neutral command after that.
    Ready,
}

/// What one motor is doing.
#[derive(Debug)]
pub(super) struct Motor {
    mode: MotorMode,
    start: Start,
    measured: Option<Measured<Joint>>,
    measured_at: Instant,
    /// What was applied in this cycle; the slew limits start from it in the next.
    pub(super) applied: Impedance<Joint>,
    /// How `applied` is meant.
    pub(super) applied_mode: SetpointMode,
    /// `Limit` bits of `applied`.
    pub(super) limits: u32,
    /// Where it was, and with which gains, when a holding stop began.
    pub(super) held: Option<Impedance<Joint>>,
    /// What an operator wants of it while it is stopped.
    pub(super) errand: Option<Errand>,
    /// Of its winding.
    pub(super) heat: Heat,
    fault: FaultBits,
    asked: bool,
    answered: bool,
    refused: bool,
    /// It was told to stop in this cycle.
    told_to_stop: bool,
    /// Its state confirms what it was told. Natively a state answers a question.
    state_confirms: bool,
    /// It was started, and has not answered a stop since.
    may_run: bool,
    silent: u32,
    age_cycles: u32,
    missed: u32,
    late: u32,
    reply_latency_ns: u32,
    probe_at: Instant,
    probes: u32,
    last_missed: u64,
    poll_at: Instant,
    plausibility: Plausibility,
}

impl Motor {
    pub(super) fn new(settings: &MotorSettings) -> Self {
        Self {
            mode: MotorMode::Offline,
            start: Start::Neutral(0),
            measured: None,
            measured_at: Instant::ZERO,
            applied: Impedance::NEUTRAL,
            applied_mode: SetpointMode::Impedance,
            limits: 0,
            held: None,
            errand: None,
            heat: Heat::of(settings),
            fault: FaultBits(0),
            asked: false,
            answered: false,
            refused: false,
            told_to_stop: false,
            state_confirms: settings.capabilities.state_confirms_stop,
            may_run: false,
            silent: 0,
            age_cycles: 0,
            missed: 0,
            late: 0,
            reply_latency_ns: 0,
            probe_at: Instant::ZERO,
            probes: 0,
            last_missed: 0,
            poll_at: Instant::ZERO,
            plausibility: Plausibility::default(),
        }
    }

    pub(super) const fn mode(&self) -> MotorMode {
        self.mode
    }

    pub(super) const fn measured(&self) -> Option<&Measured<Joint>> {
        self.measured.as_ref()
    }

    pub(super) const fn missed(&self) -> u32 {
        self.missed
    }

    /// Cycles since its last state; 0 when that came in the last one.
    pub(super) const fn age_cycles(&self) -> u32 {
        self.age_cycles
    }

    /// 0 when it did not answer in this cycle.
    pub(super) const fn reply_latency_ns(&self) -> u32 {
        if self.answered { self.reply_latency_ns } else { 0 }
    }

    /// Its state was received in the cycle before this one, or in this one.
    pub(super) const fn is_fresh(&self) -> bool {
        self.measured.is_some() && self.age_cycles <= 1
    }

    /// It is known to turn slower than `rest_velocity`, rad/s.
    pub(super) fn is_at_rest(&self, rest_velocity: f32) -> bool {
        self.is_fresh() && self.measured.is_some_and(|told| told.velocity.abs() < rest_velocity)
    }

    /// It was started, and nothing says that it has stopped since. A motor in fault stopped by itself.
    pub(super) const fn may_run(&self) -> bool {
        self.may_run && !matches!(self.mode, MotorMode::Fault)
    }

    /// It answered after it was told to start.
    pub(super) fn is_ready(&self) -> bool {
        self.mode == MotorMode::Starting && self.start == Start::Ready
    }

    pub(super) fn begin_start(&mut self) {
        self.mode = MotorMode::Starting;
        self.start = Start::Neutral(0);
        self.may_run = true;
    }

    /// From now on it follows setpoints; the slew limits start from where it stands.
    pub(super) fn activate(&mut self) {
        self.mode = MotorMode::Active;
        let position = self.measured.map_or(0.0, |measured| measured.position);
        self.applied = Impedance::new(position, 0.0, 0.0, 0.0, 0.0);
    }

    /// What is applied pulls it to a position.
    pub(super) fn is_pulled(&self) -> bool {
        self.applied.kp > 0.0 || self.applied_mode == SetpointMode::Position
    }

    /// Leaves setpoints behind. `true` when it was moving under control.
    pub(super) fn begin_damping(&mut self) {
        if matches!(self.mode, MotorMode::Starting | MotorMode::Active) {
            self.mode = MotorMode::Damping;
            let Impedance { kp, kd, .. } = self.applied;
            let here = self.measured.filter(|_| self.is_fresh());
            self.held = here.map(|measured| Impedance::new(measured.position, 0.0, kp, kd, 0.0));
        }
    }

    /// From now on it hears only stop commands.
    pub(super) fn rest(&mut self) {
        if matches!(self.mode, MotorMode::Starting | MotorMode::Active | MotorMode::Damping) {
            self.mode = MotorMode::Idle;
        }
    }

    /// Its winding gave torque for `elapsed`: what it told just now, or what it was asked for when that is more. A motor that
    /// does not tell the truth is not trusted with more heat for it.
    pub(super) fn warm(&mut self, elapsed: Duration) {
        let told = if self.is_fresh() { self.measured.map_or(0.0, |told| told.torque.abs()) } else { 0.0 };
        let asked =
            self.measured.map_or(0.0, |told| self.applied.predicted_torque(told.position, told.velocity));
        self.heat.warm(told.max(asked.abs()), elapsed);
    }

    /// The command of this cycle for every mode but `Active` and `Damping`, which depend on the group.
    pub(super) fn command(&mut self, now: Instant) -> Command {
        match self.mode {
            MotorMode::Offline => self.probe(now),
            MotorMode::Starting => self.start_command(),
            MotorMode::Fault => self.fault_command(),
            _ => Command::Stop,
        }
    }

    /// A motor that says nothing may be one that faulted and refuses to answer anything but a question for its fault
    /// (GIM document 3.2.16): every so often that question takes the place of the command.
    pub(super) fn doubts(&mut self) -> bool {
        let silent = self.silent > 0 && self.silent.is_multiple_of(SILENT_CYCLES);
        core::mem::take(&mut self.refused) || silent && self.mode != MotorMode::Offline
    }

    fn probe(&mut self, now: Instant) -> Command {
        if now < self.probe_at {
            return Command::Nothing;
        }
        self.probe_at = now + PROBE_PERIOD;
        self.probes = (self.probes + 1) % PROBES_PER_FAULT;
        if self.probes == 0 { Command::GetFault } else { Command::Stop }
    }

    /// A faulted motor stopped by itself, and may refuse to answer anything but a question for its fault.
    const fn fault_command(&mut self) -> Command {
        self.probes = (self.probes + 1) % 2;
        if self.probes == 0 { Command::GetFault } else { Command::Stop }
    }

    fn start_command(&mut self) -> Command {
        match self.start {
            Start::Neutral(NEUTRAL_CYCLES) | Start::Told => {
                self.start = Start::Told;
                Command::Start
            }
            Start::Neutral(sent) => {
                self.start = Start::Neutral(sent + 1);
                Command::Neutral
            }
            Start::Heard | Start::Ready => Command::Neutral,
        }
    }

    /// A question was sent whose answer is a state.
    pub(super) const fn asked(&mut self, command: &Command) {
        self.asked = command.is_answered_by_state();
        self.answered = false;
        self.told_to_stop = matches!(command, Command::Stop);
    }

    /// Whether what it tells can be true.
    pub(super) fn judge(&mut self, told: Measured<Joint>, at: Instant, settings: &MotorSettings) -> Verdict {
        // Its zero is being moved: a step is what was asked for.
        let zeroing = self.errand.is_some_and(|errand| errand.kind == Kind::SetZero);
        let before = self.measured.as_ref().filter(|_| !zeroing).map(|measured| (measured, self.measured_at));
        let active = self.mode == MotorMode::Active;
        let pulled_to = self.is_pulled().then_some(self.applied.position);
        let expected = Expectation { settings, before, pulled_to, active };
        self.plausibility.judge(told, at, &expected)
    }

    /// It answered one question twice. Tells whether two motors share its id.
    pub(super) fn told_twice(&mut self) -> bool {
        self.plausibility.duplicate()
    }

    /// Two motors answer to its id.
    pub(super) const fn is_doubled(&self) -> bool {
        self.plausibility.is_doubled()
    }

    /// It has never answered since the daemon started.
    pub(super) fn was_never_heard(&self) -> bool {
        self.measured_at == Instant::ZERO
    }

    /// Its state came, `latency` after the command. Tells whether it came online by that.
    pub(super) fn told_state(&mut self, measured: Measured<Joint>, at: Instant, latency: Duration) -> bool {
        self.measured = Some(measured);
        self.measured_at = at;
        self.reply_latency_ns = u32::try_from(latency.as_nanos()).unwrap_or(u32::MAX);
        self.answered = true;
        self.may_run &= !(self.told_to_stop && self.state_confirms);
        self.silent = 0;
        self.age_cycles = 0;
        let online = self.mode == MotorMode::Offline;
        if online {
            self.mode = if self.fault.is_none() { MotorMode::Idle } else { MotorMode::Fault };
        }
        if self.mode == MotorMode::Starting {
            self.start = match self.start {
                Start::Told => Start::Heard,
                Start::Heard => Start::Ready,
                start => start,
            };
        }
        online
    }

    /// It answered, but not with a state.
    pub(super) fn told_alive(&mut self) {
        self.asked = false;
        self.silent = 0;
        if self.mode == MotorMode::Starting && self.start == Start::Told {
            self.start = Start::Heard;
        }
    }

    /// It confirmed a stop.
    pub(super) fn told_stopped(&mut self) {
        self.told_alive();
        self.may_run = false;
    }

    /// It answered, but does not do as it is told: it is asked for its fault in the next cycle.
    pub(super) const fn told_refusal(&mut self) {
        self.asked = false;
        self.silent = 0;
        self.refused = true;
    }

    /// The bus did not take the command that its errand is about.
    pub(super) const fn resume_errand(&mut self) {
        if let Some(errand) = &mut self.errand {
            errand.sent = false;
        }
    }

    /// Its fault bits came. Tells whether they are news.
    pub(super) fn told_fault(&mut self, fault: FaultBits, now: Instant, period: Duration) -> bool {
        self.poll_at = now + period;
        let news = fault != self.fault && !(fault.is_none() && self.mode == MotorMode::Fault);
        if news {
            self.fault = fault;
        }
        if !fault.is_none() {
            self.mode = MotorMode::Fault;
        }
        if self.mode == MotorMode::Fault {
            self.silent = 0;
        }
        news
    }

    /// Its fault was cleared on request, and it says so.
    pub(super) const fn cleared(&mut self) {
        self.fault = FaultBits(0);
        if matches!(self.mode, MotorMode::Fault) {
            self.mode = MotorMode::Idle;
        }
    }

    pub(super) const fn told_late(&mut self) {
        self.late = self.late.wrapping_add(1);
    }

    /// The cycle is over. Tells whether the motor is lost by its silence.
    pub(super) fn end_cycle(&mut self, cycle: u64, lost_cycles: u32) -> bool {
        self.plausibility.end_cycle();
        if self.answered {
            return false;
        }
        self.age_cycles = self.age_cycles.saturating_add(1);
        if self.is_blind(lost_cycles) {
            self.lose();
            return true;
        }
        if self.mode == MotorMode::Offline || self.errand.is_some() || !self.asked && self.silent == 0 {
            return false;
        }
        self.silent += 1;
        self.last_missed = cycle;
        if self.asked {
            self.missed = self.missed.wrapping_add(1);
        }
        let lost = self.silent >= lost_cycles;
        if lost {
            self.lose();
        }
        lost
    }

    /// It answers, but has told no state for too long while it is meant to move: it refuses what it is told.
    fn is_blind(&self, lost_cycles: u32) -> bool {
        let moving = matches!(self.mode, MotorMode::Starting | MotorMode::Active | MotorMode::Damping);
        moving && self.age_cycles >= lost_cycles
    }

    fn lose(&mut self) {
        self.mode = MotorMode::Offline;
        self.measured = None;
        self.silent = 0;
        // The first probe, in the next cycle, is a stop: it may hear and only not be heard.
        self.probes = 0;
        self.probe_at = Instant::ZERO;
    }

    /// When it should be asked for its faults next, if it may be asked now: its state has arrived, and nothing that
    /// it answered late can be mistaken for the answer.
    pub(super) fn poll_at(&self, cycle: u64) -> Option<Instant> {
        const QUIET_CYCLES: u64 = 10;
        let settled = self.last_missed == 0 || cycle > self.last_missed + QUIET_CYCLES;
        (self.answered && settled).then_some(self.poll_at)
    }

    pub(super) fn report(&self) -> JointState {
        let measured = self.measured.unwrap_or(Measured::new(f32::NAN, f32::NAN, f32::NAN, None));
        let fresh = if self.answered { message::JOINT_FRESH } else { 0 };
        let valid = if self.measured.is_some() { message::JOINT_VALID } else { 0 };
        let Impedance { position, velocity, kp, kd, torque, .. } = self.applied;
        JointState {
            position: measured.position,
            velocity: measured.velocity,
            torque: measured.torque,
            temperature: measured.temperature.unwrap_or(f32::NAN),
            applied: Applied { position, velocity, kp, kd, torque },
            limits: self.limits,
            mode: self.mode.code(),
            fault: u32::from(self.fault.0),
            flags: fresh | valid,
            age_cycles: self.age_cycles,
            missed: self.missed,
            reply_latency_ns: self.reply_latency_ns,
            late: self.late,
            receive_ns: self.measured_at.as_nanos(),
        }
    }
}
