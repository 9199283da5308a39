//! `motord-bridge`: a robot of motord in ROS 2. A client of motord like any other, in one process.
//!
//! ```text
//!  motord ◀─ shared memory ─▶ motor ──newest state──▶ ros2-publish ─▶ DDS
//!                             motor ◀─newest command─ ros2-receive ◀─ DDS
//!  motord ◀── stop socket ──  stop  ◀───requests───── ros2-stop    ◀─ DDS
//!                             motor ──newest state──▶ web          ─▶ HTTP
//!                             stop  ◀───requests───── web          ◀─ HTTP
//!                                   ◀───requests───── foxglove-net ◀─ WebSocket
//!                                   ◀───requests───── gamepad      ◀─ evdev
//!                                   ◀───requests───── gpio         ◀─ GPIO chip
//!  motord ── shared memory ─▶ foxglove-publish ─────▶ foxglove-net ─▶ WebSocket
//! ```
//!
//! The thread `motor` owns the client and the claims, and touches no network and no device. A peer that floods,
//! freezes or dies delays neither it nor the stop.

mod bridge;
mod claim_gate;
mod clock;
mod command;
mod config;
mod controls;
#[cfg(test)]
mod fixtures;
#[cfg(feature = "foxglove")]
mod foxglove;
#[cfg(not(feature = "foxglove"))]
#[path = "no_foxglove.rs"]
mod foxglove;
mod gamepad;
mod gpio;
mod group;
mod held;
mod hold;
mod inputs;
mod link;
mod logger;
mod motor;
mod pace;
mod rate_limit;
mod refusal;
mod request;
mod ros2;
mod rules;
mod setpoints;
mod shared;
mod slot;
mod stop;
mod threads;
mod trajectory;
mod urdf;
mod web;

use bridge::{check, run};
use clap::{Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;

/// Examples in the help.
const EXAMPLES: &str = "\
Examples:
  motord-bridge check --config bridge.toml       check a configuration without starting anything
  motord-bridge run --config bridge.toml         publish the states of the robot, and offer its stop
  motord-bridge gamepad                          show the sticks and buttons of a gamepad
  ROS_DOMAIN_ID=7 motord-bridge run              in another domain, with /etc/motord/bridge.toml

The bridge accepts commands only with `commands = true` in [ros2] of its configuration.";

/// Examples in the help of `gamepad`.
const GAMEPAD_EXAMPLES: &str = "\
Examples:
  motord-bridge gamepad                                    find out the names of gamepads, sticks and buttons
  motord-bridge gamepad --json | ./controller              a controller that reads lines from its input
  motord-bridge gamepad --name 'Xbox Wireless Controller'  one of several gamepads

Left and up are positive. Unplugged, or out of its range, counts as released: 0 and false.";

/// Connects a robot of motord with ROS 2, Foxglove, a page for phones, gamepads and stop circuits.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Runs the bridge until SIGTERM or SIGINT. Waits for motord if it is not running.
    #[command(after_help = EXAMPLES)]
    Run {
        /// The configuration.
        #[arg(long, default_value = config::DEFAULT_FILE)]
        config: PathBuf,
    },
    /// Prints the sticks and buttons of a gamepad at each change. It stops nothing, and needs no motord.
    #[command(after_help = GAMEPAD_EXAMPLES)]
    Gamepad {
        /// The name of the gamepad. Without it: the first one.
        #[arg(long)]
        name: Option<String>,
        /// Prints a line of JSON at each change, and at least ten each second.
        #[arg(long)]
        json: bool,
    },
    /// Checks the configuration and the variables of ROS 2, and prints what `run` would use.
    #[command(after_help = EXAMPLES)]
    Check {
        /// The configuration.
        #[arg(long, default_value = config::DEFAULT_FILE)]
        config: PathBuf,
    },
}

fn main() -> ExitCode {
    logger::start();
    let outcome = match Arguments::parse().command {
        Command::Run { config } => run(&config),
        Command::Check { config } => check(&config),
        Command::Gamepad { name, json } => bridge::gamepad(name, json),
    };
    log::logger().flush();
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("motord-bridge: {error}");
            error.exit_status().into()
        }
    }
}
