//! The families of motors: one row for each protocol that a motor may be configured for.
//!
//! A family is one folder of this crate. It holds the codec, the [`Family`] with the facts that
//! other crates ask for and, with the features `drive` and `commissioning`, the dialect that a
//! cycle speaks and the transactions.

#[cfg(feature = "drive")]
use crate::drive::{Dialect, DriveSettings, dispatch};
use crate::family::Family;
use core::str::FromStr;

/// Defines the protocols, and dispatches to the folder of each. A row has the documentation, the
/// name in Rust, the folder, and the dialect in it.
macro_rules! families {
    ($($(#[$doc:meta])* $protocol:ident = $folder:ident :: $dialect:ident),+ $(,)?) => {
        /// Protocol that a motor is configured for.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum MotorProtocol {
            $($(#[$doc])* $protocol),+
        }

        /// Every family: its name in configurations and on command lines, and its protocol. The
        /// usual one is first.
        pub const FAMILIES: &[(&str, MotorProtocol)] =
            &[$((crate::$folder::FAMILY.name, MotorProtocol::$protocol)),+];

        impl MotorProtocol {
            /// Returns the facts of its family.
            #[must_use]
            pub const fn family(self) -> &'static Family {
                match self {
                    $(Self::$protocol => &crate::$folder::FAMILY),+
                }
            }
        }

        /// The dialect of one motor, of any family.
        #[cfg(feature = "drive")]
        #[derive(Debug)]
        pub enum AnyDialect {
            $($(#[$doc])* $protocol(crate::$folder::$dialect)),+
        }

        #[cfg(feature = "drive")]
        impl AnyDialect {
            /// Does not allocate.
            #[must_use]
            pub fn new(protocol: MotorProtocol, settings: &DriveSettings) -> Self {
                match protocol {
                    $(MotorProtocol::$protocol => Self::$protocol(crate::$folder::$dialect::new(settings))),+
                }
            }
        }

        /// Calls the method of the family: a match on the family, and no call by pointer.
        #[cfg(feature = "drive")]
        impl Dialect for AnyDialect {
            dispatch!(AnyDialect { $($protocol),+ });
        }
    };
}

families! {
    /// MIT over CAN.
    Mit = mit::MitDialect,
    /// SteadyWin's GIM protocol, over CAN, RS485 or RS232.
    Gim = gim::GimDialect,
    /// RobStride's private protocol, over CAN.
    RobStride = robstride::RobStrideDialect,
    /// The CANSimple dialect of SteadyWin's SDC104, GDS68 and GDZ drivers, over CAN.
    CanSimple = cansimple::CanSimpleDialect,
    /// MyActuator's protocol of the RMD series, over CAN.
    MyActuator = myactuator::MyActuatorDialect,
    /// ODrive's CANSimple of firmware 0.6, over CAN.
    ODrive = odrive::ODriveDialect,
}

impl Default for MotorProtocol {
    /// The usual one: most vendors have no other.
    fn default() -> Self {
        FAMILIES[0].1
    }
}

impl FromStr for MotorProtocol {
    type Err = ();

    fn from_str(name: &str) -> Result<Self, ()> {
        FAMILIES.iter().find(|(known, _)| *known == name).map(|(_, protocol)| *protocol).ok_or(())
    }
}

impl MotorProtocol {
    /// Returns its name in configurations and on command lines.
    #[must_use]
    pub const fn name(self) -> &'static str {
        self.family().name
    }
}

#[cfg(test)]
mod tests {
    use crate::profile::{DAMIAO, STEADYWIN};
    use crate::scale::{Ends, Scales};
    use crate::{gim, mit};

    #[test]
    fn capabilities_follow_vendor_and_protocol() {
        let scales = Scales::of(&Ends::new(12.5, 30.0, 10.0));
        let abilities = (mit::FAMILY.capabilities)(&STEADYWIN, &scales);
        assert!(abilities.impedance && abilities.answers_fault_question && abilities.state_confirms_stop);
        assert_eq!((abilities.position_end, abilities.velocity_end), (Some(12.5), Some(30.0)));
        assert!(!(mit::FAMILY.capabilities)(&DAMIAO, &scales).answers_fault_question);
        let native = (gim::FAMILY.capabilities)(&STEADYWIN, &scales);
        assert!(!native.impedance && !native.state_confirms_stop && native.indicators > 0);
    }
}
