//! The description of the robot and the telemetry of the daemon, as text. It is JSON in the answer to an administrative
//! request, so that fields can be added without a new layout.

use core::time::Duration;
use serde::{Deserialize, Serialize};

/// The robot: names and limits, in the order of the configuration.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct RobotDescription {
    /// The instance's name.
    pub instance: String,
    /// The daemon's version.
    pub version: String,
    /// The daemon's process id.
    pub pid: u32,
    /// See `StateMessage::boot_id`.
    pub boot_id: u64,
    /// Cycles per second.
    pub rate_hz: f64,
    /// A group's owner must send setpoints at least this often. In JSON a number, s.
    #[serde(with = "seconds")]
    pub setpoint_timeout: Duration,
    /// Joints.
    pub joints: Vec<JointDescription>,
    /// Groups.
    pub groups: Vec<GroupDescription>,
    /// Names of the buses.
    pub buses: Vec<String>,
    /// CAN interface or serial device of each bus, in the order of `buses`; empty for a simulated bus.
    pub devices: Vec<String>,
    /// Half the longest time of a command and its reply, s, in the order of `buses`: a frame takes at most so long on average.
    /// It includes stuffing bits and, on a serial bus, the time until the motor answers. 0 for a CAN bus without motors.
    pub frame_times: Vec<f64>,
}

impl RobotDescription {
    /// Time from tick to tick; zero where no rate is described.
    #[must_use]
    pub fn period(&self) -> Duration {
        Duration::try_from_secs_f64(1.0 / self.rate_hz).unwrap_or_default()
    }
}

/// A joint and its limits, joint side.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct JointDescription {
    /// Its name.
    pub name: String,
    /// The name of its bus.
    pub bus: String,
    /// `mit` or `gim`.
    pub protocol: String,
    /// The model of its motor.
    pub model: String,
    /// Its position, rad, where its motor is at zero: `offset-rad` of the configuration.
    pub zero: f32,
    /// The bounds of its setpoints. In JSON they stand beside the names.
    #[serde(flatten)]
    pub limits: JointLimits,
}

impl JointDescription {
    /// Says for people that the joint stands at `position`, rad, outside its limits.
    #[must_use]
    pub fn outside(&self, position: f32) -> String {
        let [lower, upper] = self.limits.position;
        // No zero with a sign.
        let position = (position * 100.0).round() / 100.0 + 0.0;
        format!("{} is at {position:.2} rad, outside {lower:.2} to {upper:.2}", self.name)
    }
}

/// The bounds of a joint's setpoints, joint side.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct JointLimits {
    /// Lowest and highest position, rad.
    pub position: [f32; 2],
    /// Largest speed, rad/s.
    pub velocity: f32,
    /// Largest torque, N·m.
    pub torque: f32,
    /// Largest stiffness, N·m/rad.
    pub kp: f32,
    /// Largest damping, N·m·s/rad.
    pub kd: f32,
}

impl JointLimits {
    /// Returns true when `position`, rad, is within the limits of setpoints.
    #[must_use]
    pub fn allow(&self, position: f32) -> bool {
        let [lower, upper] = self.position;
        (lower..=upper).contains(&position)
    }

    /// The position, rad, that is nearest to `position` within the limits.
    #[must_use]
    pub fn clamp_position(&self, position: f32) -> f32 {
        let [lower, upper] = self.position;
        position.max(lower).min(upper)
    }
}

/// A group and its joints.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct GroupDescription {
    /// Its name.
    pub name: String,
    /// Indices of its joints, rising.
    pub joints: Vec<usize>,
}

/// Counters and latencies since the daemon started, or since the last reset of them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Telemetry {
    /// How often an operator began everything here anew.
    pub resets: u64,
    /// Cycles that were run.
    pub cycles: u64,
    /// Ticks that were missed.
    pub overruns: u64,
    /// From the first cycle to the last, s.
    pub seconds: f64,
    /// Replies that did not come in their turn, over all motors that were online.
    pub missed_replies: u64,
    /// Cycles that polled for the last replies, but stopped before all of them had come.
    pub polled_in_vain: u64,
    /// Reads of a bus by polling, each a system call.
    pub polled_reads: u64,
    /// Records that telemetry could not keep up with.
    pub dropped_records: u64,
    /// From a tick to the beginning of its cycle. A missed tick counts, too: until the beginning of the cycle after it.
    pub wake_latency_us: Percentiles,
    /// From the beginning of a cycle until the kernel, or the simulation, has all of its frames.
    pub transmit_us: Percentiles,
    /// From a command to its reply, all motors.
    pub reply_latency_us: Percentiles,
    /// From the sending of a setpoint to the cycle that used it. A missed tick counts, too: the setpoint of the cycle before it
    /// was in use, and was older.
    pub setpoint_age_us: Percentiles,
    /// From the beginning of a cycle to the publication of its states.
    pub cycle_us: Percentiles,
    /// From the last reply of a cycle to the publication of its states.
    pub publication_us: Percentiles,
    /// From the publication of states by the cycle until all clients that wait for them are woken.
    pub delivery_us: Percentiles,
    /// How long the cycles polled for their last replies, of those that did (`busy-poll-us`).
    pub polled_us: Percentiles,
    /// From the publication of states to the beginning of the cycle that first used the setpoint that answers them, all
    /// groups. Answers to states of more than 64 cycles ago are left out.
    pub control_latency_us: Percentiles,
    /// Reply latency by joint, in the order of the description.
    pub joints: Vec<Percentiles>,
    /// Owners and stops, in the order of the description.
    pub groups: Vec<GroupHistory>,
    /// Control latency by group, in the order of the description.
    pub control: Vec<ControlLatency>,
}

/// The time between states and the setpoint that answers them, of one group.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ControlLatency {
    /// As [`Telemetry::control_latency_us`].
    pub control_latency_us: Percentiles,
    /// How many setpoints were first used so many cycles after the states that they answer: 1, 2, 3, and so on; the last
    /// number counts all that took longer. Ticks that were missed count as cycles.
    pub cycles: Vec<u64>,
}

/// Some of the latency histograms: as many as fit into one answer.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Histograms {
    /// As [`Telemetry::resets`].
    pub resets: u64,
    /// Number of the histogram after these; `None` when these are the last.
    pub next: Option<u32>,
    /// In the order of their numbers.
    pub histograms: Vec<EncodedHistogram>,
}

/// The latencies of one quantity.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct EncodedHistogram {
    /// The member of [`Telemetry`] without its unit, such as `wake_latency`. That of one joint or group ends with its name:
    /// `reply_latency/fl-hip`.
    pub name: String,
    /// Values in ns, in HdrHistogram's "V2 with DEFLATE", in base64.
    pub encoded: String,
}

/// The owner of a group and the beginnings of its phase and stop. Up to 50 ms old: `GroupState` tells whether the group has
/// an owner and a latched cause now.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct GroupHistory {
    /// The owner; the last owner of a group without one.
    pub owner: Option<Process>,
    /// Number of the cycle in which the phase began; 0 before the first change.
    pub phase_cycle: u64,
    /// Number of the cycle in which the latched cause stopped the group.
    pub stop_cycle: Option<u64>,
    /// The process that requested the stop, if any.
    pub stopped_by: Option<Process>,
}

/// A process, as it named itself.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Process {
    /// Its id.
    pub pid: u32,
    /// The first 15 bytes of its program's name, any characters; empty when the kernel did not report it.
    pub program: String,
}

/// A latency distribution, µs.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Percentiles {
    /// How many values.
    pub count: u64,
    /// Half are below.
    pub p50: f64,
    /// 99 % are below.
    pub p99: f64,
    /// 99.9 % are below.
    pub p99_9: f64,
    /// The largest.
    pub max: f64,
}

impl Percentiles {
    /// Percentiles of `count` values with the maximum `max_ns`, ns. `at_quantile` returns the value at a share from 0 to 1.
    #[must_use]
    pub fn of(count: u64, max_ns: u64, at_quantile: impl Fn(f64) -> u64) -> Self {
        let microseconds = |nanos: u64| nanos as f64 / 1000.0;
        let at = |quantile| microseconds(at_quantile(quantile));
        Self { count, p50: at(0.5), p99: at(0.99), p99_9: at(0.999), max: microseconds(max_ns) }
    }
}

/// Durations as seconds.
mod seconds {
    use core::time::Duration;
    use serde::{Deserialize as _, Deserializer, Serializer, de};

    pub(super) fn serialize<S: Serializer>(duration: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_f64(duration.as_secs_f64())
    }

    pub(super) fn deserialize<'a, D: Deserializer<'a>>(deserializer: D) -> Result<Duration, D::Error> {
        Duration::try_from_secs_f64(f64::deserialize(deserializer)?).map_err(de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn described(text: &str) -> Result<RobotDescription, serde_json::Error> {
        serde_json::from_str(text)
    }

    #[test]
    fn limits_stand_beside_joint_names_in_seconds() {
        let text = r#"{"rate_hz":500.0,"setpoint_timeout":0.02,"joints":[{"name":"hip","position":[-1.0,1.5],"kd":5.0}]}"#;
        let robot = described(text).unwrap();
        assert_eq!(
            (robot.setpoint_timeout, robot.period()),
            (Duration::from_millis(20), Duration::from_millis(2))
        );
        assert_eq!(
            robot.joints[0].limits,
            JointLimits { position: [-1.0, 1.5], kd: 5.0, ..JointLimits::default() }
        );
        let back: serde_json::Value = serde_json::to_value(&robot).unwrap();
        assert_eq!((&back["setpoint_timeout"], &back["joints"][0]["kd"]), (&0.02.into(), &5.0.into()));
    }

    #[test]
    fn invalid_time_is_refused_and_invalid_rate_periodless() {
        for time in ["-1.0", "1e300", "null", "\"1\""] {
            assert!(described(&format!(r#"{{"setpoint_timeout":{time}}}"#)).is_err(), "{time}");
        }
        for rate_hz in ["0.0", "-5.0", "1e-300"] {
            assert_eq!(
                described(&format!(r#"{{"rate_hz":{rate_hz}}}"#)).unwrap().period(),
                Duration::ZERO,
                "{rate_hz}"
            );
        }
    }
}
