//! CAN interfaces of Linux.

use super::access::Transport;

/// A CAN interface of Linux.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SocketCan {
    /// The interface, `can0`.
    pub interface: String,
    /// Bit/s.
    pub bitrate: u32,
}

impl SocketCan {
    /// Its type in configurations.
    pub const NAME: &'static str = "socketcan";
}

impl Transport for SocketCan {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn bitrate(&self) -> u32 {
        self.bitrate
    }

    /// A virtual interface has no wire.
    fn has_wire_time(&self) -> bool {
        false
    }

    fn interface(&self) -> Option<&str> {
        Some(&self.interface)
    }

    #[cfg(feature = "linux")]
    fn hardware(&self) -> Option<&dyn super::access::Hardware> {
        Some(self)
    }
}

#[cfg(feature = "linux")]
mod linux {
    use super::super::access::{
        Cause, Hardware, MotorsBus, MotorsEnd, Nodes, OpenError, Opened, OpenedAsIs, OpenedSender, SendingBus,
    };
    use super::SocketCan;
    use crate::socketcan::{self, InterfaceName, Link, Sender, Settings, SocketCanBus};
    use crate::{BusLock, ErrorFrame, Holder, IdFilter, Identity, Sent};

    impl SocketCan {
        /// Returns the interface with this name. A tool does not set its bit rate.
        pub(in super::super) fn at(address: &str, bitrate: u32) -> Option<Self> {
            let name = address.parse::<InterfaceName>().ok()?;
            Some(Self { interface: name.to_string(), bitrate })
        }

        fn interface_name(&self) -> Result<InterfaceName, OpenError> {
            let interface = &self.interface;
            let refused = |_| {
                let reason = format!("`{interface}` is no interface name: use one that `ip link` lists");
                OpenError::new(Cause::Other, reason)
            };
            interface.parse().map_err(refused)
        }
    }

    impl Hardware for SocketCan {
        fn lock(&self) -> Result<BusLock, OpenError> {
            Ok(BusLock::interface(self.interface_name()?)?)
        }

        fn holders(&self, thorough: bool) -> [Option<Holder>; 2] {
            BusLock::holders_of_interface(&self.interface, thorough)
        }

        /// The bus receives the replies of its motors, the frames of its sensors, and commands to
        /// motors that another socket or node sends.
        fn open(&self, nodes: &Nodes, expected: Option<Identity>) -> Result<Opened, OpenError> {
            let Nodes { motors, sensor_ids, requests, .. } = nodes;
            let host_ids: Vec<_> = motors.iter().flat_map(|motor| motor.replies.filters()).collect();
            let commands = motors.iter().flat_map(|motor| motor.commands.filters());
            let others = commands.chain(sensor_ids.iter().copied().map(IdFilter::exact));
            let received: Vec<_> = host_ids.iter().copied().chain(others).collect();
            let mut bus = SocketCanBus::open(&Settings {
                index: expected.and_then(Identity::interface),
                host_ids,
                requests: *requests,
                ..Settings::new(self.interface_name()?, self.bitrate)
            })?;
            bus.listen(&received)?;
            let notes = bus.notes(self.bitrate).collect();
            let identity = Some(Identity::Interface(bus.link().index));
            Ok(Opened { bus: Box::new(bus), identity, notes })
        }

        fn discard_queue(&self, expected: Option<Identity>) -> Result<bool, OpenError> {
            Ok(Link::discard_queue(self.interface_name()?, expected.and_then(Identity::interface))?)
        }

        /// An interface that has the name by now may be another adapter, and is not set up.
        fn absent(&self, _nodes: &Nodes) -> Option<OpenError> {
            let missing = |interface| socketcan::OpenError::Missing(interface).into();
            Some(self.interface_name().map_or_else(|error| error, missing))
        }

        fn open_as_is(&self, _nodes: &Nodes) -> Result<OpenedAsIs, OpenError> {
            let bus = SocketCanBus::open_as_is(self.interface_name()?)?;
            let (bitrate, is_virtual) = (bus.link().bitrate, bus.link().is_virtual);
            let hides_bitrate = bitrate.is_none() && !is_virtual;
            Ok(OpenedAsIs { bus: Box::new(bus), bitrate, hides_bitrate })
        }

        fn sender(&self, frames: u32) -> Result<OpenedSender, OpenError> {
            let mut sender = Sender::new(self.interface_name()?, frames)?;
            let missing = sender.find().err().map(OpenError::from);
            Ok(OpenedSender { bus: Box::new(sender), missing })
        }

        fn shows_other_senders(&self) -> bool {
            true
        }

        fn motors_end(&self) -> Option<&dyn MotorsEnd> {
            Some(self)
        }
    }

    impl MotorsEnd for SocketCan {
        fn lock(&self) -> Result<BusLock, OpenError> {
            Ok(BusLock::simulation(self.interface_name()?)?)
        }

        fn open(&self, received: &[IdFilter]) -> Result<Box<dyn MotorsBus>, OpenError> {
            let settings = Settings::new(self.interface_name()?, self.bitrate);
            Ok(Box::new(SocketCanBus::open(&Settings { host_ids: received.to_vec(), ..settings })?))
        }
    }

    impl MotorsBus for SocketCanBus {
        fn listen(&mut self, received: &[IdFilter]) -> Result<(), OpenError> {
            Ok(Self::listen(self, received)?)
        }

        /// On a virtual interface only.
        fn report(&mut self, error: &ErrorFrame) -> Sent {
            Self::report(self, error)
        }
    }

    impl SendingBus for Sender {
        fn find(&mut self) -> bool {
            Self::find(self).is_ok()
        }
    }

    impl From<socketcan::OpenError> for OpenError {
        fn from(error: socketcan::OpenError) -> Self {
            use socketcan::OpenError::{Down, Missing};
            let cause = match &error {
                Missing(_) | Down { .. } => Cause::Absent,
                _ => Cause::Other,
            };
            Self::new(cause, error)
        }
    }
}
