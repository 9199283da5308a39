//! Opens one bus.

use motord_bus::serial::{self, SerialBus};
use motord_bus::socketcan::{self, InterfaceName, LinkNote, SocketCanBus};
use motord_bus::{Bus, Difference, Duration, FrameId, IdFilter, Identity, LockError};
use motord_core::drive;
use motord_settings::plan::BusPlan;
use motord_settings::settings::{BusKind, BusSettings, MotorSettings, Settings};
use motord_twin::simulate;

/// Why a bus could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The CAN interface cannot be used.
    #[error("bus {bus}: {source}")]
    Open {
        /// The bus.
        bus: String,
        /// Why.
        source: socketcan::OpenError,
    },
    /// The serial port cannot be used.
    #[error("bus {bus}: {source}")]
    Port {
        /// The bus.
        bus: String,
        /// Why.
        source: serial::OpenError,
    },
    /// Another daemon uses the interface or the port.
    #[error("bus {bus}: {source}")]
    Lock {
        /// The bus.
        bus: String,
        /// The lock, and who holds it.
        source: LockError,
    },
    /// Another interface got the name while it was opened.
    #[error("bus {bus}: its interface was exchanged while it was opened")]
    Exchanged {
        /// The bus.
        bus: String,
    },
    /// Another adapter than the one that was opened first has the name.
    #[error(
        "bus {bus}: {place} is another adapter than before: {difference}; it is not opened. Give each adapter a fixed name and plug \
         it in again, as `motorctl explain exchanged` describes"
    )]
    OtherAdapter {
        /// The bus.
        bus: String,
        /// The interface or the device.
        place: String,
        /// The properties that differ.
        difference: Difference,
    },
    /// The text is no name of an interface.
    #[error("bus {bus}: `{interface}` is no interface name: use one that `ip link` lists")]
    Name {
        /// The bus.
        bus: String,
        /// The name in the configuration.
        interface: String,
    },
}

impl BusError {
    /// Returns `true` when the interface or port may come by itself, such as when an adapter is plugged in.
    #[must_use]
    pub const fn may_pass(&self) -> bool {
        use socketcan::OpenError::{Down, Missing};
        matches!(
            self,
            Self::Exchanged { .. }
                | Self::Open { source: Missing(_) | Down { .. }, .. }
                | Self::Port { source: serial::OpenError::Missing { .. }, .. }
        )
    }
}

/// An open bus.
pub struct Opened {
    /// The bus.
    pub bus: Box<dyn Bus>,
    /// The index of its CAN interface.
    pub interface: Option<u32>,
    /// Remarks on the interface, for the log.
    pub notes: Vec<LinkNote>,
}

impl Opened {
    /// A bus without an interface.
    fn plain(bus: impl Bus + 'static) -> Self {
        Self { bus: Box::new(bus), interface: None, notes: Vec::new() }
    }
}

/// Opens one bus, for the first time or again. A serial port must be closed before it is opened again.
///
/// # Errors
///
/// Why it cannot be opened.
pub fn open_one(settings: &Settings, index: usize) -> Result<Opened, BusError> {
    open_expected(settings, index, None)
}

/// Works like [`open_one`], but sets up no other CAN interface than the `expected` one.
pub(super) fn open_expected(
    settings: &Settings,
    index: usize,
    expected: Option<Identity>,
) -> Result<Opened, BusError> {
    let bus = &settings.buses[index];
    match &bus.kind {
        BusKind::Simulated { seed, .. } => Ok(Opened::plain(simulate(settings, index, *seed))),
        BusKind::SocketCan { interface, bitrate } => {
            let interface = interface_name(bus, interface)?;
            let failed = |source| BusError::Open { bus: bus.name.clone(), source };
            open_can(settings, index, (interface, expected), *bitrate).map_err(failed)
        }
        BusKind::Serial { .. } => match SerialBus::open(&line(settings, index)) {
            Ok(bus) => Ok(Opened::plain(bus)),
            Err(source) => Err(BusError::Port { bus: bus.name.clone(), source }),
        },
    }
}

/// Opens a CAN bus. It receives the replies of its motors, the frames of its IMUs, and commands to motors
/// that another socket or node sends.
fn open_can(
    settings: &Settings,
    index: usize,
    (interface, expected): (InterfaceName, Option<Identity>),
    bitrate: u32,
) -> Result<Opened, socketcan::OpenError> {
    let expected = expected.and_then(Identity::interface);
    let motors = || settings.motors.iter().filter(|motor| motor.bus == index);
    let host_ids: Vec<_> = motors().map(|motor| motor.addresses().replies).collect();
    let imus = || settings.imus.iter().filter_map(|imu| imu.source.can()).filter(|can| can.bus == index);
    let requests = imus().map(|can| can.device.requests().count() as u32).sum();
    let of_imus = imus().flat_map(|can| can.device.sent_ids()).filter_map(FrameId::new);
    let commands = motors().map(MotorSettings::command_id);
    let others = commands.chain(of_imus).map(IdFilter::exact);
    let received: Vec<_> = host_ids.iter().copied().chain(others).collect();
    let wanted = socketcan::Settings { interface, index: expected, bitrate, host_ids, requests };
    let mut bus = SocketCanBus::open(&wanted)?;
    bus.listen(&received)?;
    let (interface, notes) = (Some(bus.link().index), bus.notes(bitrate).collect());
    Ok(Opened { bus: Box::new(bus), interface, notes })
}

/// The serial line with this index. A request is given up a while before the plan has the next one sent.
#[must_use]
pub fn line(settings: &Settings, index: usize) -> serial::Settings {
    drive::line(settings, index, reply_timeout(&BusPlan::of(settings)[index]))
}

fn reply_timeout(plan: &BusPlan) -> Duration {
    plan.transaction_worst * 3 / 4
}

pub(super) fn interface_name(bus: &BusSettings, interface: &str) -> Result<InterfaceName, BusError> {
    interface.parse().map_err(|_| BusError::Name { bus: bus.name.clone(), interface: interface.to_owned() })
}
