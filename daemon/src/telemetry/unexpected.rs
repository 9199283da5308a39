//! Counts the frames that the kernel keeps from the cycle because no motor of the bus has their id.

use motord_bus::FrameId;
use motord_bus::socketcan::{InterfaceName, Link, UnexpectedIds};
use motord_core::cycle::Counters;
use motord_core::settings::{BusKind, MotorSettings, Settings};
use std::sync::atomic::Ordering;

/// The CAN interfaces of a configuration, with the sockets that count their unexpected ids.
pub(super) struct UnexpectedCounts(Vec<Interface>);

struct Interface {
    bus: usize,
    name: InterfaceName,
    /// The ids that motors of this bus answer with and are commanded by.
    expected: Vec<FrameId>,
    /// `None` while the interface is missing.
    unexpected_ids: Option<UnexpectedIds>,
    /// The count until the interface went away.
    before: u64,
}

impl UnexpectedCounts {
    /// Nothing is open yet.
    pub(super) fn new(settings: &Settings) -> Self {
        let interfaces = settings.buses.iter().enumerate().filter_map(|(bus, described)| {
            let BusKind::SocketCan { interface, .. } = &described.kind else { return None };
            let motors = settings.motors.iter().filter(|motor| motor.bus == bus);
            let expected = motors.flat_map(ids).collect();
            Some(Interface { bus, name: interface.parse().ok()?, expected, unexpected_ids: None, before: 0 })
        });
        Self(interfaces.collect())
    }

    /// Opens a socket on every interface that has none. An interface that cannot be opened is logged by the opening of its
    /// bus, not here.
    pub(super) fn open(&mut self) {
        for interface in self.0.iter_mut().filter(|interface| interface.unexpected_ids.is_none()) {
            let link = Link::read(interface.name);
            interface.unexpected_ids =
                link.and_then(|link| UnexpectedIds::open(&link, &interface.expected)).ok();
        }
    }

    /// Closes the socket of `bus`, whose interface is gone: the kernel takes one that comes back for another interface.
    pub(super) fn close(&mut self, bus: usize) {
        for interface in self.0.iter_mut().filter(|interface| interface.bus == bus) {
            interface.before +=
                interface.unexpected_ids.take().map_or(0, |mut unexpected_ids| unexpected_ids.count());
        }
    }

    /// Stores the counts up to now, modulo 2³².
    pub(super) fn store(&mut self, counters: &Counters) {
        for interface in &mut self.0 {
            let now = interface.unexpected_ids.as_mut().map_or(0, UnexpectedIds::count);
            counters.unexpected_ids[interface.bus].store((interface.before + now) as u32, Ordering::Relaxed);
        }
    }
}

fn ids(motor: &MotorSettings) -> [FrameId; 2] {
    [FrameId::new(u16::from(motor.id)).expect("a motor id has eight bits"), motor.host_id]
}
