//! The commands: four forms, which become one [`Command`] by the rules.

use crate::claim_gate::{Binding, Writer};
use crate::clock::wall_ns;
use crate::command::{Command, Target};
use crate::config::Commands;
use crate::link::GroupLink;
use crate::rate_limit::RateLimit;
use crate::refusal::Refusal;
use crate::ros2::messages::{Float64MultiArray, ImpedanceCommand, JointState, JointTrajectory, Typed};
use crate::rules::{Gains, Rules, Stamped};
use crate::setpoints::{Incoming, Setpoints, check};
use crate::shared::Shared;
use crate::trajectory::{IncomingPoint, IncomingTrajectory, Trajectory};
use futures_lite::{StreamExt, pin};
use ros2_client::dds::{Node, Subscription};
use ros2_client::qos::{History, QosProfile};
use ros2_client::{Message, MessageInfo, Name};
use serde::de::DeserializeOwned;
use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// A form of a command.
pub(crate) trait Form: Typed + Message + DeserializeOwned + 'static {
    /// Last part of the topic.
    const TOPIC: &'static str;

    /// Returns the motion that the message requests, by the rules.
    fn target(&self, sent_ns: Option<u64>, rules: &Rules, present: &[Option<f32>])
    -> Result<Target, Refusal>;
}

impl Form for ImpedanceCommand {
    const TOPIC: &'static str = "command";

    fn target(&self, sent_ns: Option<u64>, rules: &Rules, _: &[Option<f32>]) -> Result<Target, Refusal> {
        let incoming = Incoming {
            stamp: Stamped::Header((&self.header.stamp).into()),
            sent_ns,
            names: Some(&self.names.0),
            position: &self.position.0,
            velocity: &self.velocity.0,
            effort: &self.effort.0,
            gains: Gains::Message { kp: &self.kp.0, kd: &self.kd.0 },
            horizon: self.horizon,
        };
        check(&incoming, rules).map(Target::Setpoints)
    }
}

impl Form for JointState {
    const TOPIC: &'static str = "joint_command";

    fn target(&self, sent_ns: Option<u64>, rules: &Rules, _: &[Option<f32>]) -> Result<Target, Refusal> {
        let incoming = Incoming {
            stamp: Stamped::Header((&self.header.stamp).into()),
            sent_ns,
            names: Some(&self.name.0),
            position: &self.position.0,
            velocity: &self.velocity.0,
            effort: &self.effort.0,
            gains: Gains::Configured,
            horizon: 0.0,
        };
        check(&incoming, rules).map(Target::Setpoints)
    }
}

impl Form for Float64MultiArray {
    const TOPIC: &'static str = "positions";

    fn target(&self, sent_ns: Option<u64>, rules: &Rules, _: &[Option<f32>]) -> Result<Target, Refusal> {
        let incoming = Incoming {
            stamp: Stamped::Writer,
            sent_ns,
            names: None,
            position: &self.data.0,
            velocity: &[],
            effort: &[],
            gains: Gains::Configured,
            horizon: 0.0,
        };
        check(&incoming, rules).map(Target::Setpoints)
    }
}

impl Form for JointTrajectory {
    const TOPIC: &'static str = "joint_trajectory";

    fn target(
        &self,
        sent_ns: Option<u64>,
        rules: &Rules,
        present: &[Option<f32>],
    ) -> Result<Target, Refusal> {
        let points: Vec<_> = self
            .points
            .0
            .iter()
            .map(|point| IncomingPoint {
                position: &point.positions.0,
                velocity: &point.velocities.0,
                effort: &point.effort.0,
                time: (point.time_from_start.sec, point.time_from_start.nanosec),
            })
            .collect();
        let incoming = IncomingTrajectory {
            stamp: Stamped::Header((&self.header.stamp).into()),
            sent_ns,
            names: &self.joint_names.0,
            points: &points,
        };
        Trajectory::check(&incoming, present, rules).map(Target::Trajectory)
    }
}

/// The commands of one group, of all forms. All of them run in one thread.
pub(crate) struct Inbox {
    link: Arc<GroupLink>,
    shared: Arc<Shared>,
    commands: Commands,
    binding: RefCell<Binding>,
    refusals: RefCell<RateLimit>,
}

impl Inbox {
    pub(crate) fn new(link: Arc<GroupLink>, shared: Arc<Shared>, commands: Commands) -> Self {
        let refusals = RefCell::new(RateLimit::new(3, Duration::from_secs(1)));
        Self { link, shared, commands, binding: RefCell::default(), refusals }
    }

    /// Subscribes to the form `F` of the group with this name in topics.
    pub(crate) fn subscribe<F: Form>(&self, node: &mut Node, topic: &str) -> Result<Subscription<F>, String> {
        let name = format!("/motord/{topic}/{}", F::TOPIC);
        // Only the newest command counts, so none is sent again.
        let qos = QosProfile::subscription_default()
            .reliability_best_effort()
            .history(History::KeepLast { depth: 1 });
        subscription(node, &name, &qos)
    }

    /// Takes commands of one form. Yields after each.
    pub(crate) async fn receive<F: Form>(self: Rc<Self>, subscription: Subscription<F>) {
        let messages = subscription.async_stream();
        pin!(messages);
        while let Some(message) = messages.next().await {
            match message {
                Ok((message, info)) => self.take(&message, &info),
                Err(_) => self.refuse(Refusal::Undecodable, F::TOPIC),
            }
            futures_lite::future::yield_now().await;
        }
    }

    fn take<F: Form>(&self, message: &F, info: &MessageInfo) {
        let writer: Writer = info.publisher_gid().to_bytes16();
        match self.accept(message, info, writer) {
            Err(refusal) => self.refuse(refusal, F::TOPIC),
            Ok(command) => {
                self.link.counters.accepted.fetch_add(1, Ordering::Relaxed);
                if self.binding.borrow_mut().bind(writer, info.sequence_number()) {
                    let (name, writer) = (&self.link.group.name, hexadecimal(&writer));
                    log::info!("group {name}: writer {writer} of {} controls it", F::TOPIC);
                }
                self.link.command.put(command);
            }
        }
    }

    fn accept<F: Form>(&self, message: &F, info: &MessageInfo, writer: Writer) -> Result<Command, Refusal> {
        let claim =
            self.binding.borrow_mut().admit(self.link.gate.claim(), writer, info.sequence_number())?;
        let arrived = Instant::now();
        let rules = Rules {
            group: &self.link.group,
            gains: self.link.gains.as_ref(),
            commands: &self.commands,
            horizon_max: self.shared.robot.setpoint_horizon_max,
            now_ns: wall_ns(),
        };
        let sent_ns = info.source_timestamp().and_then(|time| u64::try_from(time.to_nanos()).ok());
        let target = message.target(sent_ns, &rules, &self.present())?;
        let group = &self.link.group;
        let exceeds = match &target {
            Target::Setpoints(setpoints) => Setpoints::exceed_limits(setpoints, group),
            Target::Trajectory(trajectory) => trajectory.exceeds_limits(group),
        };
        if exceeds {
            self.link.counters.clamped.fetch_add(1, Ordering::Relaxed);
        }
        Ok(Command { claim, arrived, target })
    }

    /// Returns the positions of the group's joints.
    fn present(&self) -> Vec<Option<f32>> {
        let Some(state) = self.shared.latest.newest() else { return Vec::new() };
        let joints = self.link.group.joints.iter();
        joints.map(|joint| state.joint(joint.index).and_then(|joint| joint.position())).collect()
    }

    fn refuse(&self, refusal: Refusal, topic: &str) {
        self.link.counters.refuse(refusal);
        if let Some(suppressed) = self.refusals.borrow_mut().permit(Instant::now()) {
            let (name, sentence) = (&self.link.group.name, refusal.sentence());
            let more = if suppressed > 0 { format!(" ({suppressed} others)") } else { String::new() };
            log::warn!(
                "group {name}: a message of {topic} does not count: {}: {sentence}{more}",
                refusal.name()
            );
        }
    }
}

/// Subscribes to `name`.
pub(crate) fn subscription<M: Typed + Message + 'static>(
    node: &mut Node,
    name: &str,
    qos: &QosProfile,
) -> Result<Subscription<M>, String> {
    let failed = |error: &dyn std::fmt::Display| format!("cannot subscribe to {name}: {error}");
    let topic = Name::parse(name).map_err(|error| failed(&format!("{error:?}")))?;
    let topic = node.create_topic(&topic, M::type_name(), qos).map_err(|error| failed(&error))?;
    node.create_subscription(&topic, None).map_err(|error| failed(&error))
}

/// Returns a writer's GUID as ROS 2's tools print it.
pub(crate) fn hexadecimal(writer: &Writer) -> String {
    writer.map(|byte| format!("{byte:02x}")).join(".")
}
