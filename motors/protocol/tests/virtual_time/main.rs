//! Transactions with simulated motors, on virtual time: native on CAN, MIT on CAN, native on a
//! serial line.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

mod configuration;
mod families;
mod node;
mod private;
mod rmd;
mod scan;
mod transactions;

use motord_bus::{Instant, VirtualClock};
use motord_protocol::commissioning::Link;
use motord_protocol::gim::ExecutionTime;
use motord_simulator::{
    BusSettings, Dialect, FaultVerb, Medium, Mode, MotorSettings, SharedBus, SimulatedBus,
};

pub(crate) const START: Instant = Instant::from_nanos(1_000_000_000);
pub(crate) const SECOND: ExecutionTime = ExecutionTime::from_millis(1000).unwrap();

pub(crate) fn motor(name: &str, id: u16, dialect: Dialect) -> MotorSettings {
    MotorSettings { name: name.into(), id, host_id: 0x100 + id, dialect, ..MotorSettings::default() }
}

pub(crate) fn bus(medium: Medium, motors: Vec<MotorSettings>) -> SharedBus {
    let bitrate = if medium == Medium::Can { 1_000_000 } else { 921_600 };
    let settings = BusSettings { medium, bitrate, record: 100_000, ..BusSettings::default() };
    SharedBus::new(SimulatedBus::new(settings, motors, 7))
}

pub(crate) fn link(bus: &SharedBus, medium: Medium) -> Link {
    match medium {
        Medium::Can => Link::can(bus.clone(), VirtualClock::new(START)),
        Medium::Serial => Link::serial(bus.clone(), VirtualClock::new(START)),
    }
}

/// One native motor, on both kinds of wire.
pub(crate) fn on_both_wires(test: impl Fn(&SharedBus, &mut Link)) {
    for medium in [Medium::Can, Medium::Serial] {
        let bus = bus(medium, vec![motor("knee", 3, Dialect::Gim)]);
        let mut link = link(&bus, medium);
        test(&bus, &mut link);
    }
}

pub(crate) fn mode(bus: &SharedBus) -> Mode {
    bus.lock().motors()[0].mode()
}

pub(crate) fn inject(bus: &SharedBus, link: &Link, verb: &str) {
    let verb: FaultVerb = verb.parse().unwrap();
    bus.lock().inject(link.now(), &verb).unwrap();
}
