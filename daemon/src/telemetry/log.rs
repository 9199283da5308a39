//! The events of the cycle and the requests of clients as lines of the log.
//!
//! | level | lines |
//! |---|---|
//! | error | a group was stopped for a cause, or a motor has a fault: an operator must act |
//! | warn | a motor was lost while nothing moved, a bus changed, ticks were missed |
//! | info | who asked for what, and what a group does |
//! | debug | every change of every motor |
//!
//! A line that needs an action has a field that `motorctl explain` accepts: `cause`, `faults`,
//! `condition`, `why` or `see`.
//!
//! Frequent changes of a motor or bus are summed up once a second, missed ticks once a minute.

use super::groups::log_supply;
use super::programs::Programs;
use super::questions::Asked;
use super::registers::RegisterLog;
use super::unexpected::OtherFormats;
use motord_core::control::{Event, Losses};
use motord_core::cycle::Counters;
use motord_protocol::Faults;
use motord_settings::settings::Settings;
use motord_shared::description::slow_owner;
use motord_shared::message::{ALL_GROUPS, NO_JOINT};
use motord_shared::{BusCondition, Cause, Fault, ImuContradiction, MotorMode, Operation, Phase, Refusal};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Changes of one motor or bus that get a line each, per second. A start or a stop makes two.
const CHANGES_LOGGED: u32 = 4;
/// Requests that get a line each, per second: one for every group and a few more.
const REQUESTS_LOGGED: u32 = 16;
/// Time from an event of lost frames in which a silent motor is put down to it, s.
const LOSS_SECONDS: f64 = 2.0;
/// Seconds between two lines about missed ticks. The first ones get a line immediately.
const MISSED_TICKS_PERIOD: u32 = 60;

/// Names for the events, and the counts of the last second.
pub(super) struct Log {
    motors: Vec<Motor>,
    groups: Vec<Group>,
    buses: Vec<Subject>,
    /// With the words for each.
    sensors: Vec<(Subject, [&'static str; 3])>,
    requests: Subject,
    refused: Option<Asked>,
    missed_ticks: u64,
    /// Seconds since missed ticks were logged.
    quiet_for: u32,
    dropped: u64,
    errors: u64,
    foreign_imu_samples: u64,
    /// The cycle of the last event of lost frames, by bus.
    lost_in: Vec<Option<u64>>,
    /// Cycles after such an event in which it explains a silent motor: events are a second apart.
    loss_cycles: u64,
    setpoint_timeout: Duration,
    registers: RegisterLog,
}

fn vector([x, y, z]: [f32; 3]) -> String {
    format!("({x:.2} {y:.2} {z:.2})")
}

/// Something that may change more often than anybody reads.
struct Subject {
    name: String,
    logged: u32,
    changes: u32,
}

struct Motor {
    subject: Subject,
    /// A motor that comes and goes hides none of its faults and none of its lost turns.
    faults: Subject,
    lost_turns: Subject,
    group: usize,
    bus: usize,
    /// The log says that it went.
    is_missed: bool,
    /// Nothing is expected of it; once it is included, its first answer is no news.
    is_excluded: bool,
}

struct Group {
    name: String,
    phase: Phase,
    /// Id and program of the last owner.
    owner: Option<(u32, Option<String>)>,
    /// The cycle of the last stop.
    stopped_in: u64,
    /// Time between its setpoints, and their horizon, when they timed out last.
    period: Option<[Duration; 2]>,
}

impl Subject {
    fn new(name: &str, logged: u32) -> Self {
        Self { name: name.to_owned(), logged, changes: 0 }
    }

    /// Counts a change. Returns whether it gets a line.
    fn changes(&mut self) -> bool {
        self.changes += 1;
        self.changes <= self.logged
    }

    /// A second is over: sums up the changes that got no line.
    fn summarise(&mut self) {
        let changes = std::mem::take(&mut self.changes);
        if changes > self.logged {
            tracing::warn!(
                name = self.name,
                changes,
                see = "too-many-changes",
                "too many changes in a second for a line each"
            );
        }
    }
}

impl Log {
    pub(super) fn new(settings: &Settings) -> Self {
        let group_of = |motor| settings.groups.iter().position(|group| group.motors.contains(&motor));
        let motors = settings.motors.iter().enumerate().map(|(index, motor)| Motor {
            subject: Subject::new(&motor.name, CHANGES_LOGGED),
            faults: Subject::new(&motor.name, CHANGES_LOGGED),
            lost_turns: Subject::new(&motor.name, CHANGES_LOGGED),
            group: group_of(index).unwrap_or_default(),
            bus: motor.bus,
            is_missed: false,
            is_excluded: false,
        });
        let groups = settings.groups.iter().map(|group| Group {
            name: group.name.clone(),
            phase: Phase::Disarmed,
            owner: None,
            stopped_in: 0,
            period: None,
        });
        let sensors = settings.sensors.words();
        Self {
            motors: motors.collect(),
            groups: groups.collect(),
            buses: settings.buses.iter().map(|bus| Subject::new(&bus.name, CHANGES_LOGGED)).collect(),
            sensors: sensors.map(|(name, words)| (Subject::new(name, CHANGES_LOGGED), words)).collect(),
            requests: Subject::new("requests", REQUESTS_LOGGED),
            refused: None,
            missed_ticks: 0,
            quiet_for: MISSED_TICKS_PERIOD,
            dropped: 0,
            errors: 0,
            foreign_imu_samples: 0,
            lost_in: vec![None; settings.buses.len()],
            loss_cycles: (LOSS_SECONDS * settings.cycle.rate_hz) as u64,
            setpoint_timeout: settings.safety.setpoint_timeout,
            registers: RegisterLog::new(settings),
        }
    }

    /// `programs` knows the programs of those who asked.
    pub(super) fn log(&mut self, cycle: u64, event: Event, programs: &Programs) {
        match event {
            Event::Motor { motor, mode } => self.log_mode(cycle, motor, mode),
            Event::FramesLost { bus, losses } => self.log_losses(cycle, bus, losses),
            Event::Silent { motor } => {
                self.motors[motor].is_missed = true;
                let check = "check its power and wiring, its id and host id, the bit rate, that it speaks the configured \
                             protocol, and its faults";
                let (see, check) = self.check_of_silence(cycle, motor, check);
                let motor = &self.motors[motor].subject.name;
                tracing::error!(cycle, motor, see, "has never reported a state: {check}");
            }
            Event::Foreign { motor, id, frames } => tracing::warn!(
                cycle,
                motor = self.motors[motor].subject.name,
                id = format!("{id:#05x}"),
                frames,
                see = "foreign-master",
                "frames with its command id arrive that motord did not send: another program or device commands it"
            ),
            Event::Late { motor, turns, time } => self.log_late(cycle, motor, turns, time),
            Event::LostTurns { motor, milliradians } => self.log_lost_turns(cycle, motor, milliradians),
            Event::Registers { motor, values, wrong } => self.registers.log(cycle, motor, values, wrong),
            Event::Unread { motor, is_assumed } => self.registers.log_unread(cycle, motor, is_assumed),
            Event::Fault { motor, bits } => self.log_fault(cycle, motor, Faults(bits)),
            Event::Group { group, phase } => self.log_phase(cycle, group, phase),
            Event::SetpointPeriod { group, period, horizon } => {
                self.groups[group].period = Some([period, horizon]);
            }
            Event::Stopped { group, cause, motor, pid } => {
                let requester = pid.map(|pid| (pid, programs.of_stop(cause, pid)));
                self.log_stop(cycle, group, cause, motor, requester);
            }
            Event::Reset { group } => tracing::debug!(cycle, group = self.groups[group].name, "reset"),
            Event::Owner { group, pid } => self.log_owner(cycle, group, pid, programs),
            Event::Bus { bus, condition } => self.log_condition(cycle, bus, condition),
            Event::Sensor { sensor, is_lost } => self.log_sensor(cycle, sensor, is_lost),
            Event::Gravity { imu, contradictions, up, acceleration } => {
                self.log_gravity(cycle, imu, contradictions, [up, acceleration]);
            }
            Event::Supply { group, motor, voltage, is_low } => {
                let motor = &self.motors[motor].subject.name;
                log_supply(cycle, &self.groups[group].name, (motor, voltage), is_low);
            }
            Event::MissedTicks { missed_ticks } => self.missed_ticks += missed_ticks,
        }
    }

    /// A motor that goes silent stops its moving group. The stop has a line, so this one is debug.
    fn log_mode(&mut self, cycle: u64, motor: usize, mode: MotorMode) {
        let phase = self.groups[self.motors[motor].group].phase;
        let is_moving = matches!(phase, Phase::Starting | Phase::Active);
        let group = if phase == Phase::Damping { "is being damped" } else { "was not moving" };
        let (see, check) = self.check_of_silence(cycle, motor, "check its power and wiring");
        let Motor { subject, is_missed, is_excluded, .. } = &mut self.motors[motor];
        let was_excluded = std::mem::replace(is_excluded, mode == MotorMode::Excluded);
        let is_offline = mode == MotorMode::Offline && !is_moving && !was_excluded;
        let was_missed = std::mem::replace(is_missed, is_offline);
        let is_logged = was_missed != *is_missed && subject.changes();
        let (motor, mode_name) = (&subject.name, mode.name());
        match (is_logged, *is_missed) {
            (true, true) => {
                tracing::warn!(cycle, motor, see, "does not answer any more: {check}; its group {group}");
            }
            (true, false) => tracing::info!(cycle, motor, mode = mode_name, "answers again"),
            (false, _) => tracing::debug!(cycle, motor, mode = mode_name, "{}", mode.sentence()),
        }
    }

    /// Returns the page and the check for a silent motor: `check`, unless its bus just lost frames.
    fn check_of_silence(
        &self,
        cycle: u64,
        motor: usize,
        check: &'static str,
    ) -> (&'static str, &'static str) {
        match self.lost_in[self.motors[motor].bus] {
            Some(lost) if cycle.saturating_sub(lost) <= self.loss_cycles => {
                ("frames-lost", "its bus loses received frames, as an earlier line says")
            }
            _ => {
                let see = "motor-silent";
                (see, check)
            }
        }
    }

    fn log_losses(&mut self, cycle: u64, bus: usize, losses: Losses) {
        self.lost_in[bus] = Some(cycle);
        let (bus, Losses { by_controller, by_kernel }) = (&self.buses[bus].name, losses);
        if by_controller > 0 {
            tracing::error!(
                cycle,
                bus,
                overruns = by_controller,
                see = "frames-lost",
                "the CAN controller dropped received frames: its driver is too slow (clock of its SPI, interrupts on a busy \
                 processor), or the bus is too full for it"
            );
        }
        if by_kernel > 0 {
            tracing::error!(
                cycle,
                bus,
                frames = by_kernel,
                see = "frames-lost",
                "the kernel dropped received frames: the cycle did not read them in time, or other senders flood the bus"
            );
        }
    }

    fn log_sensor(&mut self, cycle: u64, index: usize, is_lost: bool) {
        let (subject, [kind, see, check]) = &mut self.sensors[index];
        if !subject.changes() {
            return;
        }
        let name = Some(&subject.name);
        let (imu, sensor) = if *kind == "imu" { (name, None) } else { (None, name) };
        if is_lost {
            tracing::error!(cycle, imu, sensor, see, "delivers no samples: {check}");
        } else {
            tracing::info!(cycle, imu, sensor, "delivers samples");
        }
    }

    /// Each rest lasts for more than a second, so each change gets a line.
    fn log_gravity(
        &mut self,
        cycle: u64,
        imu: usize,
        contradictions: u32,
        [up, acceleration]: [[f32; 3]; 2],
    ) {
        let imu = &self.sensors[imu].0.name;
        if contradictions == 0 {
            return tracing::info!(
                cycle,
                imu,
                "at rest, its quaternion and its acceleration agree about gravity"
            );
        }
        let found = ImuContradiction::of_bits(contradictions);
        let (names, sentences): (Vec<_>, Vec<_>) =
            found.map(|found| (found.name(), found.sentence())).unzip();
        tracing::warn!(
            cycle,
            imu,
            contradictions = names.join(" "),
            see = "imu-contradicts",
            "at rest, up is {} by its quaternion and {} m/s² by its acceleration, in the frame of the body. {}",
            vector(up),
            vector(acceleration),
            sentences.join(" ")
        );
    }

    fn log_late(&mut self, cycle: u64, motor: usize, turns: u32, time: Duration) {
        let motor = &mut self.motors[motor].subject;
        if !motor.changes() {
            return;
        }
        let motor = &motor.name;
        if turns == 0 {
            return tracing::info!(cycle, motor, "answers in time again");
        }
        tracing::warn!(
            cycle,
            motor,
            turns,
            see = "late-answers",
            "each of its answers is {:.1} ms late and belongs to an earlier command, and its state is as old: check the adapter \
             and its driver, and what else uses the bus",
            time.as_secs_f64() * 1e3
        );
    }

    /// Answers in other formats on a bus with a silent motor.
    pub(super) fn log_other_formats(&self, found: OtherFormats) {
        let OtherFormats { bus, fd, extended } = found;
        tracing::error!(
            bus = self.buses[bus].name,
            fd,
            extended,
            see = "other-format",
            "a motor is silent, and frames arrive in CAN FD format (fd) or with 29-bit ids (extended): it may answer in a format \
             that motord does not speak; set it to classic CAN and MIT with its vendor's tool"
        );
    }

    fn log_lost_turns(&mut self, cycle: u64, motor: usize, milliradians: i32) {
        let motor = &mut self.motors[motor];
        if motor.lost_turns.changes() {
            tracing::error!(
                cycle,
                motor = motor.subject.name,
                see = "turn-lost",
                "its position differs by {:+.2} rad from the one before it was silent: the motor lost whole turns, or has another \
                 zero. Its group is not enabled until the position is right or confirmed",
                f64::from(milliradians) / 1000.0
            );
        }
    }

    fn log_fault(&mut self, cycle: u64, motor: usize, bits: Faults) {
        let motor = &mut self.motors[motor].faults;
        if !motor.changes() {
            return;
        }
        if bits.is_none() {
            return tracing::info!(cycle, motor = motor.name, "no fault any more");
        }
        let (names, sentences): (Vec<_>, Vec<_>) =
            Fault::of_bits(bits.0).map(|fault| (fault.name(), fault.sentence())).unzip();
        let (faults, sentences) = (names.join(" "), sentences.join(" "));
        tracing::error!(cycle, motor = motor.name, faults, bits = bits.0, "motor fault: {sentences}");
    }

    /// Another line has the requester of a start, or the cause of a stop.
    fn log_phase(&mut self, cycle: u64, group: usize, phase: Phase) {
        let group = &mut self.groups[group];
        group.phase = phase;
        let (group, phase_name) = (&group.name, phase.name());
        match phase {
            Phase::Active | Phase::Disarmed => {
                tracing::info!(cycle, group, phase = phase_name, "{}", phase.sentence());
            }
            Phase::Starting | Phase::Damping => {
                tracing::debug!(cycle, group, phase = phase_name, "{}", phase.sentence());
            }
        }
    }

    /// Logs a stop as an error, after a disable as a warning, at the end of the daemon as debug.
    fn log_stop(
        &mut self,
        cycle: u64,
        group: usize,
        cause: Cause,
        motor: Option<usize>,
        requester: Option<(u32, Option<String>)>,
    ) {
        let motor = motor.map(|motor| &self.motors[motor].subject.name);
        let group = &mut self.groups[group];
        group.stopped_in = cycle;
        let period = group.period.take().filter(|_| cause == Cause::SetpointTimeout);
        let advice = period.and_then(|[period, horizon]| slow_owner(period, self.setpoint_timeout, horizon));
        let advice = advice.unwrap_or_else(|| cause.advice().into());
        let by_owner = matches!(cause, Cause::SetpointTimeout | Cause::OwnerLost | Cause::OwnerDied);
        let (pid, program) = requester.or_else(|| group.owner.clone().filter(|_| by_owner)).unzip();
        let program = program.flatten();
        let (group, cause_name, sentence) = (&group.name, cause.name(), cause.sentence());
        if cause == Cause::Shutdown {
            return tracing::debug!(cycle, group, cause = cause_name, "{sentence}");
        }
        if cause == Cause::Disabled {
            return tracing::warn!(cycle, group, pid, program, cause = cause_name, "{sentence} {advice}.");
        }
        tracing::error!(
            cycle,
            group,
            motor,
            pid,
            program,
            cause = cause_name,
            "{sentence} The group is stopped until it is reset and enabled. {advice}."
        );
    }

    fn log_owner(&mut self, cycle: u64, group: usize, pid: Option<u32>, programs: &Programs) {
        let group = &mut self.groups[group];
        if let Some(pid) = pid {
            let program = programs.program(pid);
            tracing::info!(cycle, group = group.name, pid, program, "claimed");
            group.owner = Some((pid, program));
            return;
        }
        let (pid, program) = group.owner.clone().unzip();
        let program = program.flatten();
        if group.stopped_in == cycle {
            tracing::debug!(cycle, group = group.name, pid, program, "has no owner any more");
        } else {
            tracing::info!(
                cycle,
                group = group.name,
                pid,
                program,
                "has no owner any more: it was released, or its owner has gone"
            );
        }
    }

    fn log_condition(&mut self, cycle: u64, bus: usize, condition: BusCondition) {
        let bus = &mut self.buses[bus];
        if !bus.changes() {
            return;
        }
        let (bus, condition_name) = (&bus.name, condition.name());
        if condition == BusCondition::Active {
            tracing::info!(cycle, bus, condition = condition_name, "{}", condition.sentence());
        } else {
            tracing::warn!(cycle, bus, condition = condition_name, "{}", condition.sentence());
        }
    }

    /// Logs an answered request that no event of the cycle reports.
    pub(super) fn log_request(&mut self, asked: &Asked, programs: &Programs) {
        let Ok(operation) = asked.request.operation() else { return };
        match Refusal::try_from(asked.reply.refusal) {
            Ok(refusal) => self.log_refusal(operation, refusal, asked, programs),
            Err(_) => {
                let Some(done) = done(operation) else { return };
                self.refused = None;
                if self.requests.changes() {
                    let (request, program) = (&asked.request, programs.program(asked.request.pid));
                    let (group, joint) = self.names(request.group, request.joint, operation);
                    tracing::info!(cycle = asked.cycle, group, joint, pid = request.pid, program, "{done}");
                }
            }
        }
    }

    /// A program that asks again and again is refused in one line.
    fn log_refusal(&mut self, operation: Operation, refusal: Refusal, asked: &Asked, programs: &Programs) {
        let is_same = |last: &Asked| Asked { cycle: asked.cycle, ..*last } == *asked;
        if self.refused.as_ref().is_some_and(is_same) || !self.requests.changes() {
            return;
        }
        let (request, program) = (&asked.request, programs.program(asked.request.pid));
        let (group, joint) = self.names(request.group, request.joint, operation);
        let (why, sentence) = (refusal.name(), refusal.sentence());
        tracing::info!(
            cycle = asked.cycle,
            group,
            joint,
            pid = request.pid,
            program,
            why,
            "{operation} was refused: {sentence}"
        );
        self.refused = Some(*asked);
    }

    /// The group or the joint that a request is about.
    fn names(&self, group: u32, joint: u32, operation: Operation) -> (Option<&str>, Option<&str>) {
        let of_joint = matches!(
            operation,
            Operation::SetZero | Operation::ClearFault | Operation::Exclude | Operation::Include
        );
        if of_joint && joint != NO_JOINT {
            return (None, self.motors.get(joint as usize).map(|motor| motor.subject.name.as_str()));
        }
        let group = match group {
            ALL_GROUPS => Some("all"),
            group => self.groups.get(group as usize).map(|group| group.name.as_str()),
        };
        (group, None)
    }

    /// A second is over: logs everything that was only counted.
    pub(super) fn log_counts(&mut self, counters: &Counters) {
        for Motor { subject, faults, lost_turns, .. } in &mut self.motors {
            [subject, faults, lost_turns].into_iter().for_each(Subject::summarise);
        }
        self.buses.iter_mut().for_each(Subject::summarise);
        self.sensors.iter_mut().for_each(|(subject, _)| subject.summarise());
        self.requests.summarise();
        self.quiet_for = self.quiet_for.saturating_add(1);
        if self.quiet_for >= MISSED_TICKS_PERIOD {
            self.log_missed_ticks();
        }
        let dropped = counters.dropped.load(Ordering::Relaxed);
        if dropped > std::mem::replace(&mut self.dropped, dropped) {
            tracing::warn!(
                dropped,
                see = "records-dropped",
                "telemetry could not keep up: records were dropped"
            );
        }
        let samples = counters.foreign_imu_samples.load(Ordering::Relaxed);
        let new = samples - std::mem::replace(&mut self.foreign_imu_samples, samples);
        if new > 0 {
            tracing::warn!(
                samples = new,
                see = "foreign-imu-samples",
                "samples for no external IMU of this daemon were ignored: their publisher means an earlier daemon or another robot"
            );
        }
        let errors = counters.ipc_errors.load(Ordering::Relaxed);
        if errors > std::mem::replace(&mut self.errors, errors) {
            tracing::error!(
                errors,
                see = "clients-not-served",
                "a service for clients failed: are its files damaged, or is the disk full?"
            );
        }
    }

    /// The ticks that were missed since the last such line, if there are any.
    pub(super) fn log_missed_ticks(&mut self) {
        let missed_ticks = std::mem::take(&mut self.missed_ticks);
        if missed_ticks > 0 {
            self.quiet_for = 0;
            let advice = Cause::TimeBase.advice();
            tracing::warn!(
                missed_ticks,
                see = "ticks-missed",
                "ticks were missed: the cycle thread woke up too late. {advice}."
            );
        }
    }
}

/// The words for a granted request; `None` if an event reports it, or if it changed nothing.
const fn done(operation: Operation) -> Option<&'static str> {
    match operation {
        Operation::Enable => Some("enabled"),
        Operation::Disable => Some("disabled"),
        Operation::Reset => Some("reset"),
        Operation::ForceRelease => Some("taken from its owner"),
        Operation::SetZero => Some("its present position is its zero now"),
        Operation::ClearFault => Some("fault cleared"),
        Operation::Exclude => Some("excluded"),
        Operation::Include => Some("included again"),
        Operation::ResetTelemetry => Some("the latencies and their counters begin anew"),
        Operation::Claim
        | Operation::Release
        | Operation::EmergencyStop
        | Operation::Describe
        | Operation::Telemetry
        | Operation::Histograms => None,
    }
}
