//! The commands: `check`, and `run`, which starts and ends the threads.

use crate::clock::ClockCheck;
use crate::config::{Config, ConfigError, Range};
use crate::foxglove;
use crate::gamepad;
use crate::group::Group;
use crate::inputs;
use crate::link::GroupLink;
use crate::motor::Motor;
use crate::ros2::{self, Network, NetworkError};
use crate::shared::Shared;
use crate::stop::{self, StopDesk};
use crate::threads::spawn;
use crate::web::{self, Page};
use motord_client::Client;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread::JoinHandle;
use std::time::Duration;

/// Limit on requests of services that wait for the motor thread.
const REQUESTS_MAX: usize = 16;
/// Interval of attempts to connect, and of checks whether a thread has ended.
const RETRY: Duration = Duration::from_millis(500);

/// The reason why the program ends with an error.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BridgeError {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// The configuration does not fit the robot, or something cannot be started.
    #[error("{0}")]
    Start(String),
    #[error(transparent)]
    Client(#[from] motord_client::Error),
    /// The bridge ended by itself.
    #[error("{0}")]
    Ended(String),
}

impl BridgeError {
    /// Returns the exit status, after `sysexits.h`.
    pub(crate) fn exit_status(&self) -> u8 {
        match self {
            Self::Config(ConfigError::Read { .. }) => 66,
            Self::Config(_) | Self::Network(_) => 78,
            Self::Client(error) => error.exit_status(),
            Self::Start(_) => 69,
            Self::Ended(_) => 75,
        }
    }
}

fn read(path: &Path) -> Result<(Config, Network, Option<Page>), BridgeError> {
    let config = Config::read(path)?;
    let network = Network::of(&config.ros2, |name| std::env::var(name).ok())?;
    let page = web::prepare(&config.web).map_err(ConfigError::Web)?;
    Ok((config, network, page))
}

/// Checks the configuration, and prints what `run` would use.
pub(crate) fn check(path: &Path) -> Result<(), BridgeError> {
    let (config, network, page) = read(path)?;
    for warning in &network.warnings {
        log::warn!("{warning}");
    }
    println!("{}: good", path.display());
    println!("{}", summary(&config, &network));
    println!("page: {}", page.map_or_else(|| "off".to_owned(), |page| page.link()));
    println!("{}", inputs::summary(&config));
    Ok(())
}

/// Prints the values of a gamepad.
pub(crate) fn gamepad(name: Option<String>, json: bool) -> Result<(), BridgeError> {
    gamepad::show(name, json).map_err(|error| BridgeError::Start(format!("cannot print the values: {error}")))
}

fn summary(config: &Config, network: &Network) -> String {
    let range = match network.range {
        Range::Localhost => "127.0.0.1",
        Range::Subnet => "every interface",
    };
    let commands = if config.ros2.commands { "commands accepted" } else { "commands off" };
    let viewers = match &config.foxglove {
        foxglove if foxglove.enabled => format!("Foxglove on {} port {}", foxglove.address, foxglove.port),
        _ => "Foxglove off".to_owned(),
    };
    let instance = &config.robot.instance;
    format!("instance {instance}, DDS domain {} on {range}, {commands}, {viewers}", network.domain)
}

/// Runs the bridge until a signal.
pub(crate) fn run(path: &Path) -> Result<(), BridgeError> {
    let (config, network, page) = read(path)?;
    for warning in &network.warnings {
        log::warn!("{warning}");
    }
    let ends = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, Arc::clone(&ends))
            .map_err(|error| BridgeError::Start(format!("cannot handle signals: {error}")))?;
    }
    let Some(client) = connect(&config.robot.instance, &ends)? else { return Ok(()) };
    let shared = Arc::new(share(&client, &config, ends)?);
    log::info!("{}, {}", summary(&config, &network), inputs::summary(&config));
    let (sender, requests) = sync_channel(REQUESTS_MAX);
    let cycles = cycles_between_states(&config, page.is_some(), shared.robot.rate_hz);
    let motor = Motor::new(client, Arc::clone(&shared), requests, config.commands.timeout(), cycles);
    let desk = Arc::new(StopDesk::default());
    let stop = {
        let (instance, desk) = (config.robot.instance.clone(), Arc::clone(&desk));
        spawn("stop", move || stop::run(&instance, &desk)).map_err(BridgeError::Start)?
    };
    // The nearest sources first: they need no network.
    let mut sources = inputs::start(&config, &shared, &desk).map_err(BridgeError::Start)?;
    sources
        .extend(page.map(|page| web::start(page, &shared, &desk)).transpose().map_err(BridgeError::Start)?);
    let mut node = ros2::start(&config, &network, &shared, &desk, sender).map_err(BridgeError::Start)?;
    sources.extend(foxglove::start(&config, &shared, &desk).map_err(BridgeError::Start)?);
    let motor = spawn("motor", move || motor.run()).map_err(BridgeError::Start)?;
    await_end(&shared, || {
        let source_has_ended = sources.iter().any(JoinHandle::is_finished);
        node.has_ended() || motor.is_finished() || stop.is_finished() || source_has_ended
    });
    // The motor thread releases the groups first. The stop ends after its last source.
    for thread in [motor].into_iter().chain(sources) {
        let _panicked = thread.join();
    }
    node.join();
    desk.close();
    let _panicked = stop.join();
    node.leave();
    shared.failure().map_or(Ok(()), |failure| Err(BridgeError::Ended(failure.to_owned())))
}

/// Waits until the bridge ends. It ends by itself with one of its threads, and with a clock that is set
/// back.
fn await_end(shared: &Shared, thread_has_ended: impl Fn() -> bool) {
    let mut clock = ClockCheck::new();
    while !shared.ends() {
        std::thread::sleep(RETRY);
        // After a signal the threads end by themselves.
        if thread_has_ended() && !shared.ends() {
            shared.fail("a thread of the bridge has ended: see the lines above".to_owned());
        }
        if let Some(step) = clock.step_back() {
            let seconds = step.as_secs_f64();
            shared.fail(format!(
                "the clock was set back by {seconds:.3} s, and ROS 2 would be deaf for as long"
            ));
        }
    }
}

/// Returns the number of cycles between two states that any thread needs while no group is claimed.
fn cycles_between_states(config: &Config, has_page: bool, cycle_hz: f64) -> u32 {
    let of_ros2 = ros2::cycles_between_states(&config.ros2, cycle_hz);
    let of_page = has_page.then(|| web::cycles_between_states(cycle_hz));
    let of_inputs = inputs::cycles_between_states(config, cycle_hz);
    [of_page, of_inputs].into_iter().flatten().fold(of_ros2, u32::min)
}

/// Connects to the daemon, and waits for it. `None` after a signal.
fn connect(instance: &str, ends: &AtomicBool) -> Result<Option<Client>, BridgeError> {
    let mut is_reported = false;
    while !ends.load(Ordering::Relaxed) {
        match Client::connect(instance) {
            Ok(client) => return Ok(Some(client)),
            Err(error) if !error.is_transient() => return Err(error.into()),
            Err(error) if !is_reported => {
                log::warn!("{error}; waiting for it");
                is_reported = true;
            }
            Err(_) => {}
        }
        std::thread::sleep(RETRY);
    }
    Ok(None)
}

/// Creates the shared values for the robot of `client`.
fn share(client: &Client, config: &Config, ends: Arc<AtomicBool>) -> Result<Shared, BridgeError> {
    let robot = client.description();
    let groups = Group::all(&robot);
    if let Some(unknown) = config.group.keys().find(|name| !groups.iter().any(|group| group.name == **name)) {
        let known: Vec<_> = groups.iter().map(|group| group.name.as_str()).collect();
        let known = known.join(", ");
        return Err(BridgeError::Start(format!(
            "[group.{unknown}]: the robot has no such group; there are {known}"
        )));
    }
    let links = groups.into_iter().map(|group| {
        let gains = config.group.get(&group.name);
        GroupLink::new(group, gains)
    });
    let links = links.collect::<Result<_, _>>().map_err(BridgeError::Start)?;
    Ok(Shared::new(robot, links, ends))
}
