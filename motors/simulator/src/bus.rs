//! One simulated bus: arbitration, transfer times, and delivery.

mod faults;

use crate::body::Shaft;
use crate::contention::{Answers, Contender, Sender};
use crate::fault::{Fault, FaultVerb, InjectError};
use crate::imu_node::ImuNode;
use crate::length::frame_time;
use crate::motor::{DelayedReply, Impairment, Motor};
use crate::random::Random;
use crate::settings::{BusSettings, Medium, MotorSettings};
use crate::wire::{Direction, Record, Recorded};
use motord_bus::arithmetic::{IdWidth, SERIAL_FRAME_BITS, unstuffed_bits, wire_time};
use motord_bus::frame::ControllerState;
use motord_bus::{
    Arrival, Bus, Content, Duration, ErrorFrame, Frame, FrameId, Inbox, Instant, Readiness, Refusal, Sent,
};
use std::collections::VecDeque;

/// Most frames that one call transfers. A longer backlog of a flood is dropped.
const TRANSFERS_MAX: usize = 4096;
/// Shortest answer: the fault `short` leaves 4 of the 6 bytes of a SteadyWin MIT answer.
const ANSWER_BYTES_MIN: u32 = 4;
/// The frames of a flood have ids from here to 0x7FF, which no motor should have.
const UNEXPECTED_ID: u16 = 0x7F0;

/// The host's report of a frame that was destroyed on the wire.
const DESTROYED: Content =
    Content::Error(ErrorFrame { class: ErrorFrame::PROTOCOL | ErrorFrame::BUS_ERROR, data: [0; 8] });

/// A bus with its motors, in process. The times that are passed in and the seed determine the time
/// of every event. The same calls therefore give the same bytes, on virtual and on real time.
///
/// - The host's frames wait in a queue, first in first out. When the wire is idle, the waiting
///   frame with the lowest id is sent next; on a serial line, the one that has waited longest. It
///   takes its exact length, and is delivered when it is complete.
/// - Every motor receives every frame. A motor whose id is the host id of another one obeys the
///   answers of that motor.
/// - Two motors may send the same id at once. Equal bytes merge into one frame. Different bytes
///   destroy each other: the wire is busy for the length of the frame, the host receives an error
///   frame, and the motors retry one by one.
/// - A serial line carries the host's frames in their order, even before a motor has answered.
///   Answers that overlap destroy each other, whatever their content, and are not sent again.
///
/// After construction no method of [`Bus`] allocates; each transfers at most 4096 frames.
#[derive(Debug, Clone)]
pub struct SimulatedBus {
    settings: BusSettings,
    motors: Vec<Motor>,
    imus: Vec<ImuNode>,
    random: Random,
    /// A time has been passed in. The life of a bus begins at the first call, not at the clock's
    /// zero.
    begun: bool,
    now: Instant,
    queue: VecDeque<Contender>,
    answers: Answers,
    wire: Option<Transfer>,
    arrivals: VecDeque<Arrival>,
    lost: u32,
    link: Link,
    flood: Option<Flood>,
    /// The motors lost their power together.
    has_no_power: bool,
    /// The controller reported that it is error passive: no node acknowledges.
    is_passive: bool,
    record: Record,
}

/// The state of the host's controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Link {
    Up,
    Full { space: usize },
    Unacknowledged,
    Off,
    Down,
    Gone,
}

/// A frame on the wire.
#[derive(Debug, Clone, Copy)]
struct Transfer {
    sender: Sender,
    frame: Frame,
    /// The frame has waited for the wire since this time.
    ready: Instant,
    ends: Instant,
}

#[derive(Debug, Clone, Copy)]
struct Flood {
    period: Duration,
    contender: Contender,
}

impl SimulatedBus {
    /// Returns a bus at rest, with stopped motors. `seed` determines jitter, garbage and losses.
    ///
    /// # Panics
    ///
    /// When a setting is not physical (see [`MotorSettings`]), or the bit rate is zero.
    #[must_use]
    pub fn new(settings: BusSettings, motors: Vec<MotorSettings>, seed: u64) -> Self {
        let wire_bitrate = settings.wire_bitrate.unwrap_or(settings.bitrate);
        assert!(settings.bitrate.min(wire_bitrate) > 0, "a bus without a bit rate carries nothing");
        let motors: Vec<Motor> =
            motors.into_iter().map(|motor| Motor::new(motor, settings.medium, settings.bitrate)).collect();
        let imus: Vec<_> = settings.imus.iter().map(ImuNode::new).collect();
        Self {
            random: Random::new(seed),
            begun: false,
            now: Instant::ZERO,
            // One more: a frame that was destroyed on the wire goes back to the queue.
            queue: VecDeque::with_capacity(settings.tx_queue + settings.adapter.unwrap_or(0) + 1),
            answers: Answers::new(motors.len() + imus.len()),
            wire: None,
            arrivals: VecDeque::with_capacity(settings.rx_queue),
            lost: 0,
            link: Link::Up,
            flood: None,
            has_no_power: false,
            is_passive: false,
            record: Record::new(settings.record),
            motors,
            imus,
            settings,
        }
    }

    /// Returns the name in the settings.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.settings.name
    }

    /// Returns the motor of this name, at the latest time that was passed in.
    #[must_use]
    pub fn motor(&self, name: &str) -> Option<&Motor> {
        self.motors.iter().find(|motor| motor.name() == name)
    }

    /// Returns all motors, in the order of their settings.
    #[must_use]
    pub fn motors(&self) -> &[Motor] {
        &self.motors
    }

    /// Returns the ids of frames that IMUs obey.
    #[cfg(feature = "bridge")]
    pub(crate) fn imu_addresses(&self) -> impl Iterator<Item = FrameId> {
        self.imus.iter().flat_map(ImuNode::addresses)
    }

    /// Returns the frames that were on the wire since the last call, oldest first.
    /// [`BusSettings::record`] limits their number.
    pub fn take_record(&mut self) -> impl Iterator<Item = Recorded> + '_ {
        self.record.take()
    }

    /// Delivers `content` to the host, from another node or from a recorded run. It takes no time
    /// on the wire.
    pub fn deliver(&mut self, now: Instant, content: Content) {
        self.advance(now);
        if !self.link.is_cut() {
            self.arrive(self.now, content);
        }
    }

    /// Applies `verb` to the bus, or to one of its motors or IMUs.
    ///
    /// # Errors
    ///
    /// The target is unknown, or does not support this fault. Then nothing has changed.
    pub fn inject(&mut self, now: Instant, verb: &FaultVerb) -> Result<(), InjectError> {
        self.advance(now);
        if verb.target == self.settings.name {
            return self.disturb(verb.fault);
        }
        if let Some(imu) = self.imus.iter_mut().find(|imu| imu.name() == verb.target) {
            return imu.inject(verb.fault);
        }
        let found = self.motors.iter().position(|motor| motor.name() == verb.target);
        let index = found.ok_or(InjectError::NoSuchTarget)?;
        if matches!(verb.fault, Fault::PowerOff | Fault::PowerCycle) {
            self.answers.forget(Sender::Motor(index));
        }
        self.motors[index].inject(now, verb.fault)
    }

    /// Starts the drive of the motor `name` with `memory`, which [`Motor::memory`] returned.
    ///
    /// # Errors
    ///
    /// There is no such motor, or `memory` is not valid.
    pub fn remember(&mut self, name: &str, memory: &str) -> Result<(), InjectError> {
        let motor = self.motors.iter_mut().find(|motor| motor.name() == name);
        motor.ok_or(InjectError::NoSuchTarget)?.remember(memory).ok_or(InjectError::NoMemory)
    }

    /// Lets a plant outside move the shafts from now on. Appends their states to `shafts`, by
    /// motor.
    pub(crate) fn couple(&mut self, shafts: &mut Vec<Shaft>) {
        shafts.extend(self.motors.iter_mut().map(Motor::couple));
    }

    /// Writes one of `impulses` for each motor: torque times time on its shaft from the last call
    /// until `end`, N·m·s.
    pub(crate) fn impulses_until<'a>(
        &mut self,
        end: Instant,
        impulses: &mut impl Iterator<Item = &'a mut f64>,
    ) {
        self.advance(end);
        for (motor, impulse) in self.motors.iter_mut().zip(impulses) {
            *impulse = motor.impulse_until(end);
        }
    }

    /// Sets each motor's shaft to one of `shafts`.
    pub(crate) fn set_shafts<'a>(&mut self, shafts: &mut impl Iterator<Item = &'a Shaft>) {
        self.motors.iter_mut().zip(shafts).for_each(|(motor, shaft)| motor.set_shaft(*shaft));
    }

    /// Returns the bit rate of frames on the wire, bit/s.
    fn wire_bitrate(&self) -> u32 {
        self.settings.wire_bitrate.unwrap_or(self.settings.bitrate)
    }

    fn arrive(&mut self, at: Instant, content: Content) {
        if self.arrivals.len() < self.settings.rx_queue {
            self.arrivals.push_back(Arrival { at, content });
        } else {
            self.lost = self.lost.saturating_add(1);
        }
    }

    /// Executes all events due by `to`.
    fn advance(&mut self, to: Instant) {
        if !core::mem::replace(&mut self.begun, true) {
            self.motors.iter_mut().for_each(|motor| motor.begin(to));
            self.imus.iter_mut().for_each(|imu| imu.begin(to));
        }
        for _ in 0..TRANSFERS_MAX {
            self.emit(to);
            self.emit_reports(to);
            if self.wire.is_none() {
                self.arbitrate(to);
            }
            let Some(transfer) = self.wire.filter(|transfer| transfer.ends <= to) else { break };
            self.wire = None;
            self.now = self.now.max(transfer.ends);
            self.complete(transfer);
        }
        self.now = self.now.max(to);
    }

    /// Lets each motor that reports by itself contend for the wire, when its last frame was sent.
    fn emit_reports(&mut self, to: Instant) {
        for index in 0..self.motors.len() {
            if self.motors[index].report_due() <= to
                && !self.answers.has(Sender::Motor(index))
                && let Some((at, report)) = self.motors[index].take_due_report(self.now, to)
            {
                self.answer(index, at, report);
            }
        }
    }

    /// Lets each IMU whose sample is due by `to` contend for the wire, when its last one was sent.
    fn emit(&mut self, to: Instant) {
        for index in 0..self.imus.len() {
            let sender = Sender::Imu(index);
            if self.imus[index].due() > to || self.answers.has(sender) {
                continue;
            }
            let (ready, frames) = self.imus[index].emit();
            for frame in frames.into_iter().flatten() {
                let duration = self.duration(&frame);
                self.answers.admit(Contender { sender, frame, ready, duration }, false, false);
            }
        }
    }

    /// Gives the idle wire to the frame that is ready first by `to`; of several on CAN, to the
    /// lowest id.
    fn arbitrate(&mut self, to: Instant) {
        let Some(first) = self.contenders().map(|contender| contender.ready).min() else { return };
        let start = self.now.max(first);
        if start > to {
            return;
        }
        let ready = self.contenders().filter(|contender| contender.ready <= start);
        let priority = |frame: Frame| (self.settings.medium == Medium::Can).then(|| frame.id());
        let Some(winner) = ready.min_by_key(|contender| (priority(contender.frame), contender.ready)) else {
            return;
        };
        let ends = start + winner.duration;
        // A frame of the host has waited since it was sent, also without an acknowledgement.
        let waited = self.queue.front().filter(|_| winner.sender == Sender::Host);
        let ready = waited.map_or(winner.ready, |frame| frame.ready);
        let is_answer = matches!(winner.sender, Sender::Motor(_));
        let sender = if is_answer && self.collide(&winner, start) {
            Sender::Several
        } else {
            self.withdraw(&winner, start);
            winner.sender
        };
        self.wire = Some(Transfer { sender, frame: winner.frame, ready, ends });
    }

    /// Returns `true` when another motor's answer destroys the winner's.
    fn collide(&mut self, winner: &Contender, start: Instant) -> bool {
        match self.settings.medium {
            Medium::Can => self.answers.collide(winner, start),
            Medium::Serial => self.answers.clash(winner, start),
        }
    }

    fn contenders(&self) -> impl Iterator<Item = Contender> + '_ {
        let host = self.acknowledged_from().and_then(|from| {
            let first = self.queue.front()?;
            Some(Contender { ready: first.ready.max(from), ..*first })
        });
        host.into_iter().chain(self.answers.contenders()).chain(self.flood.map(|flood| flood.contender))
    }

    /// Removes the winner from the waiting frames. A flood contends again one period later.
    fn withdraw(&mut self, winner: &Contender, start: Instant) {
        match winner.sender {
            Sender::Host => {
                self.queue.pop_front();
            }
            Sender::Motor(_) | Sender::Imu(_) => self.answers.withdraw(winner, start),
            Sender::Several => {}
            Sender::Flood => {
                let frame = unexpected_frame(&mut self.random);
                let duration = self.duration(&frame);
                if let Some(Flood { period, contender }) = &mut self.flood {
                    let ready = (contender.ready + *period).max(start);
                    *contender = Contender { frame, duration, ready, ..*contender };
                }
            }
        }
    }

    fn duration(&self, frame: &Frame) -> Duration {
        match self.settings.medium {
            Medium::Can => frame_time(frame, self.wire_bitrate(), self.settings.data_bitrate),
            Medium::Serial => wire_time(SERIAL_FRAME_BITS, self.wire_bitrate()),
        }
    }

    /// Delivers a complete frame to every node except the sender.
    fn complete(&mut self, Transfer { sender, frame, ready, ends }: Transfer) {
        if self.is_disturbed(sender) {
            return self.repeat(Transfer { sender, frame, ready, ends });
        }
        if sender == Sender::Several {
            return self.arrive(ends, DESTROYED);
        }
        let from_host = sender == Sender::Host;
        if from_host && core::mem::take(&mut self.is_passive) {
            self.arrive(ends, Content::Error(controller_report(ControllerState::Active)));
        }
        let direction = if from_host { Direction::ToMotor } else { Direction::ToHost };
        self.record.push(Recorded { ready, at: ends, direction, frame });
        if !from_host && !self.link.is_cut() {
            self.arrive(ends, Content::Frame(frame));
        }
        for index in 0..self.motors.len() {
            if sender == Sender::Motor(index) {
                continue;
            }
            if let Some(reply) = self.motors[index].receive(ends, &frame) {
                self.answer(index, ends, reply);
            }
            if let Some(report) = self.motors[index].take_report(ends) {
                self.answer(index, ends, report);
            }
        }
        for index in 0..self.imus.len() {
            let sender = Sender::Imu(index);
            if let Some((latency, frame)) = self.imus[index].receive(ends, &frame) {
                let duration = self.duration(&frame);
                let contender = Contender { sender, frame, ready: ends + latency, duration };
                self.answers.admit(contender, false, false);
            }
        }
    }

    /// Returns `true` when a motor of another bit rate destroys the frame of `sender`.
    fn is_disturbed(&mut self, sender: Sender) -> bool {
        let others = (0..).zip(&mut self.motors).filter(|(index, _)| sender != Sender::Motor(*index));
        others.fold(false, |disturbed, (_, motor)| motor.disturbs() || disturbed)
    }

    /// Reports a destroyed frame to the host. A host or motor that sent it tries again.
    fn repeat(&mut self, Transfer { sender, frame, ready, ends }: Transfer) {
        let contender = Contender { sender, frame, ready, duration: self.duration(&frame) };
        match sender {
            Sender::Host => self.queue.push_front(contender),
            Sender::Motor(_) | Sender::Imu(_) => self.answers.admit(contender, false, false),
            Sender::Flood | Sender::Several => {}
        }
        if !self.link.is_cut() {
            self.arrive(ends, DESTROYED);
        }
    }

    /// Lets a motor's answer contend for the wire, changed by the motor's faults.
    fn answer(&mut self, index: usize, at: Instant, reply: DelayedReply) {
        let motor = &self.motors[index];
        let impairment = *motor.impairment();
        let (latency, jitter) = (motor.settings().reply_latency, motor.settings().reply_jitter);
        if impairment.loss > 0.0 && self.random.fraction() < impairment.loss {
            return;
        }
        let early = at + latency + reply.after + impairment.delay - jitter;
        let ready = early + (2 * jitter).mul_f64(self.random.fraction());
        let frame = damaged(reply.frame, &impairment, &mut self.random);
        let sender = Sender::Motor(index);
        let contender = Contender { sender, frame, ready: ready.max(at), duration: self.duration(&frame) };
        self.answers.admit(contender, impairment.reorder, impairment.duplicate);
    }

    /// Returns the earliest time of the next arrival, if nothing else is sent. The arrival is never
    /// earlier.
    fn next_arrival(&self) -> Option<Instant> {
        if let Some(arrival) = self.arrivals.front() {
            return Some(arrival.at);
        }
        if self.link.is_cut() {
            return None;
        }
        let waiting = self.contenders().map(|contender| match contender.sender {
            Sender::Host => self.idle_from().max(contender.ready) + contender.duration + self.answer_min(),
            _ => self.wire_free_for(&contender).max(contender.ready) + contender.duration,
        });
        let sending = self.wire.map(|transfer| match transfer.sender {
            Sender::Host => transfer.ends + self.answer_min(),
            _ => transfer.ends,
        });
        // A sample that is not due yet arrives after it is.
        // A motor reports when its last frame was sent.
        let idle =
            self.motors.iter().enumerate().filter(|(index, _)| !self.answers.has(Sender::Motor(*index)));
        let due = self.imus.iter().map(ImuNode::due).chain(idle.map(|(_, motor)| motor.report_due()));
        let due = due.filter(|due| *due < Instant::FAR_FUTURE);
        waiting.chain(sending).chain(due).min()
    }

    fn idle_from(&self) -> Instant {
        self.wire.map_or(self.now, |transfer| transfer.ends)
    }

    /// Returns the time at which the wire is free for `contender`: after the host's frames that
    /// have priority.
    fn wire_free_for(&self, contender: &Contender) -> Instant {
        let blocked = self.settings.medium == Medium::Serial || self.acknowledged_from().is_none();
        let urgent = self.queue.iter().take_while(|queued| queued.frame.id() < contender.frame.id());
        let before = if blocked { Duration::ZERO } else { urgent.map(|queued| queued.duration).sum() };
        self.idle_from() + before
    }

    /// Returns the shortest time from the end of a command to the end of its answer.
    fn answer_min(&self) -> Duration {
        let latency =
            |motor: &Motor| motor.settings().reply_latency.saturating_sub(motor.settings().reply_jitter);
        let motors = self.motors.iter().map(latency);
        let latency = motors.chain(self.imus.iter().map(|_| ImuNode::latency())).min();
        let latency = latency.unwrap_or(Duration::ZERO);
        latency + wire_time(unstuffed_bits(IdWidth::Standard, ANSWER_BYTES_MIN), self.wire_bitrate())
    }
}

impl Bus for SimulatedBus {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        self.advance(now);
        let refuse = |refusal| Sent { accepted: 0, refusal: Some(refusal) };
        let capacity = self.settings.tx_queue + self.settings.adapter.unwrap_or(0);
        let space = capacity.saturating_sub(self.queue.len());
        let space = match self.link {
            Link::Down => return refuse(Refusal::Down),
            Link::Gone => return refuse(Refusal::Gone),
            Link::Off => return Sent::all(frames.len()),
            Link::Full { space: left } => space.min(left),
            Link::Up | Link::Unacknowledged => space,
        };
        let accepted = space.min(frames.len());
        for frame in &frames[..accepted] {
            let duration = self.duration(frame);
            let contender = Contender { sender: Sender::Host, frame: *frame, ready: now, duration };
            self.queue.push_back(contender);
        }
        let waits = self.settings.adapter.is_some() && self.acknowledged_from().is_none_or(|from| from > now);
        if waits && accepted > 0 && !core::mem::replace(&mut self.is_passive, true) {
            self.report(controller_report(ControllerState::Passive));
        }
        Sent { accepted, refusal: (accepted < frames.len()).then_some(Refusal::Full) }
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        self.advance(now);
        for motor in &mut self.motors {
            motor.advance(now);
        }
        inbox.lost = inbox.lost.saturating_add(core::mem::take(&mut self.lost));
        while inbox.free() > 0
            && let Some(arrival) = self.arrivals.pop_front_if(|arrival| arrival.at <= now)
        {
            if inbox.push(arrival).is_err() {
                break;
            }
        }
    }

    /// A frame on the wire is not taken back.
    fn discard_queue(&mut self) -> bool {
        self.queue.clear();
        true
    }

    fn readiness(&self) -> Readiness<'_> {
        self.next_arrival().map_or(Readiness::Never, Readiness::At)
    }
}

impl Link {
    /// Returns `true` when the host takes no part in the bus.
    fn is_cut(self) -> bool {
        matches!(self, Self::Off | Self::Down | Self::Gone)
    }
}

fn controller_report(state: ControllerState) -> ErrorFrame {
    let (class, detail) = match state {
        // Byte 1 of CAN_ERR_CRTL in linux/can/error.h: active, warning for TX, passive for TX.
        ControllerState::Active => (ErrorFrame::CONTROLLER, 0x40),
        ControllerState::Warning => (ErrorFrame::CONTROLLER, 0x08),
        ControllerState::Passive => (ErrorFrame::CONTROLLER, 0x20),
        ControllerState::Off => (ErrorFrame::BUS_OFF, 0x00),
    };
    ErrorFrame { class, data: [0, detail, 0, 0, 0, 0, 0, 0] }
}

fn unexpected_frame(random: &mut Random) -> Frame {
    let id = UNEXPECTED_ID | (random.next() & 0xF) as u16;
    Frame::classic(FrameId::new(id).unwrap_or(FrameId::MAX), random.next().to_le_bytes())
}

fn damaged(frame: Frame, impairment: &Impairment, random: &mut Random) -> Frame {
    let mut bytes = [0; Frame::LEN_MAX];
    let mut len = frame.payload().len();
    bytes[..len].copy_from_slice(frame.payload());
    if impairment.garbage {
        let garbage = random.next().to_le_bytes();
        bytes.chunks_mut(garbage.len()).for_each(|chunk| chunk.copy_from_slice(&garbage[..chunk.len()]));
    }
    if impairment.short {
        len = len.saturating_sub(2);
    }
    Frame::with_format(frame.id(), frame.format(), &bytes[..len]).unwrap_or(frame)
}
