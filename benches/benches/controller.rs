//! The share of setpoints that miss the next cycle, for a controller that computes for a given
//! time.
//!
//! A whole daemon at its default settings runs the simulated quadruped at 1 kHz. A controller in a
//! separate process waits for each state, computes, and sends. The controller counts everything
//! from the states. It runs with `SCHED_FIFO` below the daemon's threads where permitted, to
//! exclude the load of other processes.

use clap::Parser;
use motord::buses;
use motord::threads::Daemon;
use motord_client::{Claim, Client, Error, Phase, State};
use motord_configuration::{self as config, Machine};
use motord_ports::instance::Instance;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

const CONFIG: &str = include_str!("../../config/quadruped-simulated.toml");
const INSTANCE: &str = "demo";
const GROUP: &str = "legs";
/// `SCHED_FIFO` priority of the controller: below the daemon's threads.
const PRIORITY: &str = "60";
const TIMEOUT: Duration = Duration::from_secs(5);
/// Number of setpoints remembered until a cycle uses them.
const REMEMBERED: usize = 64;
const HEADING: &str = "\
computing     used     late   control  latency     state delivery  last reply to states     cycle
       µs                 %    p50 µs   p99 µs    p50 µs   p99 µs    p50 µs   p99 µs       µs";

/// Missing options keep the default settings of the daemon.
#[derive(Parser)]
struct Options {
    /// Computing times of the controller, µs.
    #[arg(default_values_t = [0, 50, 100, 130, 150, 200, 250, 300, 400])]
    computing: Vec<u64>,
    /// Length of each measurement, s.
    #[arg(long, default_value_t = 4.0)]
    seconds: f64,
    /// A line of `[cycle]`, such as `cpu=1`.
    #[arg(long, value_name = "KEY=VALUE")]
    cycle: Vec<String>,
    /// A line of `[ipc]`, such as `lead-us=100`.
    #[arg(long, value_name = "KEY=VALUE")]
    ipc: Vec<String>,
    /// Runs only a short check of each measurement.
    #[arg(long)]
    test: bool,
    /// Passed by cargo.
    #[arg(long, hide = true)]
    bench: bool,
    /// Runs the controller of the daemon in this runtime directory.
    #[arg(long, hide = true)]
    runtime: Option<PathBuf>,
}

fn main() {
    let mut options = Options::parse();
    if options.test {
        (options.seconds, options.computing) = (0.1, vec![0]);
    }
    match &options.runtime {
        Some(runtime) => control(runtime, &options).expect("the daemon runs"),
        None => measure(&options),
    }
}

/// Runs the daemon, and the controllers one after the other.
fn measure(options: &Options) {
    let runtime = tempfile::tempdir().expect("the temporary directory is writable");
    let text = configured(options);
    let settings = config::parse(Path::new("bench.toml"), text.as_bytes(), &Machine::here())
        .expect("the shipped configuration is sound")
        .settings;
    let lock = Instance::below(runtime.path(), INSTANCE).and_then(|instance| instance.lock());
    let lock = Arc::new(lock.expect("the directory is ours"));
    let buses = buses::open(&settings).expect("simulated buses open");
    let rate = settings.cycle.rate_hz;
    let daemon = Daemon::start(settings, None, buses, &lock, None).expect("the daemon starts");
    println!("{HEADING}");
    for computing in &options.computing {
        let seconds = options.seconds.to_string();
        let here = std::env::current_exe().expect("the kernel tells");
        let runtime = runtime.path().to_str().expect("a path of ASCII");
        let arguments = ["--runtime", runtime, "--seconds", &seconds, &computing.to_string()];
        let is_permitted = Command::new("chrt").args(["-f", PRIORITY, "true"]).status();
        let mut controller = match is_permitted {
            Ok(status) if status.success() => {
                let mut command = Command::new("chrt");
                command.args(["-f", PRIORITY]).arg(here);
                command
            }
            _ => Command::new(here),
        };
        let (begun, before) = (Instant::now(), processor_time());
        let output = controller.args(arguments).output().expect("this program starts again");
        assert!(
            output.status.success(),
            "the controller failed: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        let row = String::from_utf8_lossy(&output.stdout);
        let ticks = begun.elapsed().as_secs_f64() * rate;
        println!("{}  {:>8.1}", row.trim_end(), (processor_time() - before) / ticks);
    }
    daemon.end().expect("the motors stop");
}

/// Returns the processor time of the cycle thread, µs, from the kernel.
fn processor_time() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").expect("this process has threads").flatten();
    let read =
        |task: &std::fs::DirEntry, name| std::fs::read_to_string(task.path().join(name)).unwrap_or_default();
    let cycle = tasks.into_iter().find(|task| read(task, "comm").trim() == "motord-cycle").expect("it runs");
    let nanos = read(&cycle, "schedstat").split(' ').next().and_then(|time| time.parse::<f64>().ok());
    nanos.unwrap_or(f64::NAN) / 1e3
}

fn configured(options: &Options) -> String {
    let (cycle, ipc) = (options.cycle.join("\n"), options.ipc.join("\n"));
    let text = CONFIG.replacen("[cycle]\n", &format!("[cycle]\n{cycle}\n"), 1);
    text.replacen("[safety]\n", &format!("[ipc]\n{ipc}\n[safety]\n"), 1)
}

/// Holds the robot in position, and prints a row about its own setpoints.
fn control(runtime: &Path, options: &Options) -> Result<(), Error> {
    let client = Client::connect_in(runtime, INSTANCE)?;
    client.set_silence(TIMEOUT);
    let mut claim = start(&client)?;
    let mut watch = Watch::new(settled(&client)?);
    let computing = Duration::from_micros(options.computing[0]);
    let end = Instant::now() + Duration::from_secs_f64(options.seconds);
    while Instant::now() < end {
        let state = client.wait(TIMEOUT)?;
        let woken = Instant::now();
        watch.take(&state);
        while woken.elapsed() < computing {
            std::hint::spin_loop();
        }
        claim.commit()?;
        watch.sent(&state);
    }
    watch.print(options.computing[0]);
    claim.disable()?;
    claim.wait_for(Phase::Disarmed, TIMEOUT)
}

/// Starts the group and returns once it is active.
fn start(client: &Client) -> Result<Claim, Error> {
    let begun = Instant::now();
    loop {
        let mut claim = client.claim(GROUP)?;
        let state = client.wait(TIMEOUT)?;
        let started = claim
            .hold(&state, 40.0, 1.0)
            .and_then(|()| claim.commit())
            .and_then(|()| claim.enable())
            .and_then(|()| claim.wait_for(Phase::Active, TIMEOUT));
        match started {
            Ok(()) => return Ok(claim),
            Err(error) if begun.elapsed() > TIMEOUT => return Err(error),
            // The motors have not answered yet.
            Err(_) => std::thread::sleep(Duration::from_millis(50)),
        }
    }
}

/// Returns the sequence number of the last setpoint, once it is in use.
fn settled(client: &Client) -> Result<u64, Error> {
    for _ in 0..5 {
        client.wait(TIMEOUT)?;
    }
    Ok(client.wait(TIMEOUT)?.group(0).map_or(0, |group| group.sequence))
}

/// The states that a setpoint answers.
#[derive(Clone, Copy, Default)]
struct Answered {
    sequence: u64,
    cycle: u64,
    published_ns: u64,
}

/// The setpoint that each cycle used, and the measured times, ns.
struct Watch {
    answered: [Answered; REMEMBERED],
    sequence: u64,
    in_use: u64,
    cycle: u64,
    used: u64,
    late: u64,
    control: Vec<u64>,
    delivery: Vec<u64>,
    publication: Vec<u64>,
}

impl Watch {
    /// Starts with the setpoint `sequence`, which is the last one sent, and in use.
    fn new(sequence: u64) -> Self {
        Self {
            answered: [Answered::default(); REMEMBERED],
            sequence,
            in_use: sequence,
            cycle: 0,
            used: 0,
            late: 0,
            control: Vec::new(),
            delivery: Vec::new(),
            publication: Vec::new(),
        }
    }

    /// Records a sent setpoint that answers `state`.
    fn sent(&mut self, state: &State) {
        self.sequence += 1;
        self.answered[self.sequence as usize % REMEMBERED] =
            Answered { sequence: self.sequence, cycle: state.cycle(), published_ns: state.publish_ns() };
    }

    /// Processes the newest state.
    fn take(&mut self, state: &State) {
        self.delivery.push(state.age().as_nanos() as u64);
        let replies = state.joints().filter(|joint| joint.fresh).map(|joint| joint.receive_ns);
        if let Some(last) = replies.max() {
            self.publication.push(state.publish_ns().saturating_sub(last));
        }
        let before = std::mem::replace(&mut self.cycle, state.cycle());
        let in_use = state.group(0).map_or(0, |group| group.sequence);
        let is_new = std::mem::replace(&mut self.in_use, in_use) != in_use;
        let answered = self.answered[in_use as usize % REMEMBERED];
        // Only two consecutive states show which cycle first used a setpoint.
        if !is_new || answered.sequence != in_use || before + 1 != state.cycle() {
            return;
        }
        self.used += 1;
        self.late += u64::from(answered.cycle + 1 < state.cycle());
        let begun = state.tick_ns() + state.wake_latency().as_nanos() as u64;
        self.control.push(begun.saturating_sub(answered.published_ns));
    }

    fn print(mut self, computing: u64) {
        let mut micros = |values: fn(&mut Self) -> &mut Vec<u64>, share: f64| {
            let values = values(&mut self);
            values.sort_unstable();
            let at = (values.len() as f64 * share) as usize;
            values.get(at).map_or(f64::NAN, |nanos| *nanos as f64 / 1e3)
        };
        let [control, delivery, publication]: [fn(&mut Self) -> &mut Vec<u64>; 3] =
            [|watch| &mut watch.control, |watch| &mut watch.delivery, |watch| &mut watch.publication];
        let row = [control, delivery, publication].map(|values| [micros(values, 0.5), micros(values, 0.99)]);
        let late = 100.0 * self.late as f64 / self.used as f64;
        print!("{computing:>9} {:>8} {late:>8.1}", self.used);
        row.iter().for_each(|[p50, p99]| print!("  {p50:>8.1} {p99:>8.1}"));
        println!();
    }
}
