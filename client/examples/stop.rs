//! Stops every motor, and names who or what asked: `stop "the door of the cell"`.

use motord_client::{Client, DEFAULT_INSTANCE, Error};
use std::process::ExitCode;

fn main() -> ExitCode {
    let source = std::env::args().nth(1).unwrap_or_default();
    let instance = std::env::var("MOTORD_INSTANCE").unwrap_or_else(|_| DEFAULT_INSTANCE.to_owned());
    match stop(&instance, &source) {
        Ok(()) => {
            println!("stopped: each motor answered");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("stop: {error}");
            ExitCode::from(error.exit_status())
        }
    }
}

/// A program connects when it starts, and stops later: that needs no file and no memory any more.
fn stop(instance: &str, source: &str) -> Result<(), Error> {
    let client = Client::connect_to_stop(instance)?;
    client.emergency_stop_for(source)
}
