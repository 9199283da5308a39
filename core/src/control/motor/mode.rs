//! The mode of one motor.
//!
//! ```text
//!              state reported             group starts                  neutral answered, start answered
//!   Offline ───────────────▶ Idle ───────────────────────▶ Starting ───────────────────────────▶ Active
//!      ▲                    ▲    ▲                             │                                    │
//!      │ silent for         │    │ at rest, or long enough     │ group stops                        │ group stops
//!      │ `lost_cycles`      │    └──────────── Damping ◀───────┴────────────────────────────────────┘
//!   (any mode)              │
//!                           └── fault cleared on request ── Fault ◀── fault reported (any mode)
//!
//!   Offline, Idle, Fault ──excluded──▶ Excluded ──included──▶ Offline
//!
//!   Starting:   Neutral(n) ──NEUTRAL_CYCLES──▶ Commanded ──any answer──▶ Answered ──state──▶ Ready
//! ```

use motord_bus::{Duration, Instant};
use motord_protocol::drive::{Command, Impedance, JointSide};
use motord_shared::MotorMode;

/// Neutral commands that a motor receives before it is started.
const NEUTRAL_CYCLES: u32 = 10;
/// Interval between probes of an offline motor.
const PROBE_PERIOD: Duration = Duration::from_millis(100);
/// One of this many probes asks for the fault: a motor in fault may answer nothing else.
const PROBES_PER_FAULT: u32 = 5;

/// Each mode with the data that only it needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Mode {
    /// The motor does not answer.
    Offline(Probe),
    /// An operator or the configuration excludes the motor. It gets only stops: it may still run,
    /// or reconnect.
    Excluded(Probe),
    /// It is stopped.
    Idle,
    /// It is being started.
    Starting(Start),
    /// It follows setpoints.
    Active,
    /// It is damped before it is stopped.
    Damping {
        /// Its position and gains when the stop began, where they were known: a stop that holds
        /// keeps them.
        held: Option<Impedance<JointSide>>,
    },
    /// It reported a fault, and stopped.
    Fault {
        /// The next command asks for the fault.
        queries: bool,
    },
}

/// When an offline motor is probed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Probe {
    next: Instant,
    count: u32,
}

/// The steps between `Idle` and `Active`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Start {
    /// Number of neutral commands that were sent.
    Neutral(u32),
    /// The start command is sent until it is answered.
    Commanded,
    /// It answered the start command.
    Answered,
    /// It answered a later neutral command with a state that does not report "off".
    Ready,
}

impl Mode {
    /// Offline; the first probe, in the next cycle, is a stop: the motor may receive it even where
    /// its replies are lost.
    pub(super) const OFFLINE: Self = Self::Offline(Probe { next: Instant::ZERO, count: 0 });
    pub(super) const EXCLUDED: Self = Self::Excluded(Probe { next: Instant::ZERO, count: 0 });
    pub(super) const STARTING: Self = Self::Starting(Start::Neutral(0));
    pub(super) const FAULT: Self = Self::Fault { queries: false };

    pub(super) const fn code(&self) -> MotorMode {
        match self {
            Self::Offline(_) => MotorMode::Offline,
            Self::Excluded(_) => MotorMode::Excluded,
            Self::Idle => MotorMode::Idle,
            Self::Starting(_) => MotorMode::Starting,
            Self::Active => MotorMode::Active,
            Self::Damping { .. } => MotorMode::Damping,
            Self::Fault { .. } => MotorMode::Fault,
        }
    }

    /// Returns whether it is starting, active or damping.
    pub(super) const fn is_moving(&self) -> bool {
        matches!(self, Self::Starting(_) | Self::Active | Self::Damping { .. })
    }

    /// Returns the command of this cycle in the modes that depend on nothing else. `Active` and
    /// `Damping` depend on their group: for them this is a stop.
    pub(super) fn command(&mut self, now: Instant) -> Command {
        match self {
            Self::Offline(probe) => probe.command(now),
            Self::Excluded(probe) => probe.stop(now),
            Self::Starting(start) => start.command(),
            Self::Fault { queries } => {
                *queries = !*queries;
                if *queries { Command::Stop } else { Command::GetFault }
            }
            Self::Idle | Self::Active | Self::Damping { .. } => Command::Stop,
        }
    }
}

impl Probe {
    /// Makes the next probe due immediately.
    pub(super) const fn hurry(&mut self) {
        self.next = Instant::ZERO;
    }

    /// Makes the next probe due immediately: a question for the fault after a stop, a stop after a
    /// question.
    pub(super) const fn alternate(&mut self) {
        self.next = Instant::ZERO;
        self.count = if self.count == 0 { 0 } else { PROBES_PER_FAULT - 1 };
    }

    fn stop(&mut self, now: Instant) -> Command {
        match self.command(now) {
            Command::Nothing => Command::Nothing,
            _ => Command::Stop,
        }
    }

    fn command(&mut self, now: Instant) -> Command {
        if now < self.next {
            return Command::Nothing;
        }
        self.next = now + PROBE_PERIOD;
        self.count = (self.count + 1) % PROBES_PER_FAULT;
        if self.count == 0 { Command::GetFault } else { Command::Stop }
    }
}

impl Start {
    const fn command(&mut self) -> Command {
        match *self {
            Self::Neutral(NEUTRAL_CYCLES) | Self::Commanded => {
                *self = Self::Commanded;
                Command::Start
            }
            Self::Neutral(sent) => {
                *self = Self::Neutral(sent + 1);
                Command::Neutral
            }
            Self::Answered | Self::Ready => Command::Neutral,
        }
    }

    /// Returns whether the start command was answered.
    pub(super) const fn is_answered(self) -> bool {
        matches!(self, Self::Answered | Self::Ready)
    }

    /// Records an answer; `is_on`: with a state that does not report "off".
    pub(super) const fn answered(&mut self, is_on: bool) {
        *self = match *self {
            Self::Commanded => Self::Answered,
            Self::Answered if is_on => Self::Ready,
            start => start,
        };
    }
}
