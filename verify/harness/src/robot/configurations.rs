//! The configurations of the robots.

use motord_configuration::{self as config, Machine};
use motord_settings::settings::Settings;
use std::path::Path;

/// Three motors with ids 1 to 3 on one bus, with the tolerances of a robot.
pub fn three_motors() -> Settings {
    let mut text = String::from(
        "[cycle]\nrate-hz = 1000\n[safety]\nsetpoint-timeout-ms = 20\n[[bus]]\nname = \"can\"\ntype = \"simulated\"\n",
    );
    for (id, name) in [(1, "hip"), (2, "thigh"), (3, "knee")] {
        text += &motor(id, name, "can", "");
    }
    settings(&text)
}

/// Twelve motors on four simulated buses, as in the shipped configuration of a quadruped.
pub fn quadruped() -> Settings {
    let mut text = String::from("[safety]\nsetpoint-timeout-ms = 20\n");
    for bus in ["front-left", "front-right", "rear-left", "rear-right"] {
        text += &format!("[[bus]]\nname = \"{bus}\"\ntype = \"simulated\"\n");
    }
    for bus in ["front-left", "front-right", "rear-left", "rear-right"] {
        for (id, name) in [(1, "hip"), (2, "thigh"), (3, "knee")] {
            text += &motor(id, &format!("{bus}-{name}"), bus, "");
        }
    }
    settings(&text)
}

/// One `[[motor]]`, with further keys in `more`.
pub fn motor(id: u8, name: &str, bus: &str, more: &str) -> String {
    format!(
        "[[motor]]\nname = \"{name}\"\nbus = \"{bus}\"\nid = {id}\nprotocol = \"mit\"\nmodel = \"GIM8108-8\"\n{more}\n\
         [motor.limits]\nposition-rad = [-3.0, 3.0]\nvelocity-rad-s = 20.0\ntorque-nm = 20.0\n\
         torque-slew-nm-per-s = 100.0\n"
    )
}

/// Parses a valid configuration.
pub fn settings(text: &str) -> Settings {
    let loaded = config::parse(Path::new("test.toml"), text.as_bytes(), &Machine::here());
    loaded.unwrap_or_else(|error| panic!("{error}")).settings
}
