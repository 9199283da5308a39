//! The protocols that a motor may speak over CAN: one row for each, and a file in `motor`.

use motord_bus::{FrameId, IdFilter};

/// Defines the dialects. A row has the documentation, the name in Rust, the name in configurations, the number in the
/// memory of a drive (GIM document, table 7, ConfID 0x1C), and the ids of the commands to a motor with an id.
macro_rules! dialects {
    ($($(#[$doc:meta])* $dialect:ident = $name:literal, $number:literal, $commands:expr);+ $(;)?) => {
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
            pub(crate) fn commands(self, id: FrameId) -> IdFilter {
                match self {
                    $(Self::$dialect => $commands(id)),+
                }
            }
        }
    };
}

dialects! {
    /// The MIT protocol.
    Mit = "mit", 1, IdFilter::exact;
    /// The native GIM protocol.
    Gim = "gim", 0, IdFilter::exact;
}
