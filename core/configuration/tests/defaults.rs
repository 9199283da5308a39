//! A file without optional keys has the defaults of `motord_settings`.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_bus::transport::Simulated;
use motord_configuration::{Machine, parse};
use motord_protocol::Profile;
use motord_protocol::{FAMILIES, MotorProtocol};
use motord_settings::settings::{
    BusSettings, CycleSettings, GroupSettings, IpcSettings, MotorSettings, MotorSimulation, SafeStop,
    SafetySettings, Settings, SupplySettings,
};
use std::path::Path;

/// Settings of a robot with one motor, from a file that names only what has no default.
fn parsed(rate: &str, protocol: &str, model: &str) -> Settings {
    let text = format!(
        "{rate}
[[bus]]
name = 'desk'
type = 'simulated'
seed = 7
[[motor]]
name = 'arm'
bus = 'desk'
id = 3
protocol = '{protocol}'
model = '{model}'
"
    );
    parse(Path::new("robot.toml"), text.as_bytes(), &Machine::here()).unwrap().settings
}

fn defaults(protocol: MotorProtocol, model: &str) -> Settings {
    Settings {
        buses: vec![BusSettings::new("desk", Simulated { bitrate: 1_000_000, seed: 7 })],
        motors: vec![MotorSettings::of_model("arm", 3, protocol, model).unwrap()],
        simulation: vec![MotorSimulation::default()],
        groups: vec![GroupSettings {
            name: "all".into(),
            motors: vec![0],
            safe_stop: SafeStop::Damp,
            supply: SupplySettings::default(),
        }],
        ..Settings::default()
    }
}

fn has_defaults(protocol: MotorProtocol, profile: &Profile) -> bool {
    protocol.family().is_spoken_by(profile) && !protocol.family().needs_torque_end
}

#[test]
fn omitted_keys_are_these_defaults() {
    let mut robots = 0;
    for profile in Profile::all() {
        for model in profile.models {
            for (name, protocol) in FAMILIES.iter().filter(|(_, it)| has_defaults(*it, profile)) {
                let (file, default) = (parsed("", name, model.name), defaults(*protocol, model.name));
                assert_eq!(format!("{file:#?}"), format!("{default:#?}"));
                robots += 1;
            }
        }
    }
    assert!(robots > 20, "{robots}");
}

#[test]
fn slow_cycle_has_its_own_defaults() {
    let file = parsed("[cycle]\nrate-hz = 60", "mit", "GIM8108-8");
    let cycle = CycleSettings::at_rate(60.0);
    let (ipc, safety) = (IpcSettings::beside(&cycle), SafetySettings::of(&cycle));
    let default = Settings { cycle, ipc, safety, ..defaults(MotorProtocol::Mit, "GIM8108-8") };
    assert_eq!(format!("{file:#?}"), format!("{default:#?}"));
}

#[test]
fn impossible_motor_has_no_settings() {
    assert!(MotorSettings::of_model("arm", 0, MotorProtocol::Mit, "GIM8108-8").is_none());
    assert!(MotorSettings::of_model("arm", 255, MotorProtocol::Mit, "GIM8108-8").is_none());
    assert!(MotorSettings::of_model("arm", 1, MotorProtocol::Mit, "GIM9999-8").is_none());
    assert!(MotorSettings::of_model("arm", 1, MotorProtocol::Gim, "RS03").is_none());
    assert!(MotorSettings::of_model("arm", 1, MotorProtocol::MyActuator, "X8-20").is_none());
}
