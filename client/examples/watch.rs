//! Prints the states of all joints ten times per second.

use clap::Parser;
use motord_client::{Cause, Client, DEFAULT_INSTANCE, Error, MotorMode, RobotDescription, State};
use std::io::{self, Write};
use std::process::ExitCode;
use std::time::Duration;

/// Print the states of all joints ten times per second.
#[derive(Parser)]
struct Options {
    /// Instance of motord.
    #[arg(long, env = "MOTORD_INSTANCE", default_value = DEFAULT_INSTANCE)]
    instance: String,
    /// End after this many prints.
    #[arg(long)]
    count: Option<u64>,
}

const PERIOD: Duration = Duration::from_millis(100);

fn main() -> ExitCode {
    match watch(&Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("watch: {error}");
            ExitCode::from(error.exit_status())
        }
    }
}

fn watch(options: &Options) -> Result<(), Error> {
    let client = Client::connect(&options.instance)?;
    let mut printed = 0;
    while options.count.is_none_or(|count| printed < count) {
        match client.wait(10 * PERIOD) {
            Ok(state) if print(&client.description(), &state).is_err() => return Ok(()),
            Ok(_) => {}
            Err(error) if error.is_transient() => println!("{error}"),
            Err(error) => return Err(error),
        }
        printed += 1;
        std::thread::sleep(PERIOD);
    }
    Ok(())
}

/// Prints a state. Fails when the reader has closed the output.
fn print(robot: &RobotDescription, state: &State) -> io::Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "cycle {}, {:.1} ms old", state.cycle(), state.age().as_secs_f64() * 1e3)?;
    for (description, joint) in robot.joints.iter().zip(state.joints()) {
        let mode = joint.mode.map_or("unknown", MotorMode::name);
        let freshness = if joint.fresh { "" } else { "  (not fresh)" };
        // Adding 0.0 after rounding removes the sign of zero: half a code below zero is 0.000, not
        // -0.000.
        let digits = |value: f32| format!("{:.3}", (1e3 * value).round() / 1e3 + 0.0);
        let known = |value: Option<f32>| value.map_or_else(|| "-".to_owned(), digits);
        let [position, velocity, torque] = [joint.position(), joint.velocity(), joint.torque()].map(known);
        writeln!(
            out,
            "  {:16} {mode:9} {position:>8} rad {velocity:>8} rad/s {torque:>8} N·m{freshness}",
            description.name
        )?;
    }
    for (description, group) in robot.groups.iter().zip(state.groups()).filter(|(_, group)| group.latched) {
        let cause =
            group.cause.map_or("It was stopped for a cause unknown to this program.", Cause::sentence);
        writeln!(out, "  group {}: {cause}", description.name)?;
    }
    Ok(())
}
