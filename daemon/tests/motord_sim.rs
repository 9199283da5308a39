//! The help of `motord-sim` is true.

use motord::buses;
use motord_bus::clock;
use motord_configuration as config;
use motord_simulator::{BusKind, BusSettings, FaultVerb, SerialPort, SerialSlave, SimulatedBus};
use std::path::Path;
use std::process::Command;

/// The lines of faults that the help shows below `title`.
fn lines(title: &str) -> Vec<String> {
    let output = Command::new(env!("CARGO_BIN_EXE_motord-sim")).arg("--help").output().expect("is built");
    let help = String::from_utf8(output.stdout).expect("is text");
    let lines = help.lines().skip_while(|line| !line.starts_with(title)).skip(1);
    lines.take_while(|line| line.starts_with("  ")).map(|line| line.trim().to_owned()).collect()
}

/// Method: the program itself needs CAN interfaces. Its lines go to the simulated buses of the shipped quadruped, as it
/// gives them to those behind its interfaces.
#[test]
fn every_fault_in_the_help_of_motord_sim_is_one_that_a_simulated_bus_obeys() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/quadruped-simulated.toml");
    let settings = config::load(&file).expect("is shipped").settings;
    let mut bus = buses::simulate(&settings, 0, 0);
    let lines = lines("Lines:");
    assert!(lines.len() >= 5, "{lines:?}");
    for line in lines {
        let verb: FaultVerb = line.parse().unwrap_or_else(|error| panic!("{line}: {error}"));
        bus.inject(clock::monotonic(), &verb).unwrap_or_else(|error| panic!("{line}: {error}"));
    }
}

#[test]
fn every_fault_in_the_help_of_motord_sim_for_a_serial_bus_is_one_that_a_port_obeys() {
    let settings = BusSettings { name: "gripper".into(), kind: BusKind::Serial, ..BusSettings::default() };
    let slave = SerialSlave::new(SimulatedBus::new(settings, Vec::new(), 0), 0);
    let mut port = SerialPort::open(slave, None).expect("this kernel has pseudo terminals");
    let lines = lines("Lines for a serial bus:");
    assert!(lines.len() >= 7, "{lines:?}");
    for line in lines {
        let verb: FaultVerb = line.parse().unwrap_or_else(|error| panic!("{line}: {error}"));
        port.inject(clock::monotonic(), &verb).unwrap_or_else(|error| panic!("{line}: {error}"));
    }
}
