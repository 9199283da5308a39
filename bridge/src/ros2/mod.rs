//! The node of ROS 2: topics and services over DDS, in threads of their own.

mod bounded;
mod diagnostics;
mod joy;
mod messages;
mod names;
mod network;
mod publish;
mod service;
mod stamp;
mod subscribe;

pub(crate) use network::{Network, NetworkError};
pub(crate) use publish::cycles_between_states;

use crate::config::{Config, Range};
use crate::request::{Operation, Request};
use crate::shared::Shared;
use crate::stop::StopDesk;
use crate::threads::spawn;
use futures_lite::{StreamExt, future, pin};
use futures_util::stream::FuturesUnordered;
use messages::{Empty, Float64MultiArray, ImpedanceCommand, JointState, JointTrajectory};
use names::group_topics;
use publish::States;
use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::dds::{Context, Node, Subscription};
use ros2_client::qos::{History, QosProfile, WhenFull};
use ros2_client::{Name, NodeName, NodeOptions};
use service::{MAPPINGS, TriggerServer};
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;
use std::pin::Pin;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::thread::JoinHandle;
use std::time::Duration;
use subscribe::{Inbox, hexadecimal, subscription};

/// Name of the node.
const NODE: &str = "motord_bridge";
/// Interval at which a thread checks whether the bridge ends.
const POLL: Duration = Duration::from_millis(100);
/// The services of each group.
const OPERATIONS: [(&str, Operation); 5] = [
    ("claim", Operation::Claim),
    ("release", Operation::Release),
    ("enable", Operation::Enable),
    ("disable", Operation::Disable),
    ("reset", Operation::Reset),
];

/// The node, and its threads. Dropping the node leaves the graph.
pub(crate) struct Ros2Node {
    _node: Node,
    threads: Vec<JoinHandle<()>>,
    dds_threads: DdsThreads,
}

/// The threads of the DDS library, as folders of /proc. They end when the process continues after
/// SIGSTOP, and the library reports that to no caller.
struct DdsThreads(Vec<PathBuf>);

impl DdsThreads {
    /// Finds those that run.
    fn find() -> Self {
        let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
        let is_of_dds = |task: &PathBuf| {
            std::fs::read_to_string(task.join("comm")).is_ok_and(|name| name.starts_with("RustDDS"))
        };
        Self(tasks.map(|task| task.path()).filter(is_of_dds).collect())
    }

    /// Returns `true` if one of them has ended. Needs no file descriptor: peers may use them up.
    fn have_ended(&self) -> bool {
        self.0.iter().any(|task| matches!(task.try_exists(), Ok(false)))
    }
}

fn open(network: &Network) -> Result<Node, String> {
    let mut participant = DomainParticipantBuilder::new(network.domain);
    if network.range == Range::Localhost {
        participant = participant.with_only_networks([IpAddr::V4(Ipv4Addr::LOCALHOST)]);
    }
    let participant = participant.build();
    let participant =
        participant.map_err(|error| format!("cannot open DDS domain {}: {error:?}", network.domain))?;
    let context =
        Context::from_domain_participant(participant).map_err(|error| format!("cannot open DDS: {error}"))?;
    // No parameters: a value that a peer may set is a command.
    let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
    let name = NodeName::new("/", NODE).map_err(|error| format!("{error:?}"))?;
    context.new_node(name, options).map_err(|error| format!("cannot create the node {NODE}: {error:?}"))
}

/// Creates the node with its topics and services, and starts its threads.
pub(crate) fn start(
    config: &Config,
    network: &Network,
    shared: &Arc<Shared>,
    desk: &Arc<StopDesk>,
    requests: SyncSender<Request>,
) -> Result<Ros2Node, String> {
    let mut node = open(network)?;
    let topics = group_topics(shared)?;
    let mut threads = vec![start_stop(&mut node, shared, desk)?];
    if config.ros2.commands {
        threads.push(start_receive(&mut node, config, shared, &topics, requests)?);
    }
    let states = States::new(&mut node, &config.ros2, shared, &topics)?;
    if config.gamepad.enabled {
        let (topic, shared) = (joy::topic(&mut node)?, Arc::clone(shared));
        threads.push(spawn("ros2-joy", move || joy::run(&topic, &shared))?);
    }
    let publishing = Arc::clone(shared);
    threads.push(spawn("ros2-publish", move || states.run(&publishing))?);
    Ok(Ros2Node { _node: node, threads, dds_threads: DdsThreads::find() })
}

impl Ros2Node {
    /// Returns `true` if a thread has ended, also one of the DDS library: it panicked, or the bridge
    /// ends.
    pub(crate) fn has_ended(&self) -> bool {
        self.threads.iter().any(JoinHandle::is_finished) || self.dds_threads.have_ended()
    }

    /// Waits for the threads.
    pub(crate) fn join(&mut self) {
        for thread in self.threads.drain(..) {
            // A panic has printed itself.
            let _panicked = thread.join();
        }
    }

    /// Leaves the graph.
    pub(crate) fn leave(self) {
        // The DDS library reports its own end as an error.
        log::set_max_level(log::LevelFilter::Off);
    }
}

/// The tasks of a thread. Each yields after a message, and one that is woken does not poll the others.
type Tasks = FuturesUnordered<Pin<Box<dyn Future<Output = ()>>>>;

/// Runs `tasks` until the bridge ends.
fn run_until_end(tasks: Tasks, shared: &Shared) {
    let (wake, woken) = async_channel::bounded::<()>(1);
    std::thread::scope(|scope| {
        scope.spawn(move || {
            // A task that panics closes the channel.
            while !shared.ends() && !wake.is_closed() {
                std::thread::sleep(POLL);
            }
            drop(wake);
        });
        let ended = async move {
            let _closed = woken.recv().await;
        };
        future::block_on(future::or(ended, tasks.collect()));
    });
}

/// The stop has a thread of its own: no flood of commands delays it.
fn start_stop(node: &mut Node, shared: &Arc<Shared>, desk: &Arc<StopDesk>) -> Result<JoinHandle<()>, String> {
    let base = QosProfile::subscription_default().history(History::KeepLast { depth: 10 });
    let mut topics: Vec<Subscription<Empty>> = Vec::new();
    // A reliable subscription does not match a best-effort publisher.
    for qos in [base.clone().reliability_reliable(WhenFull::Fail), base.reliability_best_effort()] {
        topics.push(subscription(node, "/motord/stop", &qos)?);
    }
    let name = Name::new("/motord", "stop").map_err(|error| format!("{error:?}"))?;
    let mut servers = Vec::new();
    for mapping in MAPPINGS {
        servers.push(TriggerServer::new(node, &name, mapping)?);
    }
    let (shared, desk) = (Arc::clone(shared), Arc::clone(desk));
    spawn("ros2-stop", move || {
        let tasks = Tasks::new();
        for topic in topics {
            tasks.push(Box::pin(stop_by_topic(topic, Arc::clone(&desk))));
        }
        for server in servers {
            let desk = Arc::clone(&desk);
            let stop = async move { server.serve(|| service::stop(&desk, "the service /motord/stop")).await };
            tasks.push(Box::pin(stop));
        }
        run_until_end(tasks, &shared);
    })
}

/// Any message stops the robot, also one that cannot be decoded.
async fn stop_by_topic(topic: Subscription<Empty>, desk: Arc<StopDesk>) {
    let messages = topic.async_stream();
    pin!(messages);
    while let Some(message) = messages.next().await {
        let writer = message.map(|(_, info)| hexadecimal(&info.publisher_gid().to_bytes16()));
        let writer = writer.unwrap_or_else(|_| "unknown".to_owned());
        drop(desk.request(format!("the topic /motord/stop, writer {writer}")));
        future::yield_now().await;
    }
}

fn start_receive(
    node: &mut Node,
    config: &Config,
    shared: &Arc<Shared>,
    topics: &[String],
    requests: SyncSender<Request>,
) -> Result<JoinHandle<()>, String> {
    let mut groups = Vec::new();
    for (index, topic) in topics.iter().enumerate() {
        let inbox =
            Inbox::new(Arc::clone(&shared.groups[index]), Arc::clone(shared), config.commands.clone());
        let impedance = inbox.subscribe::<ImpedanceCommand>(node, topic)?;
        let joints = inbox.subscribe::<JointState>(node, topic)?;
        let positions = inbox.subscribe::<Float64MultiArray>(node, topic)?;
        let trajectories = inbox.subscribe::<JointTrajectory>(node, topic)?;
        let servers = operations(node, topic)?;
        groups.push((index, inbox, (impedance, joints, positions, trajectories), servers));
    }
    let shared = Arc::clone(shared);
    spawn("ros2-receive", move || {
        let tasks = Tasks::new();
        for (index, inbox, (impedance, joints, positions, trajectories), servers) in groups {
            let inbox = Rc::new(inbox);
            tasks.push(Box::pin(Rc::clone(&inbox).receive(impedance)));
            tasks.push(Box::pin(Rc::clone(&inbox).receive(joints)));
            tasks.push(Box::pin(Rc::clone(&inbox).receive(positions)));
            tasks.push(Box::pin(inbox.receive(trajectories)));
            for (operation, server) in servers {
                let requests = requests.clone();
                let serve =
                    async move { server.serve(|| service::request(&requests, index, operation)).await };
                tasks.push(Box::pin(serve));
            }
        }
        run_until_end(tasks, &shared);
    })
}

/// Creates the services of a group.
fn operations(node: &mut Node, topic: &str) -> Result<Vec<(Operation, TriggerServer)>, String> {
    let mut servers = Vec::new();
    for (service, operation) in OPERATIONS {
        let name = Name::new(&format!("/motord/{topic}"), service).map_err(|error| format!("{error:?}"))?;
        for mapping in MAPPINGS {
            servers.push((operation, TriggerServer::new(node, &name, mapping)?));
        }
    }
    Ok(servers)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    #[test]
    fn ended_thread_of_dds_is_noticed() {
        let (end, ends) = channel::<()>();
        let (begun, begins) = channel();
        let thread = spawn("RustDDS test", move || {
            begun.send(()).unwrap();
            let _closed = ends.recv();
        })
        .unwrap();
        begins.recv().unwrap();
        let threads = DdsThreads::find();
        assert!(!threads.0.is_empty() && !threads.have_ended());
        drop(end);
        thread.join().unwrap();
        while !threads.have_ended() {
            std::thread::yield_now();
        }
    }
}
