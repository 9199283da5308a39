//! The state of a bus: one table of counters, from which the message and the client library come.

use crate::plain::plain;

/// Calls the macro `$with` with the counters of a bus, in the order of the memory.
#[macro_export]
macro_rules! bus_counters {
    ($with:ident) => {
        $with! {
            /// Frames that the bus accepted.
            sent;
            /// Frames that the bus did not accept.
            dropped;
            /// Frames received, of any kind.
            received;
            /// Frames of any kind whose id or first byte belongs to no motor of this bus, and
            /// commands to its motors that motord did not send. The kernel filters most of the
            /// former on a CAN interface. The daemon counts the filtered frames outside the
            /// real-time thread, some 50 ms late.
            unexpected_id;
            /// Replies without a request, including second answers to one request.
            duplicate;
            /// Frames that no motor of this bus sends: unsupported frames, and those with the id of
            /// a motor that are no valid reply.
            malformed;
            /// Error frames.
            errors;
            /// Frames that were lost before they could be read: by the kernel, whose buffer was
            /// full, and by the CAN controller, at least one for each overrun that it reports
            /// (`CAN_ERR_CRTL_RX_OVERFLOW`).
            lost;
        }
    };
}

macro_rules! define {
    ($($(#[doc = $doc:literal])+ $counter:ident;)+) => {
        plain! {
            /// One bus in a cycle. All counters are modulo 2³².
            #[derive(Eq)]
            pub struct BusState {
                /// `BusCondition` code.
                pub condition: u32,
                $($(#[doc = $doc])+ pub $counter: u32,)+
            }
        }
    };
}

bus_counters!(define);
