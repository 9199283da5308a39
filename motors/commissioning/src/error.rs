//! Why a transaction failed.

use motord_bus::FrameId;
use motord_protocol::gim::{Refusal, Value};

/// Why a transaction failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// No answer came.
    #[error("motor {id} does not answer `{request}`")]
    Silent {
        /// The id that was asked.
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
        /// The vendor's word, and the code.
        refusal: Refusal,
    },
    /// The motor answered with an ACK frame: the request was damaged on the line (GIM document, Table 3).
    #[error("motor {id} could not read `{request}` (ACK frame): check wiring, termination and bit rate")]
    NotRead {
        /// The motor.
        id: u8,
        /// The request, by the document's name.
        request: &'static str,
    },
    /// The bus took no frame.
    #[error("the bus takes no frame: {}", reason(*.0))]
    Bus(motord_bus::Refusal),
    /// A value that was written reads back as another one.
    #[error("motor {id}: {item} reads {read} after {written} was written", written = .written.as_f64(), read = .read.as_f64())]
    NotKept {
        /// The motor.
        id: u8,
        /// The item's name.
        item: &'static str,
        /// The value that was written.
        written: Value,
        /// The value that was read afterwards.
        read: Value,
    },
    /// A value was sent, and nobody answers where the motor should be now.
    #[error("motor {id} does not answer after {item} {written} was sent: it may have the old value or the new one; `motorctl scan` shows where it answers", written = .written.as_f64())]
    Unconfirmed {
        /// The motor, by the id that it should have now.
        id: u8,
        /// The item's name.
        item: &'static str,
        /// The value that was sent.
        written: Value,
    },
    /// A parameter that was written reads back as another one.
    #[error("motor {id}: parameter {item} reads {read} after {written} was written")]
    ParameterNotKept {
        /// The motor.
        id: u8,
        /// The parameter's name, or its number.
        item: u8,
        /// The value that was written.
        written: u32,
        /// The value that was read afterwards.
        read: u32,
    },
    /// The bus carries frames that nobody here asked for: another host may be driving its motors.
    #[error("somebody else uses this bus: frames with id {id} were heard ({count} in total); stop that program first", id = format_args!("{:#05X}", .id.raw()))]
    InUse {
        /// The id of the first of them.
        id: FrameId,
        /// How many there were.
        count: usize,
    },
    /// Another motor has the id that this one was to get.
    #[error("motor {id}: a motor with id {taken} is on this bus already")]
    Taken {
        /// The motor.
        id: u8,
        /// The id of the other one.
        taken: u8,
    },
    /// The protocol of a motor decides what it understands.
    #[error("motor {id}: {reason}")]
    Protocol {
        /// The motor.
        id: u8,
        /// A sentence with a way out.
        reason: &'static str,
    },
    /// The caller asked to end.
    #[error("interrupted")]
    Interrupted,
}

fn reason(refusal: motord_bus::Refusal) -> String {
    match refusal {
        motord_bus::Refusal::Full => {
            "its queue stays full; no motor acknowledges, or the port is blocked".into()
        }
        motord_bus::Refusal::Down => "it is down".into(),
        motord_bus::Refusal::Gone => "it is gone".into(),
        motord_bus::Refusal::Error(errno) => format!("error {errno} of the system"),
    }
}
