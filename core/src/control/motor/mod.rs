//! One motor, as its drive reports it: position, speed, torque, and faults with every state or on
//! request. The module [`mode`] has the diagram of its modes.

mod absence;
mod ambiguous;
mod backlog;
mod faults;
mod follow;
mod foreign;
mod group_command;
mod heat;
mod held;
mod late;
mod limit;
mod mode;
mod plausibility;
mod reading;
mod registers;
mod replies;
mod report;
mod requests;
mod response;
mod service;
mod supply;
mod turn;
mod unanswered;

pub use foreign::ForeignFrames;
pub(super) use group_command::GroupCommand;
pub use limit::{Applied, Circumstances, damp, limit};
pub(super) use service::Kind;
use turn::Access;
pub(super) use turn::Turn;

use super::Event;
use super::context::Context;
use absence::Absence;
use backlog::Backlog;
use faults::FaultWatch;
use foreign::Foreign;
use heat::Heat;
use mode::{Mode, Start};
use motord_bus::{Duration, FrameId, Instant};
use motord_protocol::Faults;
use motord_protocol::drive::{Command, Impedance, JointSide, Measured, Setpoint, Supply};
use motord_settings::settings::{BeyondRange, MotorSettings};
use motord_shared::{Cause, MotorMode};
use plausibility::{Credibility, Expectation, Plausibility};
use registers::Registers;
use replies::Replies;
use response::Response;
use service::ServiceRequest;

/// Safe frames of another sender that arrive for this long are those of another master. The dead
/// man's switch ends within some milliseconds after the heartbeat of the daemon moves.
const SAFE_MAX: Duration = Duration::from_millis(200);
/// The switch of a dead daemon stops its motors within this time after the damping.
const SWITCH_ENDS: Duration = Duration::from_secs(1);
/// A joint at rest whose torque is more than this share of the rated torque bears a load.
const LOAD_SHARE: f32 = 0.1;
/// Number of consecutive states with "off" that stop the group of an active motor.
const OFF_STATES_MAX: u32 = 5;

/// One motor and its joint.
#[derive(Debug)]
pub(super) struct Motor {
    /// Index of its joint.
    pub(super) joint: usize,
    pub(super) settings: MotorSettings,
    /// The motor differs from its configuration: its group is never enabled.
    pub(super) is_mismatched: bool,
    pub(super) turn: Turn,
    access: Access,
    mode: Mode,
    measured: Option<Measured<JointSide>>,
    measured_at: Instant,
    /// The command of this cycle; the slew limits start from it in the next.
    applied: Applied,
    /// Cycles in which a value of the setpoint with an effect was clamped to a limit of the joint,
    /// modulo 2³².
    clamped: u32,
    /// A request of an operator that is under way.
    pub(super) request: Option<ServiceRequest>,
    /// When the last request to set its zero was accepted.
    zero_requested: Option<Instant>,
    heat: Heat,
    faults: FaultWatch,
    /// The motor was started and has not confirmed a stop since.
    may_run: bool,
    /// Number of consecutive states with "off" while the motor should follow setpoints.
    off_states: u32,
    replies: Replies,
    plausibility: Plausibility,
    response: Response,
    foreign: Foreign,
    absence: Absence,
    backlog: Backlog,
    registers: Registers,
    /// The supply that it reported last, and when.
    supply: Option<(Supply, Instant)>,
}

impl Motor {
    pub(super) fn new(joint: usize, settings: &MotorSettings, turn: Turn) -> Self {
        Self {
            joint,
            settings: settings.clone(),
            is_mismatched: false,
            turn,
            access: Access::Free,
            mode: if settings.excluded { Mode::EXCLUDED } else { Mode::OFFLINE },
            measured: None,
            measured_at: Instant::ZERO,
            applied: Applied::NEUTRAL,
            clamped: 0,
            request: None,
            zero_requested: None,
            heat: Heat::of(settings),
            faults: FaultWatch::default(),
            may_run: false,
            off_states: 0,
            replies: Replies::default(),
            plausibility: Plausibility::default(),
            response: Response::of(settings),
            foreign: Foreign::default(),
            absence: Absence::default(),
            backlog: Backlog::default(),
            registers: Registers::new(settings),
            supply: None,
        }
    }

    pub(super) const fn mode(&self) -> MotorMode {
        self.mode.code()
    }

    /// Reports a change of its mode.
    pub(super) fn changed(&self, cx: &mut Context) {
        cx.push(Event::Motor { motor: self.joint, mode: self.mode() });
    }

    pub(super) const fn measured(&self) -> Option<&Measured<JointSide>> {
        self.measured.as_ref()
    }

    /// Returns whether its known position is outside its limits.
    pub(super) fn is_outside_limits(&self) -> bool {
        let [low, high] = self.settings.limits.position;
        self.measured.is_some_and(|state| !(low..=high).contains(&state.position))
    }

    /// Returns whether it is known to turn slower than `rest_velocity`, rad/s, and not only because
    /// its drive brakes it.
    pub(super) fn is_at_rest(&self, rest_velocity: f32) -> bool {
        let rests = |state: Measured<JointSide>| {
            state.velocity.abs() < rest_velocity && !self.is_held_by_brake(&state)
        };
        self.is_fresh() && self.measured.is_some_and(rests)
    }

    /// Returns whether its drive brakes it against a load: the joint would fall without torque. A
    /// damped joint under a load sinks.
    fn is_held_by_brake(&self, state: &Measured<JointSide>) -> bool {
        !self.settings.capabilities.impedance
            && state.torque.abs() > LOAD_SHARE * self.settings.winding.rated_torque
    }

    /// Returns whether it was started and may still run. A motor in fault has stopped.
    pub(super) const fn may_run(&self) -> bool {
        self.may_run && !matches!(self.mode, Mode::Fault { .. })
    }

    /// Returns whether it answered after it was started. An excluded motor is not started.
    pub(super) fn is_ready(&self) -> bool {
        self.mode == Mode::Starting(Start::Ready) || self.is_excluded()
    }

    /// Returns whether an operator or the configuration excludes it.
    pub(super) const fn is_excluded(&self) -> bool {
        matches!(self.mode, Mode::Excluded(_))
    }

    /// Excludes or includes the joint. The replies of an excluded motor are used only to confirm a
    /// stop; an included motor is probed again. Requires a disarmed group.
    pub(super) fn exclude(&mut self, excluded: bool, cx: &mut Context) {
        if self.is_excluded() != excluded {
            self.mode = if excluded { Mode::EXCLUDED } else { Mode::OFFLINE };
            self.leave();
            self.registers.forget();
            self.forget_backlog();
            self.faults.reported = Faults::NONE;
            self.applied = Applied::NEUTRAL;
            (self.replies.silent, self.replies.unanswered) = (0, 0);
            self.replies.forget(cx.publications);
            self.changed(cx);
        }
    }

    /// Returns whether two motors answer to its id.
    pub(super) const fn is_doubled(&self) -> bool {
        self.plausibility.is_doubled()
    }

    /// Returns whether its position lacks whole turns, and no operator has confirmed it.
    pub(super) fn lost_turns(&self) -> bool {
        self.absence.has_lost()
    }

    /// Forgets its state until it reports one again, but not where it was.
    fn leave(&mut self) {
        self.supply = None;
        if let Some(state) = self.measured.take() {
            let position = self.settings.transmission.position_to_motor(state.position);
            self.absence.leave(position, self.measured_at);
        }
    }

    /// Compares its position with that before it was silent.
    #[cold]
    fn compare(&mut self, position: f32, at: Instant, cx: &mut Context) {
        let Self { settings, absence, .. } = self;
        // A motor whose position wraps while it runs has no turn to lose.
        if settings.beyond_range == BeyondRange::Wrap {
            return;
        }
        let transmission = settings.transmission;
        let position = transmission.position_to_motor(position);
        let (end, velocity) = (settings.capabilities.position_end, settings.max_velocity);
        if let Some(lost) = absence.end((position, at), end, velocity) {
            let lost = transmission.position_to_joint(lost) - transmission.position_to_joint(0.0);
            cx.push(Event::LostTurns { motor: self.joint, milliradians: (1000.0 * lost) as i32 });
        }
    }

    /// Returns whether it has not answered since the daemon started, and is not excluded.
    pub(super) fn has_never_answered(&self) -> bool {
        self.measured_at == Instant::ZERO && !self.is_excluded() && !self.is_unread()
    }

    pub(super) fn is_overheated(&self) -> bool {
        self.heat.is_overheated() && !self.is_excluded()
    }

    pub(super) const fn begin_start(&mut self) {
        if self.is_excluded() {
            return;
        }
        self.mode = Mode::STARTING;
        self.may_run = true;
    }

    /// Begins to follow setpoints. The slew limits start from its position.
    pub(super) fn activate(&mut self) {
        if self.is_excluded() {
            return;
        }
        self.mode = Mode::Active;
        self.response.forget();
        let position = self.measured.map_or(0.0, |measured| measured.position);
        self.applied.setpoint = Setpoint::impedance(Impedance::new(position, 0.0, 0.0, 0.0, 0.0));
    }

    /// Stops following setpoints. A motor that never ran is only stopped: damping would be its first
    /// impedance.
    pub(super) fn begin_damping(&mut self) {
        let is_limp = matches!(self.mode, Mode::Starting(start) if !start.is_answered());
        if is_limp && self.settings.capabilities.runs_without_enable {
            self.mode = Mode::Idle;
        }
        if matches!(self.mode, Mode::Starting(_) | Mode::Active) {
            let Impedance { kp, kd, .. } = self.applied.setpoint.values;
            let here = self.measured.filter(|_| self.is_fresh());
            let held = here.map(|measured| Impedance::new(measured.position, 0.0, kp, kd, 0.0));
            self.mode = Mode::Damping { held };
        }
    }

    /// Sends only stop commands from now on.
    pub(super) const fn rest(&mut self) {
        if self.mode.is_moving() {
            self.mode = Mode::Idle;
        }
    }

    /// Adds the heat of `elapsed`, s, at the larger of the reported and the commanded torque: a
    /// motor that reports too little torque is not allowed more heat.
    pub(super) fn warm(&mut self, elapsed: f64) {
        let fresh = self.measured.filter(|_| self.is_fresh());
        let reported = fresh.map_or(0.0, |state| state.torque.abs());
        let values = &self.applied.setpoint.values;
        let commanded =
            self.measured.map_or(0.0, |state| values.predicted_torque(state.position, state.velocity));
        let commanded = commanded.abs();
        self.heat.warm(if commanded > reported { commanded } else { reported }, elapsed);
    }

    /// The command of this cycle. Does not allocate or block; constant time.
    pub(super) fn command(&mut self, group_command: &GroupCommand, cx: &mut Context) -> Command {
        if self.turn.waits {
            return Command::Wait;
        }
        if self.is_withheld() {
            self.replies.asked(&Command::Nothing);
            return Command::Nothing;
        }
        if self.backlog.is_due(cx.now) && self.probes(cx) {
            self.replies.asked(&Command::Wait);
            return Command::Wait;
        }
        self.applied.limits = 0;
        let command = if let Some(request) = &mut self.request {
            request.command()
        } else if self.needs_fault_request() {
            Command::GetFault
        } else if let Some(number) = self.register_to_read(cx) {
            Command::GetRegister(number)
        } else {
            self.command_by_mode(group_command, cx)
        };
        let command = self.translated(command);
        self.replies.asked(&command);
        command
    }

    /// Replaces a question for faults by a stop, for a motor whose states contain its faults.
    const fn translated(&self, command: Command) -> Command {
        match command {
            Command::GetFault if !self.settings.capabilities.answers_fault_question => Command::Stop,
            command => command,
        }
    }

    /// Takes its state, which arrived `latency` after the command. `runs` is `None` where states do
    /// not contain it. Counts an implausible state, and does not use it.
    ///
    /// # Errors
    /// The cause for which its group must be stopped.
    #[inline(always)]
    pub(super) fn record_state(
        &mut self,
        reported: Measured<JointSide>,
        at: Instant,
        latency: Duration,
        runs: Option<bool>,
        cx: &mut Context,
    ) -> Result<(), Cause> {
        if self.is_excluded() {
            self.confirm_stop(runs);
            return Ok(());
        }
        if self.is_meaningless() {
            self.record_meaningless(runs, cx);
            return Ok(());
        }
        let is_late = self.backlog.turns() != 0;
        let (at, latency) = if is_late { self.backdated(at, latency, cx) } else { (at, latency) };
        let (measured, cause) = match self.check(reported, at) {
            Credibility::Sound(measured) => (measured, None),
            Credibility::Stop(measured, cause) => (measured, Some(cause)),
            Credibility::Unbelievable => {
                self.replies.implausible = self.replies.implausible.wrapping_add(1);
                self.record_alive();
                return Ok(());
            }
        };
        if cause == Some(Cause::Implausible) {
            // It may have restarted faster than a silence is noticed.
            self.leave();
            self.expire_registers();
        }
        if self.measured.is_none() {
            self.compare(measured.position, at, cx);
        }
        self.take_state(measured, at, latency, runs, cx);
        let is_off = self.is_off(&measured, at);
        if is_off {
            self.expire_registers();
        }
        let off = is_off.then_some(Cause::MotorOff);
        cause.or(off).map_or(Ok(()), Err)
    }

    /// Returns whether an active motor is off, by its status or by its torque in `state`.
    #[inline(always)]
    fn is_off(&mut self, state: &Measured<JointSide>, at: Instant) -> bool {
        matches!(self.mode, Mode::Active)
            && (self.off_states >= OFF_STATES_MAX || self.response.is_off(state, at))
    }

    #[inline(always)]
    fn check(&mut self, reported: Measured<JointSide>, at: Instant) -> Credibility {
        // A step is expected while the zero is being moved.
        let zeroing = self.request.is_some_and(|request| request.kind == Kind::SetZero);
        let before = self.measured.as_ref().filter(|_| !zeroing).map(|measured| (measured, self.measured_at));
        let active = matches!(self.mode, Mode::Active);
        let applied = &self.applied.setpoint;
        let expected = Expectation { settings: &self.settings, before, applied, active };
        self.plausibility.check(reported, at, &expected)
    }

    #[inline(always)]
    fn take_state(
        &mut self,
        measured: Measured<JointSide>,
        at: Instant,
        latency: Duration,
        runs: Option<bool>,
        cx: &mut Context,
    ) {
        self.measured = Some(measured);
        self.measured_at = at;
        self.confirm_stop(runs);
        self.replies.state(latency, cx.publications);
        if matches!(self.mode, Mode::Active) {
            let is_off = runs == Some(false);
            self.off_states = if is_off { self.off_states.saturating_add(1) } else { 0 };
        } else {
            self.advance_mode(runs, cx);
        }
        self.confirm_zero(cx);
    }

    /// Records that a motor which is not active reported its state.
    #[cold]
    fn advance_mode(&mut self, runs: Option<bool>, cx: &mut Context) {
        match &mut self.mode {
            Mode::Offline(_) => {
                self.mode = if self.faults.reported.is_none() { Mode::Idle } else { Mode::FAULT };
                self.changed(cx);
            }
            Mode::Starting(start) => start.answered(runs != Some(false)),
            _ => {}
        }
        self.off_states = 0;
    }

    /// Takes a state as the confirmation of a stop, if it answers a stop and does not report that
    /// the motor `runs`.
    fn confirm_stop(&mut self, runs: Option<bool>) {
        if self.replies.asked_stop {
            self.may_run &= !self.settings.capabilities.state_confirms_stop || runs == Some(true);
        }
    }

    /// Records an answer without a state. An offline motor is probed in the next cycle.
    pub(super) const fn record_alive(&mut self) {
        self.replies.alive();
        self.hurry_probe();
        if let Mode::Starting(start) = &mut self.mode {
            start.answered(false);
        }
    }

    /// Records the confirmation of a stop.
    pub(super) const fn record_stop(&mut self) {
        self.record_alive();
        self.may_run = false;
    }

    /// Records that it refuses the command.
    pub(super) const fn record_refusal(&mut self) {
        self.replies.alive();
        self.faults.is_urgent = true;
    }

    /// Records whether its state reports a fault without its name. The motor is asked for the name
    /// in the next turn, until it answers.
    pub(super) const fn record_unnamed_fault(&mut self, is_unnamed: bool) {
        let faults = &mut self.faults;
        if is_unnamed {
            faults.is_answered &= faults.is_unnamed;
            faults.is_urgent |= !faults.is_answered;
        } else {
            faults.is_answered = false;
        }
        faults.is_unnamed = is_unnamed;
    }

    /// Counts a late answer.
    pub(super) const fn record_late(&mut self) {
        self.replies.late = self.replies.late.wrapping_add(1);
        self.backlog.late();
    }

    /// Records a second answer to one question. Returns whether two motors share its id.
    pub(super) fn record_duplicate(&mut self) -> bool {
        self.plausibility.duplicate()
    }

    /// Records `frames` by which another sender commanded it, with `id`. Returns whether that
    /// sender is another master.
    pub(super) fn record_foreign(
        &mut self,
        id: FrameId,
        frames: ForeignFrames,
        at: Instant,
        cx: &mut Context,
    ) -> bool {
        // The switch of a daemon that ran before may still damp.
        let switch_acts = cx.safety.damp + SWITCH_ENDS;
        let safe_max = if cx.uptime() > switch_acts { SAFE_MAX } else { switch_acts };
        let observed = self.foreign.observe(frames, at, safe_max);
        if let Some(frames) = observed.report {
            cx.push(Event::Foreign { motor: self.joint, id: id.raw(), frames });
        }
        observed.is_master
    }

    /// Returns whether another sender commands it.
    pub(super) fn is_commanded_elsewhere(&self, now: Instant) -> bool {
        self.foreign.is_present(now)
    }

    /// Takes its fault bits.
    pub(super) fn record_fault(&mut self, fault: Faults, at: Instant, cx: &mut Context) {
        self.faults.postpone(at, cx);
        self.faults.is_answered = true;
        let was_in_fault = matches!(self.mode, Mode::Fault { .. });
        if fault != self.faults.reported && !(fault.is_none() && was_in_fault) {
            self.faults.reported = fault;
            cx.push(Event::Fault { motor: self.joint, bits: fault.0 });
        }
        if fault.is_none() {
            self.replies.silent = if was_in_fault { 0 } else { self.replies.silent };
            return self.confirm_cleared(cx);
        }
        (self.replies.silent, self.replies.unanswered) = (0, 0);
        if let Some(request) = &mut self.request {
            request.repeat_clear();
        }
        if !was_in_fault {
            self.mode = Mode::FAULT;
            self.changed(cx);
        }
    }

    /// Ends its turn. Returns whether the motor is lost.
    #[inline(always)]
    pub(super) fn end_turn(&mut self, cx: &mut Context) -> bool {
        self.plausibility.end_turn();
        if self.replies.answered() {
            self.replies.unanswered = 0;
            return false;
        }
        self.end_unanswered_turn(cx)
    }

    /// Records that it does not answer any more.
    fn lose(&mut self, cx: &Context) {
        self.mode = Mode::OFFLINE;
        self.leave();
        self.forget_backlog();
        self.registers.forget();
        (self.replies.silent, self.replies.unanswered) = (0, 0);
        self.replies.forget(cx.publications);
    }

    /// Records a turn without an answer. Returns the consecutive unanswered turns.
    fn miss(&mut self, cx: &Context) -> u32 {
        let missed = self.replies.missed;
        let unanswered = self.replies.miss(cx.wake.cycle);
        if self.replies.missed != missed {
            self.suspect_backlog(cx.now);
        }
        unanswered
    }

    /// Returns whether it may be asked a question now: no service request is open, its state has
    /// arrived, and no late reply can be mistaken for the answer.
    pub(super) fn may_be_asked(&self, cycle: u64) -> bool {
        self.request.is_none() && !self.is_held() && self.replies.is_settled(cycle)
    }

    /// Returns when it should be asked for its faults next, if it may be asked now.
    pub(super) fn poll_at(&self, cycle: u64) -> Option<Instant> {
        self.poll_after().filter(|_| self.may_be_asked(cycle))
    }

    /// Returns the time before which it is not asked for its faults. It only rises. `None` for a
    /// motor that is never asked.
    pub(super) fn poll_after(&self) -> Option<Instant> {
        self.settings.capabilities.answers_fault_question.then_some(self.faults.poll_at)
    }
}
