//! Frames of strangers, which the kernel keeps from the cycle: counted here, at leisure.

use motord_bus::FrameId;
use motord_bus::socketcan::{InterfaceName, Link, Strays};
use motord_core::cycle::Counters;
use motord_core::settings::{BusKind, MotorSettings, Settings};
use std::sync::atomic::Ordering;

/// The CAN interfaces of a configuration, as far as strangers are concerned.
pub(super) struct StrayCounts(Vec<Interface>);

struct Interface {
    bus: usize,
    name: InterfaceName,
    /// The ids that motors of this bus answer with and are commanded by.
    expected: Vec<FrameId>,
    /// `None` while the interface is not there.
    strays: Option<Strays>,
    /// What was counted until the interface went away.
    before: u64,
}

impl StrayCounts {
    /// Everything is still to be opened.
    pub(super) fn new(settings: &Settings) -> Self {
        let interfaces = settings.buses.iter().enumerate().filter_map(|(bus, described)| {
            let BusKind::SocketCan { interface, .. } = &described.kind else { return None };
            let motors = settings.motors.iter().filter(|motor| motor.bus == bus);
            let expected = motors.flat_map(ids).collect();
            Some(Interface { bus, name: interface.parse().ok()?, expected, strays: None, before: 0 })
        });
        Self(interfaces.collect())
    }

    /// Opens what is not open. Who opens the buses themselves tells why one cannot be.
    pub(super) fn open(&mut self) {
        for interface in self.0.iter_mut().filter(|interface| interface.strays.is_none()) {
            let link = Link::read(interface.name);
            interface.strays = link.and_then(|link| Strays::open(&link, &interface.expected)).ok();
        }
    }

    /// The interface of `bus` is gone: when it is back, it is another one.
    pub(super) fn close(&mut self, bus: usize) {
        for interface in self.0.iter_mut().filter(|interface| interface.bus == bus) {
            interface.before += interface.strays.take().map_or(0, |mut strays| strays.count());
        }
    }

    /// Tells how many there were up to now, modulo 2³².
    pub(super) fn tell(&mut self, counters: &Counters) {
        for interface in &mut self.0 {
            let now = interface.strays.as_mut().map_or(0, Strays::count);
            counters.strays[interface.bus].store((interface.before + now) as u32, Ordering::Relaxed);
        }
    }
}

fn ids(motor: &MotorSettings) -> [FrameId; 2] {
    [FrameId::new(u16::from(motor.id)).expect("a motor id has eight bits"), motor.host_id]
}
