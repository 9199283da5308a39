//! Events of the cycle for the log: codes, never text. The telemetry thread writes the text.

use motord_bus::Duration;
use motord_settings::settings::REGISTERS_MAX;
use motord_shared::{BusCondition, Cause, MotorMode, Phase};

/// An event for the log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event {
    /// A motor changed its mode.
    Motor {
        /// Its index.
        motor: usize,
        /// The new one.
        mode: MotorMode,
    },
    /// A motor has never answered, well after the start.
    Silent {
        /// Its index.
        motor: usize,
    },
    /// Frames with the command id of a motor arrive that motord did not send. Reported at most
    /// every 10 s.
    Foreign {
        /// Its index.
        motor: usize,
        /// The command id.
        id: u32,
        /// Number of such frames since the start.
        frames: u32,
    },
    /// The position of a motor differs from that before it was silent by whole turns, or by more than
    /// the joint can have moved.
    LostTurns {
        /// Its index.
        motor: usize,
        /// The difference at its joint, mrad.
        milliradians: i32,
    },
    /// All answers of a motor came too late by the same time, or a late motor answers in time
    /// again.
    Late {
        /// Its index.
        motor: usize,
        /// The lateness in turns of the motor; 0 when it answers in time again.
        turns: u32,
        /// The lateness.
        time: Duration,
    },
    /// The registers of a motor were read, for the first time or with other values than before.
    Registers {
        /// Its index.
        motor: usize,
        /// Their values, by number.
        values: [f32; REGISTERS_MAX],
        /// The first with which its group may not start.
        wrong: Option<u8>,
    },
    /// A motor does not report its registers. Reported once in a silence.
    Unread {
        /// Its index.
        motor: usize,
        /// Its group may start with the values that the configuration has.
        is_assumed: bool,
    },
    /// A motor reported fault bits, or that they are cleared.
    Fault {
        /// Its index.
        motor: usize,
        /// The bits; 0 when they are cleared.
        bits: u32,
    },
    /// A group changed its phase.
    Group {
        /// Its index.
        group: usize,
        /// The new one.
        phase: Phase,
    },
    /// The setpoints of a group timed out. Its stop follows.
    SetpointPeriod {
        /// The group's index.
        group: usize,
        /// Mean time between two messages of its owner.
        period: Duration,
        /// Horizon of the last message.
        horizon: Duration,
    },
    /// A group was stopped for a cause, which is latched.
    Stopped {
        /// Its index.
        group: usize,
        /// Why.
        cause: Cause,
        /// The motor that gave the cause.
        motor: Option<usize>,
        /// Id of the process that asked for it.
        pid: Option<u32>,
    },
    /// The latched cause of a group was reset.
    Reset {
        /// The group's index.
        group: usize,
    },
    /// A group has a new owner, or no owner any more.
    Owner {
        /// The group's index.
        group: usize,
        /// The owner's process id; `None` when there is no owner any more.
        pid: Option<u32>,
    },
    /// The condition of a bus changed.
    Bus {
        /// Its index.
        bus: usize,
        /// The new one.
        condition: BusCondition,
    },
    /// Frames that a bus received were lost. Reported at most once a second.
    FramesLost {
        /// The index of the bus.
        bus: usize,
        /// All since the last such event.
        losses: Losses,
    },
    /// A sensor is lost, or delivers samples again.
    Sensor {
        /// Its index among the sensors of every kind.
        sensor: usize,
        /// It is lost.
        is_lost: bool,
    },
    /// A rest showed that orientation and acceleration of an IMU contradict each other, or agree
    /// again.
    Gravity {
        /// Its index.
        imu: usize,
        /// Bits of `motord_shared::ImuContradiction`; 0 when they agree.
        contradictions: u32,
        /// Direction up by the orientation, in the frame of the body.
        up: [f32; 3],
        /// Mean acceleration, in the frame of the body, m/s².
        acceleration: [f32; 3],
    },
    /// The supply of a group is low, or no longer.
    Supply {
        /// The group's index.
        group: usize,
        /// The motor whose report decided.
        motor: usize,
        /// The voltage that it reported, V.
        voltage: f32,
        /// It is low.
        is_low: bool,
    },
    /// Ticks were missed: the cycle thread woke up too late for them.
    MissedTicks {
        /// Their number.
        missed_ticks: u64,
    },
}

/// Least time between two events of lost frames of a bus, and longest time in which a loss explains
/// a silent motor.
pub(super) const LOSS_TIME: Duration = Duration::from_secs(1);

/// Frames that were lost before they could be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Losses {
    /// Overruns that the CAN controller reported. Each lost at least one frame.
    pub by_controller: u32,
    /// Frames that the kernel dropped: the buffer of the socket was full.
    pub by_kernel: u32,
}

impl Losses {
    /// None.
    pub const NONE: Self = Self { by_controller: 0, by_kernel: 0 };

    /// Returns whether there are any.
    #[must_use]
    pub const fn any(self) -> bool {
        self.by_controller > 0 || self.by_kernel > 0
    }

    pub(super) const fn add(&mut self, more: Self) {
        self.by_controller = self.by_controller.saturating_add(more.by_controller);
        self.by_kernel = self.by_kernel.saturating_add(more.by_kernel);
    }
}

/// The events of one cycle. Fixed size: events that do not fit are counted.
#[derive(Debug, Clone)]
pub struct Events {
    events: [Option<Event>; Events::CAPACITY],
    len: usize,
    dropped: u32,
}

impl Events {
    /// Most events of one cycle: every motor and group may change in the same cycle.
    pub const CAPACITY: usize = 160;

    /// Creates an empty list.
    #[must_use]
    pub const fn new() -> Self {
        Self { events: [None; Self::CAPACITY], len: 0, dropped: 0 }
    }

    /// Adds an event, or counts it when there is no room.
    pub fn push(&mut self, event: Event) {
        match self.events.get_mut(self.len) {
            Some(entry) => {
                *entry = Some(event);
                self.len += 1;
            }
            None => self.dropped = self.dropped.saturating_add(1),
        }
    }

    /// Returns the events in their order.
    pub fn iter(&self) -> impl Iterator<Item = Event> + '_ {
        self.events[..self.len].iter().flatten().copied()
    }

    /// Removes the events. Returns the number that did not fit.
    pub fn clear(&mut self) -> u32 {
        self.len = 0;
        core::mem::take(&mut self.dropped)
    }
}

impl Default for Events {
    fn default() -> Self {
        Self::new()
    }
}
