//! The options of `motord init`.

use super::{Configuration, Connection, Draft, InitError, questions};
use clap::builder::PossibleValuesParser;
use motord_protocol::FAMILIES;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;

/// The command line. Questions or defaults give the rest.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Legs, 1 to 8. One leg is an arm.
    #[arg(long, value_name = "N")]
    legs: Option<usize>,
    /// Joints of each leg.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    joints: Vec<String>,
    /// Model of the motors.
    #[arg(long, value_name = "NAME")]
    model: Option<String>,
    /// Protocol that the motors on CAN are set to: `gim` is SteadyWin's native protocol, and the only one of a serial line.
    #[arg(long, value_name = "NAME", value_parser = PossibleValuesParser::new(FAMILIES.iter().map(|(name, _)| *name)))]
    protocol: Option<String>,
    /// CAN interfaces and serial devices. Neighbouring legs share a bus where there are fewer buses than legs.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', conflicts_with = "simulated")]
    buses: Vec<String>,
    /// Simulated motors inside the daemon.
    #[arg(long)]
    simulated: bool,
    /// Cycles per second. The default is the highest rate, up to 1000, for which the buses have time.
    #[arg(long, value_name = "HZ")]
    rate_hz: Option<f64>,
    /// The file to write. Without it, asks for one on a terminal; elsewhere, and with --yes, writes to standard output.
    #[arg(long, value_name = "FILE")]
    file: Option<PathBuf>,
    /// Replace an existing file.
    #[arg(long, requires = "file")]
    force: bool,
    /// Ask nothing: take the defaults of what the options do not say.
    #[arg(long)]
    yes: bool,
}

impl Options {
    /// The options and defaults. Asks on a terminal, unless legs, model and buses are given, or `--yes`.
    fn draft(&self) -> Result<Draft, InitError> {
        let legs = self.legs.unwrap_or(4);
        let names = ["hip", "thigh", "knee"].map(str::to_owned).to_vec();
        let connection = match &self.buses[..] {
            [] if self.simulated => Connection::Simulated,
            [] => Connection::one_bus_each(legs),
            buses => Connection::Buses(buses.to_vec()),
        };
        let draft = Draft {
            legs,
            joints: if self.joints.is_empty() { names } else { self.joints.clone() },
            model: self.model.clone().unwrap_or_else(|| "GIM8108-8".into()),
            protocol: self.protocol.as_deref().and_then(|name| name.parse().ok()).unwrap_or_default(),
            connection,
        };
        let is_complete =
            self.legs.is_some() && self.model.is_some() && (self.simulated || !self.buses.is_empty());
        if self.yes || is_complete || !std::io::stdin().is_terminal() {
            Ok(draft)
        } else {
            questions::ask(draft)
        }
    }

    /// The file to write, and whether it may be replaced; `None` for standard output.
    fn destination(&self) -> Result<Option<(PathBuf, bool)>, InitError> {
        match &self.file {
            Some(file) => Ok(Some((file.clone(), self.force))),
            None if self.yes || !std::io::stdin().is_terminal() || !std::io::stdout().is_terminal() => {
                Ok(None)
            }
            None => questions::ask_file().map(Some),
        }
    }

    /// Writes the configuration, and says the next step.
    ///
    /// # Errors
    ///
    /// Why none is written.
    pub fn run(&self) -> Result<(), InitError> {
        let configuration = Configuration::of(&self.draft()?, self.rate_hz)?;
        let Some((file, force)) = self.destination()? else {
            let _closed_pipe = std::io::stdout().write_all(configuration.text.as_bytes());
            return Ok(());
        };
        configuration.write(&file, force)?;
        let _closed_pipe = writeln!(std::io::stdout(), "{}", configuration.summary(&file));
        Ok(())
    }
}
