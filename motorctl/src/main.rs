//! `motorctl`: the tool for operators and scripts. It talks to a running motord through the client crate, and to motors on a bus
//! that no daemon uses.
//!
//! Exit statuses follow sysexits(3): 64 for a wrong call, 65 for a file with mistakes, 69 when no daemon or motor answers, 75
//! when the bus is in use, 77 when it may not be reached, 78 for a configuration with mistakes, 79 when an emergency stop
//! was not confirmed, 1 when it refused, the demo fell short, or `doctor` found something bad.

#![forbid(unsafe_code)]

mod advice;
mod demo;
mod exit_status;
mod explain;
mod failure;
mod fault;
mod history;
mod indicator;
mod instances;
mod joint_report;
mod monitor;
mod operate;
mod report;
mod sim;
mod status;
mod watch;

use clap::{CommandFactory, Parser, Subcommand};
use failure::Failure;
use motord_direct as direct;
use motord_doctor as doctor;
use motord_frame as frame;
use motord_latency as latency;
use motord_record as recorder;
use motord_terminal::{Pages, printable};
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

/// Watches and operates motord, the motor control daemon.
#[derive(Debug, Parser)]
#[command(name = "motorctl", version, max_term_width = 100, after_help = EXAMPLES)]
struct Arguments {
    /// Name of the daemon's instance: `instance` in its configuration.
    #[arg(long, global = true, value_name = "NAME", env = "MOTORD_INSTANCE", default_value = motord_client::DEFAULT_INSTANCE)]
    instance: String,
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples:
  motorctl demo                     run a trot with 12 simulated motors, without a robot
  motorctl status                   show the state of the robot, and the next steps after a stop
  motorctl explain motor-lost       what a name of the log means, and what to do
  motorctl estop                    damp and stop every motor now
  motorctl scan --bus can0          find the motors of a bus, without a daemon
  motorctl --instance arm monitor   watch another daemon on this computer
  motorctl completions bash >m.sh   write the completions for a shell
  motorctl manual man               write the manual pages

Exit status: 0 done; 1 refused, or not as it should be; 64 usage; 65 a file or a frame has mistakes; 69 no daemon, bus or motor
answers; 74 a file or the output cannot be written; 75 another program uses the bus; 77 no permission; 78 a configuration has
mistakes; 79 an emergency stop was not confirmed; 130 interrupted.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Start a daemon with simulated motors, run a trot, and check the result.
    ///
    /// Exit status 0 means: all motors took part, the ticks came at the configured rate within 1 %, at most a tenth of them
    /// was missed, no reply was missed but in their time, and the tracking error of every joint was below 0.05 rad RMS.
    #[command(
        after_help = "Examples:\n  motorctl demo\n  motorctl demo --seconds 60 --json | tail -n 1 | jq .wake_latency_us"
    )]
    Demo {
        /// Duration of the trot, s: 2 to 3600.
        #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = demo::parse_seconds)]
        seconds: f64,
        /// Configuration of the robot: a group `legs` with joints named `fl-hip`, `fl-thigh`, `fl-knee`, `fr-hip` …
        ///
        /// The default is config/quadruped-simulated.toml in the current directory. Where that file does not exist, the
        /// demo uses the copy that is built into motorctl.
        #[arg(long, value_name = "FILE")]
        config: Option<PathBuf>,
        /// Print the result as one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Show the state of the daemon, its groups, joints and buses.
    #[command(
        after_help = "Examples:\n  motorctl status\n  if ! motorctl status --check; then echo \"look at the robot\"; fi\n  motorctl status --json | jq '.groups[] | {name, phase, cause: .stop.cause}'"
    )]
    Status {
        /// Judge the robot, for scripts: print only what is wrong, and end with exit status 1 if anything is.
        ///
        /// Wrong are an emergency stop, a stopped group, a motor that does not answer or reports a fault, and a bus that is not
        /// active. An excluded joint is not wrong.
        #[arg(long)]
        check: bool,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Show the daemons of this computer, whatever their instance and runtime directory.
    #[command(
        after_help = "Examples:\n  motorctl instances\n  motorctl instances --json | jq -r '.[].instance'"
    )]
    Instances {
        /// Print one JSON array.
        #[arg(long)]
        json: bool,
    },
    /// Show the robot on the whole terminal, with keys to stop, disable and reset it.
    ///
    /// SPACE is the emergency stop, without a question; `?` explains the other keys. It also works over ssh, and outlives
    /// restarts of the daemon. Without a terminal use `status` or `watch`.
    #[command(after_help = "Examples:\n  motorctl monitor\n  motorctl --instance arm monitor --hz 4")]
    Monitor {
        /// Refreshes per second, 0.1 to 100.
        #[arg(long, value_name = "HZ", default_value_t = 10.0, value_parser = watch::parse_hz)]
        hz: f64,
    },
    /// Print the state repeatedly until Ctrl-C, also across restarts of the daemon.
    ///
    /// On a terminal, without `--json`, it is `motorctl monitor`.
    #[command(
        after_help = "Examples:\n  motorctl watch --hz 2\n  motorctl watch --json | jq -c '.joints[0].position_rad'"
    )]
    Watch {
        /// Refreshes per second, 0.1 to 100.
        #[arg(long, value_name = "HZ", default_value_t = 10.0, value_parser = watch::parse_hz)]
        hz: f64,
        /// Print one JSON object per refresh.
        #[arg(long)]
        json: bool,
    },
    /// Show the percentiles of all latencies since the daemon started, or log and draw them.
    ///
    /// A missed tick counts as a late wake-up until the cycle after it begins, and as a setpoint that was older by as long; what
    /// was not sent, answered or published for it has no latency.
    ///
    /// With RUN it shows files of earlier runs, and needs no daemon.
    #[command(
        after_help = "Examples:\n  motorctl latency\n  motorctl latency --json | jq .setpoint_age_us.p99_9\n  motorctl latency --watch --interval 0.5 --seconds 1\n  motorctl latency --reset --hlog run.hlog --seconds 1\n  motorctl latency run.hlog --hgrm cycle.hgrm --of cycle\n  motorctl latency run.hlog --svg run.svg --of wake_latency"
    )]
    Latency(latency::Arguments),
    /// Record every cycle to a file: states, setpoints, applied commands and events.
    ///
    /// The file is MCAP, with the schemas of its messages. It can be read while it grows, up to the last second, and after
    /// the recorder was killed. Recording is a process of its own, and slows nothing: what shared memory or the disk cannot take
    /// is counted, in the result and in the file. Two processes may record at a time.
    #[command(
        after_help = "Examples:\n  motorctl record run.mcap --seconds 1\n  motorctl record short.mcap --max-size 100 --seconds 1 --json | jq .recorded"
    )]
    Record(recorder::RecordArguments),
    /// Keep the last seconds of every cycle in memory, and write them to a file after each stop of the robot.
    ///
    /// A stop is a group that was stopped for a cause, or a daemon that died. Files are those of `motorctl record`, named by their
    /// time and cause. It waits for the daemon, and ends with Ctrl-C. What cannot be written is reported and ends nothing. It takes a place
    /// of a recorder.
    #[command(after_help = "Example:\n  motorctl flight . --seconds 30 --files 10")]
    Flight(recorder::FlightArguments),
    /// Show a recording in the monitor, at the speed at which it happened.
    ///
    /// SPACE pauses it, `n` shows the next cycle, `?` explains the other keys. No key reaches a robot. It shows what the states
    /// tell; percentiles of latencies and owners are not in a recording.
    #[command(
        after_help = "Examples:\n  motorctl replay run.mcap\n  motorctl replay run.mcap --from 0.5 --speed 0.1"
    )]
    Replay(monitor::ReplayArguments),
    /// Draw joints of a recording: position, velocity and torque, with setpoints and applied commands, as an SVG.
    ///
    /// `setpoint` is what the owner asked for, `applied` what was sent after all limits, `reported` what the motor answered.
    #[command(
        after_help = "Examples:\n  motorctl plot run.mcap fl-hip fl-knee --svg knees.svg\n  motorctl plot run.mcap fl-knee --from 0.2 --to 0.5 >knee.svg"
    )]
    Plot(recorder::PlotArguments),
    #[command(flatten)]
    Operate(operate::Operate),
    /// List the faults that motors have reported, or handle them.
    ///
    /// Without a command it lists those of all joints, through the daemon.
    #[command(after_help = "Examples:\n  motorctl fault\n  motorctl fault --json | jq '.joints | length'")]
    Fault(FaultArguments),
    /// Store the present position of a stopped joint as its zero, in the motor itself.
    ///
    /// With --bus or --config the command goes to the wire, without a daemon; the motor stops.
    #[command(
        after_help = "Examples:\n  motorctl zero fl-knee --yes\n  motorctl zero --bus can0 --id 3 --at 0.5 --yes"
    )]
    Zero {
        /// Name of the joint, through the daemon.
        #[arg(value_name = "JOINT")]
        name: Option<String>,
        #[command(flatten)]
        target: direct::Target,
        #[command(flatten)]
        zero: direct::Zero,
        #[command(flatten)]
        confirm: direct::Confirm,
    },
    #[command(flatten)]
    Direct(direct::DirectCommand),
    /// Check this computer: is it fit for a real-time cycle, and which commands mend it?
    ///
    /// Reads what the kernel shows, and changes nothing without `--tune`. Then a thread that has what the daemon's cycle would have (SCHED_FIFO,
    /// priority, processor, locked memory, the rate of the configuration) sleeps from tick to tick, and its wake-up latency is
    /// judged. This is left out where motord runs its cycle, which must not be disturbed.
    ///
    /// `bad` means that the cycle would not be real-time, that a bus does not work, or that a tick came too late. `warn` means
    /// that the cycle runs, but later than it could. The latency is good while 99.9 % of the ticks are at most 5 % of the period
    /// late, and all of them at most 20 %; it is bad when 99.9 % are above 20 %, or one is above 50 %. Why: a controller that
    /// divides by the nominal period has 5 % of error in its velocities; a cycle that begins 20 % late meets its next tick when a
    /// reply comes at its deadline of 80 %; and one that begins 50 % late misses it on a bus that is three quarters full.
    ///
    /// Exit status: 0 good or warn, 1 bad.
    #[command(
        after_help = "Examples:\n  motorctl doctor\n  sudo motorctl doctor --config robot.toml --seconds 600\n  sudo motorctl doctor --tune --seconds 0\n  motorctl doctor --seconds 0 --json | jq -r '.findings[] | .level + \" \" + .check'"
    )]
    Doctor(doctor::Arguments),
    /// Explain a name that the log or `status` printed: what happened, what to look at, what to do.
    ///
    /// Names are those of causes of a stop, faults of motors, refusals, and lines of the log (`see=`). The text is that of docs/explain;
    /// no daemon is asked.
    #[command(after_help = "Examples:\n  motorctl explain motor-lost\n  motorctl explain")]
    Explain {
        /// The name; without it every name is listed.
        name: Option<String>,
    },
    /// Give a simulated motor or bus a fault, to try a controller against it.
    ///
    /// Only an instance whose buses are all simulated takes faults, such as that of config/quadruped-simulated.toml.
    #[command(after_help = sim::after_help())]
    Sim(sim::Sim),
    /// Decode and encode motor frames, without a daemon.
    #[command(subcommand)]
    Frame(frame::FrameCommand),
    #[command(flatten)]
    Pages(Pages),
    #[command(hide = true)]
    DemoController { seconds: f64 },
    #[command(hide = true)]
    ChildGuard { parent: u32, program: OsString, arguments: Vec<OsString> },
}

#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
struct FaultArguments {
    #[command(subcommand)]
    command: Option<FaultCommand>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum FaultCommand {
    /// Read the faults of a motor.
    ///
    /// Through the daemon for a joint: those that it knows. With --bus or --config the command goes to the wire, without a daemon. There
    /// a motor in MIT is stopped first, and a motor with a fault may not answer to anything else: name its --protocol then.
    #[command(
        after_help = "Examples:\n  motorctl fault get fl-knee\n  motorctl fault get --bus can0 --id 3 --protocol gim"
    )]
    Get {
        /// Name of the joint, through the daemon.
        #[arg(value_name = "JOINT")]
        name: Option<String>,
        #[command(flatten)]
        reading: direct::ReadArguments,
    },
    /// Clear the fault of a motor. The motor reports it again while its cause remains.
    ///
    /// With --bus or --config the command goes to the wire, without a daemon.
    #[command(
        after_help = "Examples:\n  motorctl fault clear fl-knee\n  motorctl fault clear --bus can0 --id 3"
    )]
    Clear {
        /// Name of the joint, through the daemon.
        #[arg(value_name = "JOINT")]
        name: Option<String>,
        #[command(flatten)]
        target: direct::Target,
    },
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // Help and version come this way too, and go to standard output. A closed pipe is no failure of theirs.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { exit_status::USAGE } else { 0 });
        }
    };
    match run(&arguments.instance, arguments.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) if failure.is_closed_pipe() => ExitCode::SUCCESS,
        Err(failure) if failure.is_printed() => ExitCode::from(failure.status()),
        Err(failure) => {
            eprintln!("motorctl: {}", printable(&failure.to_string()));
            if let Some(others) = failure.is_not_running().then(instances::instead).flatten() {
                eprintln!("motorctl: {}", printable(&others.to_string()));
            }
            ExitCode::from(failure.status())
        }
    }
}

fn run(instance: &str, command: Command) -> Result<(), Failure> {
    match command {
        Command::Demo { seconds, config, json } => Ok(demo::run(seconds, config.as_deref(), json)?),
        Command::Status { check, json } => status::run(instance, check, json),
        Command::Instances { json } => instances::run(json),
        Command::Monitor { hz } => monitor::run(instance, hz),
        Command::Watch { hz, json: false } if monitor::is_there() => monitor::run(instance, hz),
        Command::Watch { hz, json } => watch::run(instance, hz, json),
        Command::Latency(arguments) => Ok(latency::run(instance, &arguments)?),
        Command::Record(arguments) => Ok(recorder::record(instance, &arguments)?),
        Command::Flight(arguments) => Ok(recorder::flight(instance, &arguments)?),
        Command::Replay(arguments) => monitor::replay(&arguments),
        Command::Plot(arguments) => Ok(recorder::plot(&arguments)?),
        Command::Operate(command) => operate::run(instance, command),
        Command::Fault(FaultArguments { command: None, json }) => fault::list(instance, json),
        Command::Fault(FaultArguments { command: Some(FaultCommand::Get { name, reading }), .. }) => {
            get_fault(instance, name, &reading)
        }
        Command::Fault(FaultArguments { command: Some(FaultCommand::Clear { name, target }), .. }) => {
            clear_fault(instance, name, &target)
        }
        Command::Zero { name, target, zero, confirm } => set_zero(instance, name, &target, zero, confirm),
        Command::Direct(direct::DirectCommand::Indicator(asked)) if asked.joint().is_some() => {
            indicator::run(instance, &asked)
        }
        Command::Direct(command) => Ok(direct::run(command)?),
        Command::Doctor(arguments) => Ok(doctor::run(&arguments)?),
        Command::Explain { name } => explain::run(name.as_deref()),
        Command::Sim(fault) => sim::run(instance, &fault),
        Command::Frame(frame) => Ok(frame::run(frame)?),
        Command::Pages(pages) => Ok(pages.write(Arguments::command())?),
        Command::DemoController { seconds } => demo::control(instance, seconds),
        Command::ChildGuard { parent, program, arguments } => {
            Err(demo::guard(parent, &program, &arguments).into())
        }
    }
}

/// Through the daemon for a joint, on the wire for a motor of a bus.
fn get_fault(instance: &str, name: Option<String>, reading: &direct::ReadArguments) -> Result<(), Failure> {
    match name {
        Some(joint) if !reading.target.is_given() => fault::get(instance, &joint, reading.json),
        Some(_) => Err(both()),
        None => Ok(direct::get_fault(reading)?),
    }
}

/// Through the daemon for a joint, on the wire for a motor of a bus.
fn clear_fault(instance: &str, name: Option<String>, target: &direct::Target) -> Result<(), Failure> {
    match name {
        Some(joint) if !target.is_given() => operate::clear_fault(instance, &joint),
        Some(_) => Err(both()),
        None => Ok(direct::clear_fault(target)?),
    }
}

/// Through the daemon for a joint, on the wire for a motor of a bus.
fn set_zero(
    instance: &str,
    name: Option<String>,
    target: &direct::Target,
    zero: direct::Zero,
    confirm: direct::Confirm,
) -> Result<(), Failure> {
    match name {
        Some(_) if target.is_given() => Err(both()),
        Some(joint) if zero.at == 0.0 && !zero.force => operate::zero(instance, &joint, confirm),
        Some(_) => Err(direct::DirectFailure::Usage(
            "--at and --force are for the wire: use them with --config and --joint".into(),
        )
        .into()),
        None => Ok(direct::zero(target, zero, confirm)?),
    }
}

fn both() -> Failure {
    direct::DirectFailure::Usage(
        "JOINT is for the daemon, --bus for the wire: use --config and --joint for a joint on the wire"
            .into(),
    )
    .into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motorctl_lines_for_other_tools_are_accepted() {
        let table = include_str!("../../docs/tools.md");
        let quoted = table.split('`').skip(1).step_by(2);
        let lines: Vec<&str> =
            quoted.filter(|line| line.starts_with("motorctl ") && !line.contains("COMMAND")).collect();
        assert!(lines.len() > 30, "{lines:?}");
        for line in lines {
            let parsed = Arguments::try_parse_from(line.split(' '));
            assert!(parsed.is_ok(), "{line}: {}", parsed.unwrap_err());
        }
    }
}
