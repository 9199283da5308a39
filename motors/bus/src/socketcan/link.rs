//! Reads and changes the settings of the interface below the socket.
//!
//! With `CAP_NET_ADMIN`, this module sets the queue length. It takes an interface with other
//! settings down, sets its bit rate and restart time, and brings it up. Without it, [`OpenError`]
//! reports the error and the commands that correct it. The settings are not restored on exit: the
//! dead man's switch and `candump` continue to use the interface.
//!
//! Only the bit rate is required. Adapters whose drivers do not support a restart after a bus-off
//! (`gs_usb`, `slcan`), or do not know their own bit rate (`slcan`), are used with a [`LinkNote`].
//! After a failure the interface is as it was.

use core::fmt;

use neli::consts::nl::NlmF;
use neli::consts::rtnl::{Arphrd, Ifla, RtAddrFamily, Rtm};
use neli::consts::socket::NlFamily;
use neli::nl::{NlPayload, Nlmsghdr, NlmsghdrBuilder};
use neli::rtnl::{Ifinfomsg, IfinfomsgBuilder, RtattrBuilder};
use neli::socket::synchronous::NlSocketHandle;
use neli::types::RtBuffer;
use neli::utils::Groups;
use nix::errno::Errno;
use nix::net::if_::if_nametoindex;
use socketcan::nl::{CanBitTiming, CanCtrlModes, CanState, InterfaceDetails};
use socketcan::{CanCtrlMode, CanInterface, InterfaceCanParams, NlError};

use super::{InterfaceName, open_socket};
use crate::frame::ControllerState;

/// Time after which a controller that is bus-off restarts, ms. By the kernel's default it never
/// restarts.
pub const RESTART_MS: u32 = 100;

/// Tolerance of the bit rate: a clock that is not a multiple of it gives a slightly different rate.
/// 1/200 is a third of the difference that CAN tolerates between two nodes (1.58 %, ISO 11898-1).
const BITRATE_TOLERANCE: u32 = 200;

/// The settings of an interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Link {
    /// Its name.
    pub interface: InterfaceName,
    /// Its number, which changes each time an adapter is plugged in.
    pub index: u32,
    /// The interface is up.
    pub up: bool,
    /// Bit rate in bit/s. `None` on a virtual interface, before a rate is set, and where another
    /// program set it in the adapter (`slcand -s8`).
    pub bitrate: Option<u32>,
    /// Time from bus-off to restart, ms; 0 means never. `None` on a virtual interface.
    pub restart_ms: Option<u32>,
    /// State that the controller reports. `None` on a virtual interface, or while the controller is
    /// stopped.
    pub state: Option<ControllerState>,
    /// The interface has no controller: `vcan`, `vxcan`.
    pub is_virtual: bool,
    /// Listen-only mode: the interface never acknowledges and never sends.
    pub listen_only: bool,
    /// Loopback mode: the interface receives only its own frames.
    pub loopback: bool,
}

/// A remark on an interface that can be used, for the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum LinkNote {
    /// The interface is up, and its driver does not know the bit rate.
    #[error(
        "{interface}: its bit rate is unknown, because another program set it in the adapter: make sure that it is {expected} bit/s"
    )]
    UnknownBitrate {
        /// The interface.
        interface: InterfaceName,
        /// The configured rate, bit/s.
        expected: u32,
    },
    /// The interface ran at another bit rate, and was set to the configured one.
    #[error("{interface} was up at {received} bit/s: motord took it down and set it to {expected}")]
    BitrateSet {
        /// The interface.
        interface: InterfaceName,
        /// The configured rate, bit/s.
        expected: u32,
        /// The rate before, bit/s.
        received: u32,
    },
    /// The interface was in listen-only or loopback mode, which was ended.
    #[error(
        "{0} was in listen-only or loopback mode, in which no motor receives a frame: motord ended it. If it was set on purpose, end \
         motord and set it again"
    )]
    ModeEnded(InterfaceName),
    /// The controller does not return to the bus by itself.
    #[error(
        "{0} does not return by itself after a bus-off (restart-ms is 0; some drivers support no other value): motord takes it down \
         and up where it has the permission; otherwise, as root: ip link set {0} down; ip link set {0} up"
    )]
    NoRestart(InterfaceName),
}

impl LinkNote {
    /// Returns whether this is a property of the interface, and not something that was done to it.
    #[must_use]
    pub const fn is_lasting(self) -> bool {
        matches!(self, Self::UnknownBitrate { .. } | Self::NoRestart(_))
    }
}

/// Reason for which an interface cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum OpenError {
    /// No interface has this name.
    #[error(
        "{0}: there is no such interface; plug the adapter in or load its driver (`ip link` lists the interfaces)"
    )]
    Missing(InterfaceName),
    /// An interface of another kind, such as Ethernet.
    #[error("{0} is not a CAN interface (`ip -details link show type can` lists CAN interfaces)")]
    NotCan(InterfaceName),
    /// The interface is down.
    #[error("{0} is down; as root: {1}", .remedy.interface, .remedy)]
    Down {
        /// The commands that correct it.
        remedy: Remedy,
    },
    /// The interface runs at another bit rate than the motors.
    #[error("{0} is set to {received} bit/s, {expected} are configured; as root: {1}", .remedy.interface, .remedy)]
    Bitrate {
        /// The configured rate, bit/s.
        expected: u32,
        /// The rate of the interface, bit/s.
        received: u32,
        /// The commands that correct it.
        remedy: Remedy,
    },
    /// The interface is in listen-only or loopback mode: no motor would receive its frames.
    #[error("{0} is in listen-only or loopback mode; as root: {1}", .remedy.interface, .remedy)]
    Deaf {
        /// The commands that correct it.
        remedy: Remedy,
    },
    /// The controller has left the bus and is not configured to restart.
    #[error("{0} is bus-off and not set to restart; check wiring and bit rate, then as root: {1}", .remedy.interface, .remedy)]
    BusOff {
        /// The commands that correct it.
        remedy: Remedy,
    },
    /// The driver rejects the settings, such as a bit rate that its clock cannot be divided to.
    #[error("{0}: the driver refused; check `dmesg` for the reason: {1}", .remedy.interface, .remedy)]
    Refused {
        /// The commands that were tried.
        remedy: Remedy,
    },
    /// Frames wait on the interface, and the process may not discard them.
    #[error(
        "{0}: frames that kernel and adapter hold are sent when the power of the motors returns, because motord may not take the \
         interface down; before the power returns, as root: ip link set {0} down; ip link set {0} up"
    )]
    Kept(InterfaceName),
    /// A system call failed.
    #[error("{interface}: {step}: {errno}")]
    System {
        /// The interface.
        interface: InterfaceName,
        /// The step that failed.
        step: Step,
        /// The error of the kernel.
        errno: Errno,
    },
}

impl OpenError {
    /// Returns the commands that correct it; `None` where no command does.
    #[must_use]
    pub const fn remedy(&self) -> Option<&Remedy> {
        match self {
            Self::Down { remedy }
            | Self::Bitrate { remedy, .. }
            | Self::Deaf { remedy }
            | Self::BusOff { remedy }
            | Self::Refused { remedy } => Some(remedy),
            Self::Missing(_) | Self::NotCan(_) | Self::Kept(_) | Self::System { .. } => None,
        }
    }
}

/// The step in which a system call failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Step {
    /// Reading the settings of the interface.
    #[error("cannot read its settings")]
    Read,
    /// Bringing the interface up.
    #[error("cannot bring it up")]
    Up,
    /// Opening the socket and setting its options.
    #[error("cannot open a socket on it")]
    Socket,
}

/// The commands that configure an interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Remedy {
    /// The interface.
    pub interface: InterfaceName,
    /// Bit rate in bit/s; `None` for a virtual interface, which has none.
    pub bitrate: Option<u32>,
    /// Length of its transmit queue in frames.
    pub queue_length: u32,
    /// Listen-only or loopback mode must be switched off.
    pub deaf: bool,
}

impl fmt::Display for Remedy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { interface, queue_length, .. } = self;
        let Some(bitrate) = self.bitrate else { return write!(f, "ip link set {interface} up") };
        let modes = if self.deaf { " listen-only off loopback off" } else { "" };
        // A driver may not support a restart: in a command of its own this does not prevent the
        // others.
        write!(
            f,
            "ip link set {interface} down; \
             ip link set {interface} type can bitrate {bitrate}{modes}; \
             ip link set {interface} type can restart-ms {RESTART_MS}; \
             ip link set {interface} txqueuelen {queue_length} up"
        )
    }
}

impl Link {
    /// Reads the settings of `interface`. Needs no privileges.
    ///
    /// # Errors
    ///
    /// [`OpenError::Missing`], [`OpenError::NotCan`] or [`OpenError::System`].
    pub fn read(interface: InterfaceName) -> Result<Self, OpenError> {
        Self::read_all(interface).map(|(link, _)| link)
    }

    /// Reads the settings, also the bit timing.
    fn read_all(interface: InterfaceName) -> Result<(Self, Option<CanBitTiming>), OpenError> {
        let index = if_nametoindex(interface.as_str()).map_err(|_| OpenError::Missing(interface))?;
        // Binding is the kernel's own test for a CAN interface.
        open_socket(interface, index, |_| Ok(()))?;
        let details = CanInterface::open_iface(index).details().map_err(|error| OpenError::System {
            interface,
            step: Step::Read,
            errno: netlink_errno(&error),
        })?;
        Ok((Self::from_details(interface, index, &details), details.can.bit_timing))
    }

    fn from_details(interface: InterfaceName, index: u32, details: &InterfaceDetails) -> Self {
        let can = &details.can;
        let is_set = |mode| can.ctrl_mode.is_some_and(|modes| modes.has_mode(mode));
        Self {
            interface,
            index,
            up: details.is_up,
            bitrate: can.bit_timing.map(|timing| timing.bitrate),
            restart_ms: can.restart_ms,
            state: can.state.and_then(controller_state),
            is_virtual: can.state.is_none(),
            listen_only: is_set(CanCtrlMode::ListenOnly),
            loopback: is_set(CanCtrlMode::Loopback),
        }
    }

    /// Prepares `interface` for `bitrate` (bit/s), with a transmit queue of `queue_length` frames.
    /// With `index`, leaves an interface of another index as it is. Returns its settings, and those
    /// before if they were changed. Not for the real-time thread: takes milliseconds, and
    /// allocates.
    ///
    /// # Errors
    ///
    /// The first error of the interface that may not or cannot be corrected.
    pub fn prepare(
        interface: InterfaceName,
        index: Option<u32>,
        bitrate: u32,
        queue_length: u32,
    ) -> Result<(Self, Option<Self>), OpenError> {
        let (link, timing) = Self::read_all(interface)?;
        if index.is_some_and(|index| index != link.index) {
            return Err(OpenError::Missing(interface));
        }
        // A process that may set the queue length may set the rest. Otherwise the send buffer still
        // bounds the queue.
        let allowed = set_queue_length(link.index, queue_length);
        let Err(fault) = link.check(bitrate, queue_length) else { return Ok((link, None)) };
        if !allowed {
            return Err(fault);
        }
        let remedy = link.remedy(bitrate, queue_length);
        link.set_up(bitrate).map_err(|_| {
            link.restore(timing);
            OpenError::Refused { remedy }
        })?;
        let changed = Self::read(interface)?;
        changed.check(bitrate, queue_length).map(|()| (changed, Some(link)))
    }

    /// Returns what is ended by [`prepare`](Self::prepare), for motors at `bitrate` (bit/s), in an
    /// interface that is up with these settings.
    pub(super) fn ended(&self, bitrate: u32) -> impl Iterator<Item = LinkNote> {
        let interface = self.interface;
        let received = self.bitrate.filter(|received| self.up && !is_near(*received, bitrate));
        let set = received.map(|received| LinkNote::BitrateSet { interface, expected: bitrate, received });
        let ended = (self.up && self.is_deaf()).then_some(LinkNote::ModeEnded(interface));
        set.into_iter().chain(ended)
    }

    /// Returns the limitations of the interface, for motors at `bitrate` (bit/s). Empty for a
    /// virtual interface.
    pub fn notes(&self, bitrate: u32) -> impl Iterator<Item = LinkNote> {
        let interface = self.interface;
        let is_known = self.is_virtual || self.bitrate.is_some();
        let unknown = (!is_known).then_some(LinkNote::UnknownBitrate { interface, expected: bitrate });
        unknown.into_iter().chain((self.restart_ms == Some(0)).then_some(LinkNote::NoRestart(interface)))
    }

    /// Checks that motors at `bitrate` (bit/s) can be reached through the interface with its
    /// present settings.
    ///
    /// # Errors
    ///
    /// The first error found.
    pub fn check(&self, bitrate: u32, queue_length: u32) -> Result<(), OpenError> {
        let remedy = self.remedy(bitrate, queue_length);
        if let Some(received) = self.bitrate
            && !is_near(received, bitrate)
        {
            return Err(OpenError::Bitrate { expected: bitrate, received, remedy });
        }
        if self.is_deaf() {
            return Err(OpenError::Deaf { remedy });
        }
        if !self.up {
            return Err(OpenError::Down { remedy });
        }
        if self.state == Some(ControllerState::Off) && self.restart_ms == Some(0) {
            return Err(OpenError::BusOff { remedy });
        }
        Ok(())
    }

    fn is_deaf(&self) -> bool {
        self.listen_only || self.loopback
    }

    fn remedy(&self, bitrate: u32, queue_length: u32) -> Remedy {
        Remedy {
            interface: self.interface,
            bitrate: (!self.is_virtual).then_some(bitrate),
            queue_length,
            deaf: self.is_deaf(),
        }
    }

    /// Sets bit rate and modes, then the restart time, and brings the interface up. The restart
    /// time has a request of its own: a driver that does not support it refuses the whole request.
    fn set_up(&self, bitrate: u32) -> socketcan::Result<()> {
        let interface = CanInterface::open_iface(self.index);
        if self.up {
            interface.bring_down()?;
        }
        if !self.is_virtual {
            match interface.set_can_params(&self.required(bitrate)) {
                // An adapter with a rate of its own, which its driver can neither read nor set.
                Err(error) if self.bitrate.is_none() && netlink_errno(&error) == Errno::EOPNOTSUPP => {}
                outcome => outcome?,
            }
            let restart =
                InterfaceCanParams { restart_ms: Some(RESTART_MS), ..InterfaceCanParams::default() };
            let _unsupported = interface.set_can_params(&restart);
        }
        interface.bring_up()
    }

    /// Restores the settings of an interface whose set-up failed, with the `timing` that it had.
    fn restore(&self, timing: Option<CanBitTiming>) {
        let interface = CanInterface::open_iface(self.index);
        // The kernel computes the rest of the timing from these two.
        let bit_timing = timing.map(|CanBitTiming { bitrate, sample_point, .. }| CanBitTiming {
            bitrate,
            sample_point,
            ..CanBitTiming::default()
        });
        let ctrl_mode = self.is_deaf().then(|| modes(self.listen_only, self.loopback));
        let restart_ms = self.restart_ms;
        // A request that a driver refuses must not keep the others from being granted.
        let none = InterfaceCanParams::default;
        for before in [
            InterfaceCanParams { bit_timing, ..none() },
            InterfaceCanParams { ctrl_mode, ..none() },
            InterfaceCanParams { restart_ms, ..none() },
        ] {
            let _refused = interface.set_can_params(&before);
        }
        if self.up {
            let _refused = interface.bring_up();
        }
    }

    fn required(&self, bitrate: u32) -> InterfaceCanParams {
        // Set only when needed: a driver with a fixed mode refuses settings that leave that mode
        // out.
        let hearing = self.is_deaf().then(|| modes(false, false));
        InterfaceCanParams {
            bit_timing: Some(CanBitTiming { bitrate, ..CanBitTiming::default() }),
            ctrl_mode: hearing,
            ..InterfaceCanParams::default()
        }
    }
}

fn is_near(received: u32, bitrate: u32) -> bool {
    received.abs_diff(bitrate) <= bitrate / BITRATE_TOLERANCE
}

fn modes(listen_only: bool, loopback: bool) -> CanCtrlModes {
    let mut modes = CanCtrlModes::default();
    modes.add(CanCtrlMode::ListenOnly, listen_only);
    modes.add(CanCtrlMode::Loopback, loopback);
    modes
}

fn controller_state(state: CanState) -> Option<ControllerState> {
    match state {
        CanState::ErrorActive => Some(ControllerState::Active),
        CanState::ErrorWarning => Some(ControllerState::Warning),
        CanState::ErrorPassive => Some(ControllerState::Passive),
        CanState::BusOff => Some(ControllerState::Off),
        CanState::Stopped | CanState::Sleeping => None,
    }
}

pub(super) fn netlink_errno(error: &socketcan::Error) -> Errno {
    let raw = match error {
        socketcan::Error::Io(error) => error.raw_os_error(),
        socketcan::Error::Nl(NlError::Netlink { errno }) => Some(*errno),
        _ => None,
    };
    Errno::from_raw(raw.unwrap_or(libc::EPROTO))
}

/// Sets the transmit queue length, which the socketcan crate does not offer. Returns `false` when
/// the kernel refused, usually because the process lacks `CAP_NET_ADMIN`.
fn set_queue_length(index: u32, frames: u32) -> bool {
    let acknowledged = || {
        let socket = NlSocketHandle::connect(NlFamily::Route, None, Groups::empty()).ok()?;
        socket.send(&queue_length_message(index, frames)?).ok()?;
        let (mut answers, _) = socket.recv::<Rtm, Ifinfomsg>().ok()?;
        let answer = answers.next()?.ok()?;
        Some(matches!(answer.nl_payload(), NlPayload::Ack(_)))
    };
    acknowledged().unwrap_or(false)
}

fn queue_length_message(index: u32, frames: u32) -> Option<Nlmsghdr<Rtm, Ifinfomsg>> {
    let length = RtattrBuilder::default().rta_type(Ifla::Txqlen).rta_payload(frames).build().ok()?;
    let mut attributes = RtBuffer::new();
    attributes.push(length);
    let link = IfinfomsgBuilder::default()
        .ifi_family(RtAddrFamily::Unspecified)
        .ifi_type(Arphrd::None)
        .ifi_index(i32::try_from(index).ok()?)
        .rtattrs(attributes)
        .build()
        .ok()?;
    NlmsghdrBuilder::default()
        .nl_type(Rtm::Newlink)
        .nl_flags(NlmF::REQUEST | NlmF::ACK)
        .nl_payload(NlPayload::Payload(link))
        .build()
        .ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn good() -> Link {
        Link {
            interface: "can0".parse().unwrap(),
            index: 3,
            up: true,
            bitrate: Some(1_000_000),
            restart_ms: Some(RESTART_MS),
            state: Some(ControllerState::Active),
            is_virtual: false,
            listen_only: false,
            loopback: false,
        }
    }

    #[test]
    fn unfit_interface_is_refused_with_mending_commands() {
        let commands = |modes| {
            format!(
                "as root: ip link set can0 down; \
                 ip link set can0 type can bitrate 1000000{modes}; \
                 ip link set can0 type can restart-ms 100; \
                 ip link set can0 txqueuelen 8 up"
            )
        };
        let unfit = [
            (Link { up: false, ..good() }, "can0 is down"),
            (
                Link { bitrate: Some(500_000), ..good() },
                "can0 is set to 500000 bit/s, 1000000 are configured",
            ),
            (Link { bitrate: None, up: false, ..good() }, "can0 is down"),
            (Link { listen_only: true, ..good() }, "can0 is in listen-only or loopback mode"),
            (Link { loopback: true, ..good() }, "can0 is in listen-only or loopback mode"),
            (Link { state: Some(ControllerState::Off), restart_ms: Some(0), ..good() }, "can0 is bus-off"),
        ];
        for (link, reason) in unfit {
            let modes = if link.is_deaf() { " listen-only off loopback off" } else { "" };
            let text = link.check(1_000_000, 8).unwrap_err().to_string();
            assert!(text.starts_with(reason) && text.ends_with(&commands(modes)), "{text}");
        }
        assert_eq!(good().check(1_000_000, 8), Ok(()));
        assert_eq!(Link { bitrate: None, ..good() }.check(1_000_000, 8), Ok(()), "the rate may be right");
    }

    #[test]
    fn bit_rate_rounded_by_clock_is_accepted() {
        for (received, fits) in [(999_001, true), (1_004_999, true), (994_000, false), (1_006_000, false)] {
            assert_eq!(
                Link { bitrate: Some(received), ..good() }.check(1_000_000, 8).is_ok(),
                fits,
                "{received}"
            );
        }
    }

    #[test]
    fn a_controller_that_will_restart_is_not_refused() {
        assert_eq!(Link { state: Some(ControllerState::Off), ..good() }.check(1_000_000, 8), Ok(()));
    }

    #[test]
    fn virtual_interface_only_needs_to_be_up() {
        let vcan = Link { bitrate: None, restart_ms: None, state: None, is_virtual: true, ..good() };
        assert_eq!(vcan.check(1_000_000, 8), Ok(()));
        let text = Link { up: false, ..vcan }.check(1_000_000, 8).unwrap_err().to_string();
        assert!(text.ends_with("as root: ip link set can0 up"), "{text}");
    }

    #[test]
    fn an_interface_that_is_not_there_is_missing() {
        let name = "nosuchcan9".parse().unwrap();
        assert_eq!(Link::read(name), Err(OpenError::Missing(name)));
    }
}
