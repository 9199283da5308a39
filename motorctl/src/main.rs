//! `motorctl`: the tool for operators and scripts. It uses a running motord through the client
//! crate, and motors on a bus without a daemon.
//!
//! The exit statuses are those of `motord_terminal::exit_status`. 1: a refusal, a failed demo, or a
//! bad verdict of `doctor`.

#![forbid(unsafe_code)]

mod advice;
mod confirmation;
mod demo;
mod estop;
mod exit_status;
mod explain;
mod failure;
mod fault;
mod fleet;
mod health;
mod hold;
mod identify;
mod imu;
mod imu_report;
mod instances;
mod joint_report;
mod monitor;
mod operate;
mod outcome;
mod refusal;
mod report;
mod sim;
mod status;
mod tune;
mod watch;
mod words;

use clap::{CommandFactory, Parser, Subcommand};
use failure::Failure;
use motord_direct as direct;
use motord_doctor as doctor;
use motord_frame as frame;
use motord_latency as latency;
use motord_record as recorder;
use motord_terminal::Pages;
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

/// Watches and operates motord, the motor control daemon.
#[derive(Debug, Parser)]
#[command(name = "motorctl", version, max_term_width = 100, after_help = EXAMPLES)]
struct Arguments {
    /// Name of the daemon's instance: `instance` in its configuration.
    #[arg(long, global = true, value_name = "NAME", env = refusal::INSTANCE, default_value = motord_client::DEFAULT_INSTANCE)]
    instance: String,
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples:
  motorctl demo                     run a trot with 12 simulated motors, without a robot
  motorctl status                   show the state of the robot, and the next steps after a stop
  motorctl explain motor-lost       what a name of the log means, and what to do
  motorctl hold fl-hip --seconds 5  hold a joint softly where it is
  motorctl estop                    damp and stop every motor now
  motorctl scan --bus can0          find the motors of a bus, without a daemon
  motorctl --instance arm monitor   watch another daemon on this computer
  motorctl completions bash >m.sh   write the completions for a shell
  motorctl manual man               write the manual pages

Exit status: 0 done; 1 refused, or not as it should be; 64 usage; 65 a file or a frame has mistakes; 69 no daemon, bus or motor
answers; 74 a file or the output cannot be written; 75 another program uses the bus; 77 no permission; 78 a configuration has
mistakes; 79 an emergency stop was not confirmed; 80 it was, but motors do not answer; 130 interrupted.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Start a daemon with simulated motors, run a trot, and check the result.
    ///
    /// Exit status 0 means: all motors took part, and the ticks had the configured rate within 1 %.
    /// At most 10 % of the ticks were missed, and no replies were missed except during missed
    /// ticks. The tracking error of every joint was below 0.05 rad RMS.
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
        /// For scripts: print only the troubles of the robot, with exit status 1 if there are any.
        ///
        /// Troubles are an emergency stop, a stopped group, a motor that does not answer or reports
        /// a fault, and a bus that is not active. An excluded joint is none.
        #[arg(long)]
        check: bool,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Check whether the robot is fit to be used, and print the reasons if it is not: for scripts and updates.
    ///
    /// The robot is healthy if the daemon answers, no group is stopped, every motor answers without a fault, and every bus and
    /// IMU works. It misses no ticks during --seconds, and runs in real time; a robot on simulated buses need not. The daemon
    /// has the version of this motorctl and the program that is installed, and its configuration file has not changed.
    ///
    /// Exit status: 0 healthy; 1 the robot has troubles, such as a latched stop, a silent motor or a bus that is down; 2 the
    /// cycle is late; 3 the daemon must be restarted, because another version or another configuration is installed; 69 no
    /// daemon answers; 76 the daemon has other versions of the messages; 77 no permission; 130 interrupted. Where several
    /// apply, the status is that of the daemon, otherwise the lowest, and all are printed.
    #[command(
        after_help = "Examples:\n  motorctl health --seconds 1 || motorctl status\n  motorctl health --wait 1 --missed-percent 10 || echo \"roll back\"\n  motorctl health --json >health.json || echo \"not healthy\""
    )]
    Health(health::Arguments),
    /// Show the daemons of this computer, whatever their instance and runtime directory.
    ///
    /// They are those of this user, of root, and of the service. A process of another user may have the name of a daemon.
    #[command(
        after_help = "Examples:\n  motorctl instances\n  motorctl instances --json | jq -r '.[].instance'"
    )]
    Instances {
        /// Also show processes of other users, which may be no daemons.
        #[arg(long)]
        all: bool,
        /// Print one JSON array.
        #[arg(long)]
        json: bool,
    },
    /// Show the robot on the whole terminal, with keys to stop, disable and reset it.
    ///
    /// SPACE requests an emergency stop immediately; `?` explains the other keys. A large terminal also shows curves of position,
    /// velocity and torque, with limits, stops and faults. The monitor also works over ssh and across restarts of the daemon.
    /// Without a terminal use `status` or `watch`. `NO_COLOR` removes its colours.
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
    /// A missed tick counts as a wake-up that is late until the next cycle begins. The age of its
    /// setpoint grows by the same time. Commands, replies and publications that did not take place
    /// have no latency.
    ///
    /// With RUN the command shows files of earlier runs, without a daemon.
    #[command(
        after_help = "Examples:\n  motorctl latency\n  motorctl latency --json | jq .setpoint_age_us.p99_9\n  motorctl latency --watch --interval 0.5 --seconds 1\n  motorctl latency --reset --hlog run.hlog --seconds 1\n  motorctl latency run.hlog --hgrm cycle.hgrm --of cycle\n  motorctl latency run.hlog --svg run.svg --of wake_latency"
    )]
    Latency(latency::Arguments),
    /// Record every cycle to a file: states, setpoints, applied commands and events.
    ///
    /// The file is MCAP, with the schemas of its messages. It is readable while it grows, up to the
    /// last second, and after the recorder was killed. Recording runs in a separate process and
    /// does not delay the daemon. Records that shared memory or the disk cannot take are counted,
    /// in the result and in the file. At most two processes record at a time.
    #[command(
        after_help = "Examples:\n  motorctl record run.mcap --seconds 1\n  motorctl record short.mcap --max-size 100 --seconds 1 --json | jq .recorded"
    )]
    Record(recorder::RecordArguments),
    /// Keep the last seconds of every cycle in memory, and write them to a file after each stop of the robot.
    ///
    /// A stop is a group that was stopped for a cause, or a daemon that died. The files have the
    /// format of `motorctl record` and are named by time and cause. The command waits for the
    /// daemon, and ends at Ctrl-C. It reports a file that it cannot write, and continues. It counts
    /// as one of the two recorders.
    #[command(after_help = "Example:\n  motorctl flight . --seconds 30 --files 10")]
    Flight(recorder::FlightArguments),
    /// Show a recording in the monitor, at the speed at which it happened.
    ///
    /// SPACE pauses the recording, `n` shows the next cycle, `?` explains the other keys. No key
    /// reaches a robot. A recording has no percentiles of latencies and no owners.
    #[command(
        after_help = "Examples:\n  motorctl replay run.mcap\n  motorctl replay run.mcap --from 0.5 --speed 0.1"
    )]
    Replay(monitor::ReplayArguments),
    /// Draw joints of a recording: position, velocity and torque, with setpoints and applied commands, as an SVG or a PNG.
    ///
    /// `setpoint` is the owner's request, `applied` the command after all limits, `reported` the
    /// motor's answer.
    #[command(
        after_help = "Examples:\n  motorctl plot run.mcap fl-hip fl-knee --svg knees.svg\n  motorctl plot run.mcap fl-knee --from 0.2 --to 0.5 >knee.svg\n  motorctl plot run.mcap base --svg imu.svg\n  motorctl plot run.mcap --with run.mcap fl-knee --png both.png"
    )]
    Plot(recorder::PlotArguments),
    /// Hold joints softly where they are, or move them along a small sine: the first motion of a robot.
    ///
    /// The command is a controller: it claims the group, starts its motors, and holds their
    /// measured positions. Stiffness, damping and amplitude rise from zero in a second. If NAME is a
    /// joint, the other joints of its group are only damped. Ctrl-C and the end of the time damp and
    /// stop the motors.
    ///
    /// A group that is stopped, or that another process owns, is refused, and nothing moves. Keep a
    /// hand on the switch that cuts the power.
    #[command(
        after_help = "Examples:\n  motorctl hold fl-knee --seconds 1\n  motorctl hold legs --kp 10 --kd 1 --seconds 1\n  motorctl hold fl-knee --amplitude-rad 0.1 --frequency-hz 0.5 --seconds 1\n  motorctl hold fl-knee --seconds 1 --json | jq '.joints[0].position_rad'"
    )]
    Hold(hold::HoldArguments),
    /// Measure inertia, friction and delay of a joint, by moving it around where it is.
    ///
    /// The command claims the group of the joint, starts its motors, and moves the joint along a sum of sines, then at constant
    /// velocities in both directions. Every setpoint keeps a margin to the limits of the configuration. The other joints of the
    /// group are only damped. Ctrl-C, an emergency stop and the end of the time damp and stop the motors. Then the command fits
    /// the motion, and prints each value with its 95 % interval, or why the motion does not show it. It also prints the lines
    /// of `[motor.simulation]` with which `motord run`, the twin and `fit_mjcf` simulate this joint.
    ///
    /// The fit has inertia, viscous and Coulomb friction, and gravity; where the motion shows them, also friction that falls
    /// with the speed (Stribeck), a spring, a torque by position (cogging), and a lag. A note names each of these. A joint that
    /// does not fit all this, such as one with play, has no values. Missed ticks, late and missing replies are counted; where
    /// more than a tenth is missing, nothing is fitted.
    ///
    /// Hang the robot up, or free the joint: a leg that touches the ground is another mechanism. The other joints must not move.
    /// Torques are those that the motor reports; --known-load measures their scale.
    ///
    /// Exit status: 0 the inertia was identified; 1 it was not: the joint does not fit, its motion does not show the inertia,
    /// too much is missing, or the group was stopped; 130 interrupted, and the group is stopped.
    #[command(
        after_help = "Examples:\n  motorctl identify fl-knee --yes --seconds 10\n  motorctl identify fl-knee --amplitude-rad 0.2 --seconds 10 --yes --json | jq .inertia_kg_m2"
    )]
    Identify(identify::Arguments),
    /// Measure how a joint answers small steps, and propose stiffness and damping for a bandwidth.
    ///
    /// The command claims the group of the joint and starts its motors. It identifies the joint for 14 s as `identify` does,
    /// or takes its inertia from --identified. Then it steps the joint up, back, down and back by --step-rad. It prints rise,
    /// overshoot, settling, ring, damping ratio, error and torque of the mean response. The other joints of the group are only
    /// damped. Ctrl-C, an emergency stop and the end damp and stop the motors.
    ///
    /// The proposal is kp = inertia · ω², kd = 2 · damping ratio · inertia · ω - friction, with ω = 2π · bandwidth. Where the
    /// limits of the gains, the codes of the velocity (native protocol), or the delay of the loop forbid that, the bandwidth is lower: every
    /// proposal has a phase margin of at least 45°. --try steps with the gains of half its bandwidth, then with the proposal.
    ///
    /// Steps that do not fit the limits of position and torque are refused, and nothing moves. The speed and the margin of
    /// --kp and --kd need the inertia: without --identified they are refused after the identification. A joint that moves
    /// further than twice the step beyond its begin and its setpoint, or goes on to swing, ends the motion. Hang the robot up, or free the joint.
    ///
    /// Exit status: 0 gains were proposed; 1 they were not; 64 the steps do not fit; 65 the file of --identified cannot be used;
    /// 74 the picture cannot be written; 130 interrupted, and the group is stopped.
    #[command(
        after_help = "Examples:\n  motorctl tune fl-knee --yes\n  motorctl tune fl-knee --bandwidth 8 --kp 20 --kd 0.2 --try --yes --svg tune.svg\n  motorctl tune fl-knee --bandwidth 5 --yes --json | jq .proposed"
    )]
    Tune(tune::Arguments),
    #[command(flatten)]
    Operate(operate::Operate),
    /// List the faults that motors have reported, or handle them.
    ///
    /// Without a subcommand, the daemon's list of the faults of all joints.
    #[command(after_help = "Examples:\n  motorctl fault\n  motorctl fault --json | jq '.joints | length'")]
    Fault(FaultArguments),
    /// Store the present position of a stopped joint as its zero, in the motor itself.
    ///
    /// With --bus or --config the command uses the bus without a daemon; the motor stops.
    #[command(
        after_help = "Examples:\n  motorctl zero fl-hip --yes\n  motorctl zero --bus can0 --id 3 --at 0.5 --yes"
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
    /// Find IMUs on serial ports, and measure the mount of one.
    #[command(subcommand)]
    Imu(imu::ImuCommand),
    /// Check whether this computer is fit for a real-time cycle, and print the commands that fix
    /// it.
    ///
    /// The checks read files of the kernel, and change nothing without `--tune`. Then a thread with
    /// the settings of the daemon's cycle (SCHED_FIFO, priority, processor, locked memory, the rate
    /// of the configuration) sleeps from tick to tick, and its wake-up latency is judged. The
    /// measurement is skipped while motord runs its cycle.
    ///
    /// `bad` means that the cycle would not be real-time, that a bus does not work, or that a tick
    /// was too late. `warn` means that the cycle runs, but later than possible. The latency is good
    /// if 99.9 % of the ticks are at most 5 % of the period late, and all of them at most 20 %. It
    /// is bad if 99.9 % are above 20 %, or one is above 50 %. At 5 %, a controller that divides by
    /// the nominal period has 5 % of error in its velocities. A cycle that begins 20 % late reaches
    /// its next tick if a reply arrives at its deadline of 80 %. A cycle that begins 50 % late
    /// misses it on a bus that is 75 % full.
    ///
    /// Exit status: 0 good or warn, 1 bad.
    #[command(
        after_help = "Examples:\n  motorctl doctor\n  sudo motorctl doctor --config robot.toml --seconds 600\n  sudo motorctl doctor --tune --seconds 0\n  motorctl doctor --seconds 0 --json | jq -r '.findings[] | .level + \" \" + .check'"
    )]
    Doctor(doctor::Arguments),
    /// List the robots of a network, or stop them: `motord-remote fleet`.
    ///
    /// All arguments are passed on, so `motorctl fleet -- --help` is the help of that program.
    #[command(
        after_help = "Examples:\n  motorctl fleet list\n  motorctl fleet list --json | jq length\n  motorctl fleet stop --all"
    )]
    Fleet {
        /// The arguments of `motord-remote fleet`.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, required = true, value_name = "ARGUMENT")]
        arguments: Vec<std::ffi::OsString>,
    },
    /// Explain a name from the log or from `status`: what happened, what to check, and what to do.
    ///
    /// The names are causes of a stop, faults of motors, refusals, and lines of the log (`see=`).
    /// The text is that of docs/explain. No daemon is needed.
    #[command(after_help = "Examples:\n  motorctl explain motor-lost\n  motorctl explain")]
    Explain {
        /// The name. Without it the command lists all names.
        name: Option<String>,
    },
    /// Inject a fault into a simulated motor, bus or IMU, to test a controller.
    ///
    /// Only an instance with simulated buses accepts faults, such as that of
    /// config/quadruped-simulated.toml.
    #[command(after_help = sim::after_help())]
    Sim(sim::Sim),
    /// Decode and encode motor frames, without a daemon.
    #[command(subcommand)]
    Frame(frame::FrameCommand),
    /// List the known motors, print the file of a vendor, or check one.
    Models(frame::ModelsArguments),
    #[command(flatten)]
    Pages(Pages),
    /// Print the words that may follow on a command line, for the completions of a shell.
    #[command(hide = true)]
    CompleteWords {
        /// The words before the cursor, the begun one included, without the program.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        line: Vec<String>,
    },
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
    /// For a joint, the daemon returns the faults that it knows. With --bus or --config the command
    /// uses the bus without a daemon. There a motor in MIT mode is stopped first. A motor with a
    /// fault may answer nothing else: set its --protocol then.
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
    /// With --bus or --config the command uses the bus without a daemon.
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
        Err(error) => return refusal::exit(&error),
    };
    outcome::exit_status_of(run(&arguments.instance, arguments.command))
}

fn run(instance: &str, command: Command) -> Result<(), Failure> {
    match command {
        Command::Demo { seconds, config, json } => Ok(demo::run(seconds, config.as_deref(), json)?),
        Command::Status { check, json } => status::run(instance, check, json),
        Command::Health(arguments) => health::run(instance, &arguments),
        Command::Instances { json, all } => instances::run(json, all),
        Command::Monitor { hz } => monitor::run(instance, hz),
        Command::Watch { hz, json: false } if monitor::is_there() => monitor::run(instance, hz),
        Command::Watch { hz, json } => watch::run(instance, hz, json),
        Command::Latency(arguments) => Ok(latency::run(instance, &arguments)?),
        Command::Record(arguments) => Ok(recorder::record(instance, &arguments)?),
        Command::Flight(arguments) => Ok(recorder::flight(instance, &arguments)?),
        Command::Replay(arguments) => monitor::replay(&arguments),
        Command::Plot(arguments) => Ok(recorder::plot(&arguments)?),
        Command::Hold(arguments) => hold::run(instance, &arguments),
        Command::Identify(arguments) => identify::run(instance, &arguments),
        Command::Tune(arguments) => tune::run(instance, &arguments),
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
            fault::print_indicators(instance, &asked)
        }
        Command::Direct(command) => Ok(direct::run(command)?),
        Command::Imu(command) => imu::run(instance, &command),
        Command::Fleet { arguments } => fleet::run(&arguments),
        Command::Doctor(arguments) => run_doctor(instance, &arguments),
        Command::Explain { name } => explain::run(name.as_deref()),
        Command::Sim(fault) => sim::run(instance, &fault),
        Command::Frame(frame) => Ok(frame::run(frame)?),
        Command::Models(models) => Ok(frame::run_models(&models)?),
        Command::Pages(pages) => Ok(pages.write(Arguments::command())?),
        Command::CompleteWords { line } => {
            words::print(&Arguments::command(), instance, &line);
            Ok(())
        }
        Command::DemoController { seconds } => demo::control(instance, seconds),
        Command::ChildGuard { parent, program, arguments } => {
            Err(demo::guard(parent, &program, &arguments).into())
        }
    }
}

fn run_doctor(instance: &str, arguments: &doctor::Arguments) -> Result<(), Failure> {
    let running = motord_client::running_instances().into_iter();
    let running: Vec<_> = running.map(|running| (running.name, running.pid)).collect();
    let of_daemon = imu::findings(instance);
    let instance = Some(instance).filter(|name| *name != motord_client::DEFAULT_INSTANCE);
    Ok(doctor::run(arguments, doctor::Daemons { instance, running: &running }, of_daemon)?)
}

/// Uses the daemon for a joint, and the bus for a motor of a bus.
fn get_fault(instance: &str, name: Option<String>, reading: &direct::ReadArguments) -> Result<(), Failure> {
    match name {
        Some(joint) if !reading.target.is_given() => fault::get(instance, &joint, reading.json),
        Some(_) => Err(both()),
        None => Ok(direct::get_fault(reading)?),
    }
}

/// Uses the daemon for a joint, and the bus for a motor of a bus.
fn clear_fault(instance: &str, name: Option<String>, target: &direct::Target) -> Result<(), Failure> {
    match name {
        Some(joint) if !target.is_given() => operate::clear_fault(instance, &joint),
        Some(_) => Err(both()),
        None => Ok(direct::clear_fault(target)?),
    }
}

/// Uses the daemon for a joint, and the bus for a motor of a bus.
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
            "--at and --force need a bus: use them with --config and --joint".into(),
        )
        .into()),
        None => Ok(direct::zero(target, zero, confirm)?),
    }
}

fn both() -> Failure {
    direct::DirectFailure::Usage(
        "JOINT selects the daemon, --bus a bus: use --config and --joint for a joint on a bus".into(),
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
