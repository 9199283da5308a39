//! The protocols that a motor may speak over CAN: one row for each, and a file in `motor`.

use motord_bus::{Frame, FrameId, IdFilter, IdSet};

/// Bytes of every command of MIT and GIM, and of every request to a register.
const COMMAND_BYTES: usize = 8;

/// Defines the dialects. A row has the documentation, the name in Rust, the name in configurations,
/// the number in the memory of a drive (GIM document, table 7, ConfID 0x1C), the ids of the
/// commands to a motor with an id, and the function that tells whether a frame has the form of a
/// command.
macro_rules! dialects {
    ($($(#[$doc:meta])* $dialect:ident = $name:literal, $number:literal, $commands:expr, $is_formed:expr);+ $(;)?) => {
        /// The protocol of a motor over CAN. A serial line is always native.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Dialect {
            $($(#[$doc])* $dialect),+
        }

        impl Dialect {
            /// Returns the dialect with this name.
            #[must_use]
            pub fn by_name(name: &str) -> Option<Self> {
                match name {
                    $($name => Some(Self::$dialect),)+
                    _ => None,
                }
            }

            /// Returns the dialect with this number, and MIT for an unknown number.
            pub(crate) const fn by_number(number: i32) -> Self {
                match number {
                    $($number => Self::$dialect,)+
                    _ => Self::Mit,
                }
            }

            /// Returns its number in the memory of a drive.
            pub(crate) const fn number(self) -> i32 {
                match self {
                    $(Self::$dialect => $number),+
                }
            }

            /// Returns the ids of the commands to the motor with this id.
            pub(crate) fn commands(self, id: FrameId) -> IdSet {
                match self {
                    $(Self::$dialect => $commands(id).into()),+
                }
            }

            /// Returns whether `frame` has the form of a command: format and length.
            pub(crate) fn is_formed(self, frame: &Frame) -> bool {
                match self {
                    $(Self::$dialect => $is_formed(frame)),+
                }
            }
        }
    };
}

/// Returns whether `frame` is a classic frame of eight bytes.
pub(crate) fn is_classic_command(frame: &Frame) -> bool {
    frame.is_classic() && frame.payload().len() == COMMAND_BYTES
}

/// Returns the ids of 29 bits whose lowest byte is this `id`.
fn to_receiver(id: FrameId) -> IdFilter {
    IdFilter::masked(FrameId::extended(id.raw()).unwrap_or(FrameId::MAX_EXTENDED), 0xFF)
}

/// Returns the ids of the node with this `id`.
fn to_node(id: FrameId) -> IdFilter {
    let first = FrameId::new((id.raw() as u16 & 0x3F) << 5);
    IdFilter::masked(first.unwrap_or(FrameId::MAX), 0x7E0)
}

/// Returns the ids of the commands to a MyActuator motor, and of those to all of them.
fn to_motor(id: FrameId) -> IdSet {
    let number = id.raw() as u16 & 0x3F;
    let exact = |raw| IdFilter::exact(FrameId::new(raw).unwrap_or(FrameId::MAX));
    IdSet::of_four([0x400 + number, 0x140 + number, 0x280, 0x300].map(exact))
}

dialects! {
    /// The MIT protocol.
    Mit = "mit", 1, IdFilter::exact, is_classic_command;
    /// The native GIM protocol.
    Gim = "gim", 0, IdFilter::exact, is_classic_command;
    /// RobStride's private protocol. The lowest byte of an id names the receiver.
    RobStride = "robstride", 2, to_receiver, is_classic_command;
    /// The CANSimple dialect. An id has the node above the command.
    CanSimple = "cansimple", 3, to_node, is_classic_command;
    /// MyActuator's protocol. An id is that of the motor, and a number for the kind of the frame.
    MyActuator = "myactuator", 4, to_motor, is_classic_command;
    /// ODrive's CANSimple of firmware 0.6.
    ODrive = "odrive", 5, to_node, Frame::is_classic;
}
