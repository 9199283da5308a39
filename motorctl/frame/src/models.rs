//! `motorctl models`: the known motors, and the file of a vendor.

use crate::FrameFailure;
use crate::golden::{Golden, golden};
use clap::Args;
use motord_configuration::ConfigError;
use motord_configuration::vendors::{read_vendor, register_beside, text_beside};
use motord_protocol::profile::shipped;
use motord_protocol::{Model, Profile};
use motord_terminal::{Cell, Palette, Table, json};
use serde::Serialize;
use std::io::{self, Write};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  motorctl models
  motorctl models --json | jq -r '.[].models[].name'
  motorctl models --show damiao >acme.toml
  motorctl models --check acme.toml
  motorctl models --check acme.toml --json | jq -r '.[] | .frame, .payload'

Own motors are files in the folder models.d beside the configuration, such as /etc/motord/models.d/acme.toml.
docs/extending.md has an example.";

/// The options of `motorctl models`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ModelsArguments {
    /// Also list the motors of the folder models.d beside this configuration.
    #[arg(long, value_name = "FILE", default_value = "/etc/motord/motord.toml")]
    config: PathBuf,
    /// Print the file of a vendor, named by itself or by one of its models.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["check", "json"])]
    show: Option<String>,
    /// Check the file of a vendor, and print the frames of its motors: each quantity at zero and at both ends.
    ///
    /// Compare them with the motor's manual. Exit status 78: the file has mistakes, which are printed.
    #[arg(long, value_name = "FILE")]
    check: Option<PathBuf>,
    /// Print the list, or the frames, as one JSON array.
    #[arg(long)]
    json: bool,
}

/// A vendor, as JSON.
#[derive(Serialize)]
struct Vendor {
    vendor: &'static str,
    motors: &'static str,
    protocols: &'static [&'static str],
    /// Brought by motord; otherwise a file of the user.
    is_shipped: bool,
    models: Vec<KnownModel>,
}

/// A model, as JSON. The ends are those of the codes.
#[derive(Serialize)]
struct KnownModel {
    name: &'static str,
    gear_ratio: f32,
    rated_torque_nm: f32,
    peak_torque_nm: f32,
    max_velocity_rad_s: f32,
    position_end_rad: f64,
    velocity_end_rad_s: f64,
    torque_end_nm: f64,
    kp_end: f64,
    kd_end: f64,
}

/// Runs the command.
///
/// # Errors
///
/// When a file has mistakes, a name is not known, or standard output cannot be written.
pub fn run_models(arguments: &ModelsArguments) -> Result<(), FrameFailure> {
    let out = &mut io::stdout().lock();
    if let Some(file) = &arguments.check {
        let (profile, _) = read_vendor(file).map_err(refused)?;
        let frames = profile.models.iter().flat_map(|model| golden(&profile, model)).collect();
        let written =
            if arguments.json { json::write_line(out, &frames) } else { check(&profile, frames, out) };
        return Ok(written?);
    }
    register_beside(&arguments.config).map_err(refused)?;
    match &arguments.show {
        Some(name) => {
            let text = text_of(name, arguments).ok_or_else(|| FrameFailure::NoModel(name.clone()))?;
            Ok(out.write_all(text.as_bytes())?)
        }
        None if arguments.json => Ok(json::write_line(out, &vendors())?),
        None => Ok(list(out)?),
    }
}

fn refused(problems: Vec<motord_configuration::Problem>) -> FrameFailure {
    ConfigError { problems, refused: None }.into()
}

/// Returns the file of the vendor with this name, or of a model with this name.
fn text_of(name: &str, arguments: &ModelsArguments) -> Option<String> {
    let of_model = || Profile::of_model(name).map(|(profile, _)| profile);
    let profile = Profile::by_name(name).or_else(of_model)?;
    let text = shipped().into_iter().find(|(known, _)| *known == profile).map(|(_, text)| text.to_owned());
    text.or_else(|| text_beside(&arguments.config, profile.name))
}

fn vendors() -> Vec<Vendor> {
    let shipped: Vec<_> = shipped().into_iter().map(|(profile, _)| profile.name).collect();
    let vendor = |profile: &'static Profile| Vendor {
        vendor: profile.name,
        motors: profile.motors,
        protocols: profile.protocols,
        is_shipped: shipped.contains(&profile.name),
        models: profile.models.iter().filter_map(known).collect(),
    };
    Profile::all().map(vendor).collect()
}

/// `None` for a model without scales, which the reader of files refuses.
fn known(model: &'static Model) -> Option<KnownModel> {
    let ends = model.scales().ok()?.ends();
    Some(KnownModel {
        name: model.name,
        gear_ratio: model.gear_ratio,
        rated_torque_nm: model.rated_torque,
        peak_torque_nm: model.peak_torque,
        max_velocity_rad_s: model.max_velocity,
        position_end_rad: ends.position,
        velocity_end_rad_s: ends.velocity,
        torque_end_nm: ends.torque,
        kp_end: ends.kp,
        kd_end: ends.kd,
    })
}

fn list(out: &mut dyn Write) -> io::Result<()> {
    let head =
        ["model", "vendor", "file", "protocols", "rated Nm", "peak Nm", "rad/s", "ends rad", "rad/s", "Nm"];
    let mut table = Table::new(&head);
    for vendor in vendors() {
        for model in &vendor.models {
            let number = |value: f64| Cell::plain((value * 1e3).round() / 1e3);
            table.row(vec![
                Cell::plain(model.name),
                Cell::plain(vendor.vendor),
                Cell::plain(if vendor.is_shipped { "shipped" } else { "own" }),
                Cell::plain(vendor.protocols.join(", ")),
                number(model.rated_torque_nm.into()),
                number(model.peak_torque_nm.into()),
                number(model.max_velocity_rad_s.into()),
                number(model.position_end_rad),
                number(model.velocity_end_rad_s),
                number(model.torque_end_nm),
            ]);
        }
    }
    table.write(out, Palette::of_stdout())
}

fn check(profile: &Profile, frames: Vec<Golden>, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "{}: no mistakes. Compare the frames of the motor 1 with its manual.", profile.motors)?;
    let mut table = Table::new(&["model", "direction", "frame", "value", "unit", "bytes"]);
    for Golden { model, direction, frame, value, unit, payload } in frames {
        let value = value.map_or_else(String::new, |value| value.to_string());
        table.row([model, direction, &frame, &value, unit, &payload].map(Cell::plain).to_vec());
    }
    table.write(out, Palette::of_stdout())
}
