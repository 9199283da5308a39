//! The simulated twin of a configured motor is a motor of its model.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord::buses;
use motord_bus::{Bus, Content, Frame, FrameId, Inbox, Instant};
use motord_configuration::{Machine, parse};
use motord_protocol::Model;
use motord_protocol::profile::STEADYWIN;
use motord_simulator::{MotorSettings, SimulatedBus};
use std::path::Path;

fn simulated(model: &Model) -> (SimulatedBus, MotorSettings) {
    let text = format!(
        "[cycle]\nrate-hz = 250\n[[bus]]\nname = 'bench'\ntype = 'simulated'\n[[motor]]\nname = 'joint'\nbus = 'bench'\nid = 1\n\
         protocol = 'gim'\nmodel = '{}'\n[motor.limits]\nposition-rad = [-1.0, 1.0]\n",
        model.name
    );
    let settings = parse(Path::new("bench.toml"), text.as_bytes(), &Machine::here()).unwrap().settings;
    let (_, motors) = buses::physics(&settings, 0);
    (buses::simulate(&settings, 0, 0), motors[0].clone())
}

/// The data of the answer to `request`, a native command with data in its last four bytes.
fn ask(bus: &mut SimulatedBus, now: &mut u64, request: [u8; 8]) -> [u8; 4] {
    bus.send(Instant::from_nanos(*now), &[Frame::classic(FrameId::new(1).unwrap(), request)]);
    *now += 1_000_000;
    let mut inbox = Inbox::new();
    bus.receive(Instant::from_nanos(*now), &mut inbox);
    let Content::Frame(answer) = inbox.arrivals()[0].content else { panic!("an answer") };
    answer.payload()[4..].try_into().unwrap()
}

/// GIM document, table 7 and table 10.
#[test]
fn twin_of_every_model_has_its_data() {
    for model in STEADYWIN.models {
        let (mut bus, _) = simulated(model);
        let now = &mut 0;
        let pole_pairs = i32::from_le_bytes(ask(&mut bus, now, [0x84, 0x00, 0x00, 0, 0, 0, 0, 0]));
        let gear_ratio = i32::from_le_bytes(ask(&mut bus, now, [0x84, 0x00, 0x11, 0, 0, 0, 0, 0]));
        let rated_voltage = i32::from_le_bytes(ask(&mut bus, now, [0x84, 0x00, 0x06, 0, 0, 0, 0, 0]));
        let resistance = f32::from_le_bytes(ask(&mut bus, now, [0x84, 0x01, 0x00, 0, 0, 0, 0, 0]));
        let voltage = f32::from_le_bytes(ask(&mut bus, now, [0xB4, 0x00, 0, 0, 0, 0, 0, 0]));
        assert_eq!(pole_pairs, i32::from(model.pole_pairs), "{}", model.name);
        assert_eq!(
            (gear_ratio, rated_voltage),
            (model.gear_ratio as i32, model.rated_voltage as i32),
            "{}",
            model.name
        );
        assert_eq!((resistance, voltage), (model.phase_resistance, model.rated_voltage), "{}", model.name);
    }
}

#[test]
fn smaller_motor_has_lighter_rotor_and_less_friction() {
    let of = |name| simulated(Model::by_name(name).unwrap()).1;
    let [small, middle, large] = ["GIM3505-8", "GIM8108-8", "GIM10015-9"].map(of);
    for of in [
        |motor: &MotorSettings| motor.rotor_inertia,
        |motor: &MotorSettings| motor.viscous_friction,
        |motor: &MotorSettings| motor.coulomb_friction,
    ] {
        assert!(of(&small) < of(&middle) && of(&middle) < of(&large));
    }
    // One rotor behind two gears.
    assert_eq!(of("GIM8108-8").rotor_inertia, of("GIM8108-48").rotor_inertia);
    let default = MotorSettings::default();
    assert!((middle.rotor_inertia / default.rotor_inertia - 1.0).abs() < 1e-6, "the default is a GIM8108-8");
}
