//! Errors of transactions.

use core::fmt;
use motord_bus::FrameId;

/// Reason for which a motor refused a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MotorRefusal {
    /// The result code of the motor.
    pub code: u8,
    /// The vendor's term.
    pub reason: &'static str,
}

impl fmt::Display for MotorRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the motor refused: {} (RES {:#04X})", self.reason, self.code)
    }
}

/// Reason for which a transaction failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// No answer arrived.
    #[error("motor {id} does not answer `{request}`")]
    Silent {
        /// The id of the request.
        id: u8,
        /// The request, by the document's name.
        request: &'static str,
    },
    /// The motor refused, with a result code (GIM document, Table 5).
    #[error("motor {id}, {request}: {refusal}")]
    Refused {
        /// The motor.
        id: u8,
        /// The request, by the document's name.
        request: &'static str,
        /// The vendor's term, and the code.
        refusal: MotorRefusal,
    },
    /// The motor answered with an ACK frame: the request was damaged on the line (GIM document,
    /// Table 3).
    #[error("motor {id} could not read `{request}` (ACK frame): check wiring, termination and bit rate")]
    NotRead {
        /// The motor.
        id: u8,
        /// The request, by the document's name.
        request: &'static str,
    },
    /// The bus accepted no frame.
    #[error("the bus accepts no frame: {}", reason(*.0))]
    Bus(motord_bus::Refusal),
    /// A written value reads back as another one.
    #[error("motor {id}: {item} reads {read} after {written} was written")]
    NotKept {
        /// The motor.
        id: u8,
        /// The item's name.
        item: &'static str,
        /// The value that was written.
        written: f64,
        /// The value that was read back.
        read: f64,
    },
    /// A value was sent, and no motor answers at the address that the motor should now have.
    #[error(
        "motor {id} does not answer after {item} {written} was sent: it may have the old or the new value; find it with `motorctl scan`"
    )]
    Unconfirmed {
        /// The motor, by the id that it should now have.
        id: u8,
        /// The item's name.
        item: &'static str,
        /// The value that was sent.
        written: f64,
    },
    /// A written parameter reads back as another value.
    #[error("motor {id}: parameter {item} reads {read} after {written} was written")]
    ParameterNotKept {
        /// The motor.
        id: u8,
        /// The parameter's name, or its number.
        item: u8,
        /// The value that was written.
        written: u32,
        /// The value that was read back.
        read: u32,
    },
    /// The bus carries frames that this process did not request: another host may be commanding its
    /// motors.
    #[error("another program uses this bus: received frames with id {id} ({count} in total); stop that program first", id = format_args!("{:#05X}", .id.raw()))]
    InUse {
        /// The id of the first of them.
        id: FrameId,
        /// Number of such frames.
        count: usize,
    },
    /// A motor reports without a request, and no other process commands it: RobStride's active
    /// report.
    #[error(
        "motor {motor} reports without a request: received {count} frames with id {id}, and no command; turn its reports off (RobStride: active report, F9), then try again",
        id = format_args!("{:#05X}", .id.raw())
    )]
    Reports {
        /// The motor, by the first byte of its frames.
        motor: u8,
        /// The id of the frames.
        id: FrameId,
        /// Number of such frames.
        count: usize,
    },
    /// Another motor already has the new id of this motor.
    #[error("motor {id}: a motor with id {taken} is on this bus already")]
    Taken {
        /// The motor.
        id: u8,
        /// The id of the other one.
        taken: u8,
    },
    /// A value is one that no motor has: it may be in another unit.
    #[error("motor {id}: {}", implausible(.item, .unit, *.range, *.value, *.meant))]
    Implausible {
        /// The motor.
        id: u8,
        /// The item's name.
        item: &'static str,
        /// The unit of value and range; empty for a plain number.
        unit: &'static str,
        /// The values that a motor may have, both ends included.
        range: Option<(f32, f32)>,
        /// The value that was to be written.
        value: f64,
        /// The nearest value that may have been meant.
        meant: Option<f64>,
    },
    /// The motor's protocol does not support the command.
    #[error("motor {id}: {reason}")]
    Protocol {
        /// The motor.
        id: u8,
        /// A sentence with a remedy.
        reason: &'static str,
    },
    /// The caller cancelled the transaction.
    #[error("interrupted")]
    Interrupted,
}

impl Error {
    /// A value of a command to motor `id` has no code.
    pub(crate) const fn not_finite(id: u8) -> Self {
        Self::Protocol { id, reason: "a value of the command is not a finite number" }
    }
}

/// Returns the sentence for a value that no motor has.
fn implausible(item: &str, unit: &str, range: Option<(f32, f32)>, value: f64, meant: Option<f64>) -> String {
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    let range =
        range.map_or_else(String::new, |(least, most)| format!(": a motor has {least} to {most}{unit}"));
    let meant = meant.map_or_else(String::new, |meant| format!("; did you mean {}?", meant as f32));
    format!("{item} {}{unit} is not written{range}{meant}", value as f32)
}

fn reason(refusal: motord_bus::Refusal) -> String {
    match refusal {
        motord_bus::Refusal::Full => {
            "its queue stays full; no motor acknowledges, or the port is blocked".into()
        }
        motord_bus::Refusal::Down => "it is down".into(),
        motord_bus::Refusal::Gone => "it is unplugged".into(),
        motord_bus::Refusal::Error(errno) => format!("system error {errno}"),
    }
}
