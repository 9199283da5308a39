//! The questions of `motord init`, on a terminal.

use super::{Connection, Draft, InitError};
use dialoguer::{Confirm, Error, Input};
use motord_protocol::{FAMILIES, MotorProtocol, Profile};
use std::path::PathBuf;

/// Asks for everything; an empty answer takes the value of `defaults`. The questions go to standard
/// error.
///
/// # Errors
///
/// When there is no terminal, or the questions are broken off.
pub(super) fn ask(defaults: Draft) -> Result<Draft, InitError> {
    let Draft { legs, joints, model, protocol, connection } = defaults;
    let is_default = connection == Connection::one_bus_each(legs);
    let legs = answer("Legs (1 for an arm), 1 to 8", legs)?;
    let connection = if is_default { Connection::one_bus_each(legs.min(8)) } else { connection };
    let joints = list(&answer("Joints of each leg", joints.join(" "))?);
    let model = ask_model(model)?;
    let protocol = ask_protocol(protocol, &model)?;
    let connection =
        parse_connection(&answer("CAN interfaces or serial devices, or `simulated`", shown(&connection))?);
    Ok(Draft { legs, joints, model, protocol, connection })
}

/// The file that is proposed.
const FILE: &str = "robot.toml";

/// Asks for the file to write, until it is a new one or may be replaced. Returns whether it may.
///
/// # Errors
///
/// When the questions are broken off.
pub(super) fn ask_file() -> Result<(PathBuf, bool), InitError> {
    loop {
        let file = PathBuf::from(answer("File to write", FILE.to_owned())?);
        if file.symlink_metadata().is_err() {
            return Ok((file, false));
        }
        let question = format!("{} exists. Replace it?", file.display());
        if Confirm::new()
            .with_prompt(question)
            .default(false)
            .wait_for_newline(true)
            .interact()
            .map_err(unanswered)?
        {
            return Ok((file, true));
        }
    }
}

fn ask_model(default: String) -> Result<String, InitError> {
    let known = |model: &String| match Profile::of_model(model) {
        Some(_) => Ok(()),
        None => Err("not known: docs/configuration.md lists the models"),
    };
    let asked = Input::new().with_prompt("Model of the motors").default(default).validate_with(known);
    asked.interact_text().map_err(unanswered)
}

/// A vendor whose motors have one protocol is not asked about.
fn ask_protocol(default: MotorProtocol, model: &str) -> Result<MotorProtocol, InitError> {
    let profile = Profile::of_model(model).map(|(profile, _)| profile);
    let is_spoken =
        |protocol: &MotorProtocol| profile.is_some_and(|profile| protocol.family().is_spoken_by(profile));
    let spoken = FAMILIES.iter().filter(|(_, protocol)| is_spoken(protocol));
    let names = &spoken.map(|(name, _)| *name).collect::<Vec<_>>()[..];
    let [_, _, ..] = names else { return Ok(Default::default()) };
    let is_known = |text: &String| match names.contains(&text.as_str()) {
        true => Ok(()),
        false => Err(format!("not one of {}", names.join(", "))),
    };
    let question = format!("Protocol that they are set to, {}", names.join(" or "));
    let asked = Input::new().with_prompt(question).default(default.name().into()).validate_with(is_known);
    let text: String = asked.interact_text().map_err(unanswered)?;
    Ok(text.parse().unwrap_or(default))
}

/// Buses from a text: their names with spaces or commas between them, or `simulated`.
fn parse_connection(text: &str) -> Connection {
    match list(text) {
        names if names == ["simulated"] => Connection::Simulated,
        names => Connection::Buses(names),
    }
}

fn shown(connection: &Connection) -> String {
    match connection {
        Connection::Simulated => "simulated".into(),
        Connection::Buses(names) => names.join(" "),
    }
}

fn list(text: &str) -> Vec<String> {
    text.split([' ', ',']).filter(|name| !name.is_empty()).map(str::to_owned).collect()
}

fn answer<T>(question: &str, default: T) -> Result<T, InitError>
where
    T: Clone + ToString + std::str::FromStr,
    T::Err: ToString,
{
    Input::new().with_prompt(question).default(default).interact_text().map_err(unanswered)
}

fn unanswered(Error::IO(error): Error) -> InitError {
    InitError::Unanswered(error)
}
