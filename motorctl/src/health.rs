//! `motorctl health`: whether the robot is fit to be used, with an exit status for scripts, such as
//! those of an update.

use crate::failure::{CommandFailure, Failure};
use crate::report::RobotReport;
use crate::status::{self, History, TIMEOUT};
use motord_client::{Error, RobotDescription};
use motord_terminal::{Cell, Colour, Interrupt, Palette, json, printable, within};
use serde::Serialize;
use std::io::{self, Write};
use std::path::Path;
use std::time::{Duration, Instant};

/// The daemon must be restarted: it is not what is installed.
const RESTART: u8 = 3;
/// The cycle is not in time.
const LATE: u8 = 2;
/// The robot has troubles.
const TROUBLED: u8 = 1;
/// Time between two checks of `--wait`.
const AGAIN: Duration = Duration::from_millis(500);

/// The arguments of the command.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Arguments {
    /// Duration of the count of missed ticks, s: 0.1 to 3600.
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = parse_seconds)]
    seconds: f64,
    /// Largest healthy share of missed ticks, %: 0 to 100.
    #[arg(long, value_name = "P", default_value_t = 1.0, value_parser = parse_percent)]
    missed_percent: f64,
    /// Check again for at most this time, s, until the robot is healthy: 0 to 3600.
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = parse_wait)]
    wait: f64,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    within(text, 0.1, 3600.0)
}

fn parse_percent(text: &str) -> Result<f64, String> {
    within(text, 0.0, 100.0)
}

fn parse_wait(text: &str) -> Result<f64, String> {
    within(text, 0.0, 3600.0)
}

/// A reason why the robot is not healthy.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Finding {
    /// `daemon`, `robot`, `ticks`, `real-time`, `version`, `program` or `configuration`.
    check: &'static str,
    /// Exit status that the finding alone has.
    status: u8,
    /// The reason, and the remedy.
    sentence: String,
}

impl Finding {
    fn new(check: &'static str, status: u8, sentence: impl Into<String>) -> Self {
        Self { check, status, sentence: sentence.into() }
    }
}

/// The result of the checks, as `--json` prints it.
#[derive(Debug, Default, Serialize)]
struct Health {
    /// The instance.
    instance: String,
    /// There is no finding.
    healthy: bool,
    /// Exit status of the command.
    status: u8,
    /// Version of the daemon; `null` without one.
    version: Option<String>,
    /// Version of this motorctl.
    installed_version: &'static str,
    /// Ticks during the count.
    ticks: u64,
    /// Those of them that were missed.
    missed: u64,
    /// Every reason why the robot is not healthy.
    findings: Vec<Finding>,
}

impl Health {
    fn new(instance: &str) -> Self {
        let installed_version = env!("CARGO_PKG_VERSION");
        Self { instance: instance.to_owned(), installed_version, ..Self::default() }
    }

    /// Checks the daemon of `instance`, for the time of the count.
    fn checked(instance: &str, arguments: &Arguments, interrupt: &Interrupt) -> Self {
        let mut health = Self::new(instance);
        if let Err(error) = health.add_findings(arguments, interrupt) {
            health.findings.push(Finding::new("daemon", error.exit_status(), error.to_string()));
        }
        // A daemon that does not answer hides everything else. Then the robot counts, then its time.
        health.status = health.findings.iter().map(|finding| finding.status).min_by_key(rank).unwrap_or(0);
        health.healthy = health.findings.is_empty();
        health
    }

    fn add_findings(&mut self, arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Error> {
        let client = status::connect(&self.instance)?;
        let robot = client.description();
        self.version = Some(robot.version.clone());
        let before = client.wait(TIMEOUT)?;
        interrupt.pause_until(Instant::now() + Duration::from_secs_f64(arguments.seconds));
        let state = client.wait(TIMEOUT)?;
        self.ticks = state.cycle().saturating_sub(before.cycle());
        self.missed = state.overruns().saturating_sub(before.overruns());
        let mut report = RobotReport::new(&robot, &state);
        report.add_history(&robot, History::default().telemetry(&client, &state));
        self.findings
            .extend(report.troubles().into_iter().map(|trouble| Finding::new("robot", TROUBLED, trouble)));
        self.findings.extend(self.late(&report, &robot, arguments));
        self.findings.extend(self.obsolete(&report));
        Ok(())
    }

    /// Returns why the cycle is not in time.
    fn late(&self, report: &RobotReport, robot: &RobotDescription, arguments: &Arguments) -> Vec<Finding> {
        let mut findings = Vec::new();
        let Self { ticks, missed, .. } = self;
        if 100.0 * *missed as f64 > arguments.missed_percent * *ticks as f64 {
            let text =
                format!("{missed} of {ticks} ticks were missed: `motorctl doctor` checks the computer.");
            findings.push(Finding::new("ticks", LATE, text));
        }
        // A simulated robot needs no permission.
        let is_simulated = robot.devices.iter().all(String::is_empty);
        if !report.realtime && !is_simulated {
            let text =
                "The cycle has no real-time scheduling or no locked memory: start the daemon by its service.";
            findings.push(Finding::new("real-time", LATE, text));
        }
        findings
    }

    /// Returns how the running daemon differs from what is installed.
    fn obsolete(&self, report: &RobotReport) -> Vec<Finding> {
        let mut findings = Vec::new();
        let RobotReport { version, pid, .. } = report;
        if *version != self.installed_version {
            let installed = self.installed_version;
            let text =
                format!("The daemon is motord {version}, and motorctl is {installed}: restart the daemon.");
            findings.push(Finding::new("version", RESTART, text));
        } else if is_replaced(*pid) {
            let text = "The program of the daemon was replaced after its start: restart the daemon.";
            findings.push(Finding::new("program", RESTART, text));
        }
        if report.config_changed {
            let text = "The configuration file has changed after the start: restart the daemon to use it.";
            findings.push(Finding::new("configuration", RESTART, text));
        }
        findings
    }

    fn write(&self, out: &mut dyn Write, palette: Palette) -> io::Result<()> {
        for Finding { check, sentence, .. } in &self.findings {
            let name = palette.paint(&Cell::new(format!("{check}:"), Colour::Red));
            writeln!(out, "{name} {}", printable(sentence))?;
        }
        if self.healthy {
            let Self { instance, installed_version, ticks, missed, .. } = self;
            let instance = printable(instance);
            writeln!(
                out,
                "{instance} is healthy: motord {installed_version}, {missed} of {ticks} ticks missed"
            )?;
        }
        Ok(())
    }
}

/// Returns the order of an exit status: the smallest decides.
fn rank(status: &u8) -> (bool, u8) {
    (*status <= RESTART, *status)
}

/// Returns true if the file of a process's program was removed or replaced. Only root and the user
/// of the process can read that; for others it is false.
fn is_replaced(pid: u32) -> bool {
    let program = std::fs::read_link(Path::new("/proc").join(pid.to_string()).join("exe"));
    program.is_ok_and(|program| program.to_string_lossy().ends_with(" (deleted)"))
}

/// The robot is not healthy. The reasons were printed.
#[derive(Debug, thiserror::Error)]
#[error("the robot is not healthy")]
struct Unhealthy(u8);

impl CommandFailure for Unhealthy {
    fn status(&self) -> u8 {
        self.0
    }

    fn is_printed(&self) -> bool {
        true
    }
}

/// Checks the robot, again until it is healthy or the time of `--wait` is over, and prints the
/// last result.
///
/// # Errors
///
/// A finding, with its exit status; a signal; the output cannot be written.
pub(crate) fn run(instance: &str, arguments: &Arguments) -> Result<(), Failure> {
    let interrupt = Interrupt::register();
    let end = Instant::now() + Duration::from_secs_f64(arguments.wait);
    let health = loop {
        let health = Health::checked(instance, arguments, &interrupt);
        if interrupt.is_raised() {
            return Err(Failure::Interrupted);
        }
        if health.healthy || Instant::now() >= end {
            break health;
        }
        interrupt.pause_until(end.min(Instant::now() + AGAIN));
    };
    let out = &mut io::stdout().lock();
    match arguments.json {
        true => json::write_line(out, &health)?,
        false => health.write(out, Palette::of_stdout())?,
    }
    if health.healthy { Ok(()) } else { Err(Unhealthy(health.status).into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn daemon_counts_before_robot_and_time() {
        let status = |statuses: &[u8]| statuses.iter().copied().min_by_key(rank);
        assert_eq!(status(&[RESTART, TROUBLED, LATE]), Some(TROUBLED));
        assert_eq!(status(&[RESTART, LATE]), Some(LATE));
        assert_eq!(status(&[TROUBLED, 69]), Some(69));
    }

    #[test]
    fn other_version_or_configuration_needs_a_restart() {
        let health = Health::new("robot");
        let installed = health.installed_version.to_owned();
        let report = |version: &str, config_changed| RobotReport {
            version: version.to_owned(),
            config_changed,
            pid: std::process::id(),
            ..RobotReport::default()
        };
        let checks =
            |report| health.obsolete(&report).iter().map(|finding| finding.check).collect::<Vec<_>>();
        assert_eq!(checks(report(&installed, false)), Vec::<&str>::new());
        assert_eq!(checks(report("0.0.1", true)), ["version", "configuration"]);
    }

    #[test]
    fn cycle_of_a_robot_must_be_in_time() {
        let health = Health { ticks: 1000, missed: 11, ..Health::new("robot") };
        let arguments = Arguments { seconds: 1.0, missed_percent: 1.0, wait: 0.0, json: false };
        let robot = |device: &str| RobotDescription {
            devices: vec![device.to_owned()],
            ..RobotDescription::default()
        };
        let checks = |robot: &RobotDescription, arguments: &Arguments| {
            let findings = health.late(&RobotReport::default(), robot, arguments);
            findings.iter().map(|finding| finding.check).collect::<Vec<_>>()
        };
        assert_eq!(checks(&robot("can0"), &arguments), ["ticks", "real-time"]);
        assert_eq!(checks(&robot(""), &Arguments { missed_percent: 1.1, ..arguments }), Vec::<&str>::new());
    }
}
