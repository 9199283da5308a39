//! The interface between a family and the drive of one motor.

use super::{Command, JointSide, Measured, Question, Reported, Shape, Status, Transmission};
use crate::execution_time::ExecutionTime;
use crate::profile::Profile;
use crate::scale::Scales;
use motord_bus::arithmetic::FrameLength;
use motord_bus::{Duration, Format, Frame, FrameId, Instant};

/// The settings of a motor that its dialect uses.
#[derive(Debug, Clone, Copy)]
pub struct DriveSettings {
    /// Its id.
    pub id: u8,
    /// The id of its replies, or the part of it that names the host.
    pub host_id: FrameId,
    /// The facts of its vendor.
    pub profile: &'static Profile,
    /// The scales of its codes.
    pub scales: Scales,
    /// Rotor turns per turn of the output shaft.
    pub gear_ratio: f32,
    /// Direction and offset of the joint on its motor.
    pub transmission: Transmission,
    /// Largest velocity of the joint, rad/s, and its largest torque, N·m.
    pub limits: [f32; 2],
    /// The code of its position wraps round at the ends.
    pub wraps: bool,
    /// Duration of each control command, where commands have one.
    pub duration: ExecutionTime,
    /// Carry the rounding errors of torque and velocity from frame to frame.
    pub error_feedback: bool,
}

/// A frame that arrived from a motor.
#[derive(Debug, Clone, Copy)]
pub struct Arrived<'f> {
    /// Its id, of 11 or 29 bits.
    pub id: FrameId,
    /// Classic, or CAN FD.
    pub format: Format,
    /// Its payload.
    pub payload: &'f [u8],
    /// When it was complete.
    pub at: Instant,
}

impl<'f> Arrived<'f> {
    /// The frame that arrived `at` this time.
    #[must_use]
    #[inline(always)]
    pub fn new(frame: &'f Frame, at: Instant) -> Self {
        Self { id: frame.id(), format: frame.format(), payload: frame.payload(), at }
    }
}

/// One motor in the words of its family. No method allocates, blocks or loops.
pub trait Dialect {
    /// Writes the frame for `command`, and returns what the reply to it contains; `None` where the
    /// motor is sent no frame.
    fn encode(&mut self, command: &Command, frame: &mut Frame) -> Option<Question>;

    /// Returns the shape of a frame that arrived while `open` is open, and that can answer it by its
    /// time. It may be late.
    /// Distinguishes a continuation of the motion from a plain reply only while a fault request is
    /// open.
    fn classify(&self, arrived: Arrived<'_>, open: Option<Question>) -> Shape;

    /// Takes a frame of a known shape as the answer to `question`, `latency` after that was sent.
    fn accept(&mut self, arrived: Arrived<'_>, question: Question, latency: Duration) -> Reported;

    /// Takes a frame whose shape is [`Plain`](Shape::Plain) as the state that was asked for. `None`,
    /// without a change, for any other frame, and from a dialect whose states [`accept`] takes.
    ///
    /// [`accept`]: Self::accept
    fn accept_state(&mut self, _arrived: Arrived<'_>) -> Option<(Measured<JointSide>, Status)> {
        None
    }

    /// Takes a frame that may be a fault report or a late state.
    fn accept_ambiguous(&mut self, _arrived: Arrived<'_>) -> Reported {
        Reported::Alive
    }

    /// Takes a frame whose shape is [`Unprompted`](Shape::Unprompted).
    fn accept_unprompted(&mut self, _arrived: Arrived<'_>) -> Reported {
        Reported::Unprompted
    }

    /// Takes a register that answers an earlier question.
    fn accept_late_register(&mut self, _arrived: Arrived<'_>) -> Reported {
        Reported::Late
    }

    /// Takes back what it remembers of the last command, whose frame was not sent.
    fn unsent(&mut self) {}

    /// Forgets an ambiguous report: replies are late, so it was probably one of them.
    fn refute(&mut self) {}

    /// Uses these ends of the codes from now on: position, rad, velocity, rad/s, and torque, N·m.
    /// Only for a stopped motor.
    fn use_ends(&mut self, _ends: [f32; 3]) {}
}

/// The methods of [`Dialect`] for an enum with one dialect in each variant.
macro_rules! dispatch {
    ($any:ident { $($family:ident),+ }) => {
        #[inline(always)]
        fn encode(
            &mut self,
            command: &$crate::drive::Command,
            frame: &mut motord_bus::Frame,
        ) -> Option<$crate::drive::Question> {
            match self { $($any::$family(dialect) => dialect.encode(command, frame)),+ }
        }

        #[inline(always)]
        fn classify(
            &self,
            arrived: $crate::drive::Arrived<'_>,
            open: Option<$crate::drive::Question>,
        ) -> $crate::drive::Shape {
            match self { $($any::$family(dialect) => dialect.classify(arrived, open)),+ }
        }

        #[inline(always)]
        fn accept(
            &mut self,
            arrived: $crate::drive::Arrived<'_>,
            question: $crate::drive::Question,
            latency: motord_bus::Duration,
        ) -> $crate::drive::Reported {
            match self { $($any::$family(dialect) => dialect.accept(arrived, question, latency)),+ }
        }

        #[inline(always)]
        fn accept_state(
            &mut self,
            arrived: $crate::drive::Arrived<'_>,
        ) -> Option<($crate::drive::Measured<$crate::drive::JointSide>, $crate::drive::Status)> {
            match self { $($any::$family(dialect) => dialect.accept_state(arrived)),+ }
        }

        #[cold]
        fn accept_ambiguous(&mut self, arrived: $crate::drive::Arrived<'_>) -> $crate::drive::Reported {
            match self { $($any::$family(dialect) => dialect.accept_ambiguous(arrived)),+ }
        }

        #[cold]
        fn accept_unprompted(&mut self, arrived: $crate::drive::Arrived<'_>) -> $crate::drive::Reported {
            match self { $($any::$family(dialect) => dialect.accept_unprompted(arrived)),+ }
        }

        #[cold]
        fn accept_late_register(&mut self, arrived: $crate::drive::Arrived<'_>) -> $crate::drive::Reported {
            match self { $($any::$family(dialect) => dialect.accept_late_register(arrived)),+ }
        }

        #[cold]
        fn unsent(&mut self) {
            match self { $($any::$family(dialect) => dialect.unsent()),+ }
        }

        #[cold]
        fn refute(&mut self) {
            match self { $($any::$family(dialect) => dialect.refute()),+ }
        }

        fn use_ends(&mut self, ends: [f32; 3]) {
            match self { $($any::$family(dialect) => dialect.use_ends(ends)),+ }
        }
    };
}

pub(crate) use dispatch;

/// A frame that a motor sends without a request.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnpromptedFrame {
    /// Its length.
    pub length: FrameLength,
    /// From the factory.
    pub rate_hz: f64,
}
