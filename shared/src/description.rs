//! The description of the robot and the telemetry of the daemon, as text. Answers to administrative
//! requests contain it as JSON, so fields can be added without a new layout.

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
    /// Maximum interval between setpoints of a group's owner. In JSON a number, s.
    #[serde(with = "seconds")]
    pub setpoint_timeout: Duration,
    /// Longest horizon of setpoints. In JSON a number, s.
    #[serde(with = "seconds")]
    pub setpoint_horizon_max: Duration,
    /// Joints.
    pub joints: Vec<JointDescription>,
    /// Groups.
    pub groups: Vec<GroupDescription>,
    /// IMUs.
    pub imus: Vec<ImuDescription>,
    /// Names of the buses.
    pub buses: Vec<String>,
    /// CAN interface or serial device of each bus, in the order of `buses`; empty for a simulated
    /// bus.
    pub devices: Vec<String>,
    /// Half the longest time of a command and its reply, s, in the order of `buses`: the highest
    /// mean time of a frame. It includes stuffing bits and, on a serial bus, the time until the
    /// motor answers. 0 for a CAN bus without motors.
    pub frame_times: Vec<f64>,
}

impl RobotDescription {
    /// Returns the next step for an owner that sends setpoints every `period` with this `horizon`;
    /// see [`slow_owner`].
    #[must_use]
    pub fn slow_owner(&self, period: Duration, horizon: Duration) -> Option<String> {
        slow_owner(period, self.setpoint_timeout, horizon)
    }

    /// Returns the time from tick to tick; zero without a rate.
    #[must_use]
    pub fn period(&self) -> Duration {
        Duration::try_from_secs_f64(1.0 / self.rate_hz).unwrap_or_default()
    }
}

/// Returns the next step for an owner whose setpoints come so rarely that one that is lost or late
/// exceeds `timeout` after its `horizon`; `None` for a faster one.
#[must_use]
pub fn slow_owner(period: Duration, timeout: Duration, horizon: Duration) -> Option<String> {
    let [every, limit, after] = [period, timeout, horizon].map(|time| time.as_secs_f64() * 1e3);
    let enough = (3.0 * every - after).ceil().min(1000.0);
    (period > (timeout + horizon) / 2).then(|| {
        format!(
            "Setpoints come every {every:.1} ms; setpoint-timeout-ms is {limit}: raise it in [safety] to {enough}, send with a horizon, or send more often"
        )
    })
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
    /// Position of the joint, rad, at the zero of its motor: `offset-rad` of the configuration.
    pub zero: f32,
    /// The bounds of its setpoints. In JSON they are on the same level as the names.
    #[serde(flatten)]
    pub limits: JointLimits,
}

impl JointDescription {
    /// Returns a sentence about the joint at `position`, rad, outside its limits.
    #[must_use]
    pub fn outside(&self, position: f32) -> String {
        let [lower, upper] = self.limits.position;
        // Avoids a negative zero.
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
    /// Returns `true` if `position`, rad, is within the limits of setpoints.
    #[must_use]
    pub fn allow(&self, position: f32) -> bool {
        let [lower, upper] = self.position;
        (lower..=upper).contains(&position)
    }

    /// Returns the position within the limits, rad, that is nearest to `position`.
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

/// An IMU.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ImuDescription {
    /// Its name.
    pub name: String,
    /// Samples per second.
    pub rate_hz: f64,
    /// `type` in the configuration.
    pub source: String,
    /// Rotation from the sensor to the body, a unit quaternion w, x, y, z; `mount-rpy-deg` in the
    /// configuration.
    pub mount: [f32; 4],
    /// Longest time without a sample before it is lost, and largest age of a sample of an external
    /// IMU, s; 0 when unknown.
    pub lost_after: f64,
}

/// Counters and latencies since the daemon started, or since their last reset.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Telemetry {
    /// Number of resets by operators.
    pub resets: u64,
    /// Executed cycles.
    pub cycles: u64,
    /// Missed ticks.
    pub overruns: u64,
    /// From the first cycle to the last, s.
    pub seconds: f64,
    /// Replies that did not arrive in their turn, over all motors that were online.
    pub missed_replies: u64,
    /// Cycles that polled for the last replies, but stopped before all of them had arrived.
    pub polled_in_vain: u64,
    /// Reads of a bus by polling, each a system call.
    pub polled_reads: u64,
    /// Records dropped because telemetry was too slow.
    pub dropped_records: u64,
    /// Time that the plant of a simulated robot lost since the daemon started, µs: it was slower
    /// than real time. 0 without a plant.
    pub plant_lost_us: u64,
    /// From a tick to the beginning of its cycle. A missed tick counts with the beginning of the
    /// next cycle.
    pub wake_latency_us: Percentiles,
    /// From the beginning of a cycle until the kernel, or the simulation, has all of its frames.
    pub transmit_us: Percentiles,
    /// From a command to its reply, all motors.
    pub reply_latency_us: Percentiles,
    /// From the sending of a setpoint to the cycle that used it. A missed tick counts with the
    /// setpoint of the previous cycle, which is older.
    pub setpoint_age_us: Percentiles,
    /// From the beginning of a cycle to the publication of its states.
    pub cycle_us: Percentiles,
    /// From the last reply of a cycle to the publication of its states.
    pub publication_us: Percentiles,
    /// From the publication of states by the cycle until all clients that wait for them are woken.
    pub delivery_us: Percentiles,
    /// Duration of polling for the last replies, over the cycles that polled (`busy-poll-us`).
    pub polled_us: Percentiles,
    /// From the publication of states to the cycle that first used their answer, all groups.
    /// Answers to states of more than 64 cycles ago are omitted.
    pub control_latency_us: Percentiles,
    /// Reply latency by joint, in the order of the description.
    pub joints: Vec<Percentiles>,
    /// From the receipt of the newest sample of an IMU to the publication of states with it, in the
    /// order of the description.
    pub imus: Vec<Percentiles>,
    /// Owners and stops, in the order of the description.
    pub groups: Vec<GroupHistory>,
    /// Control latency by group, in the order of the description.
    pub control: Vec<ControlLatency>,
    /// The network between the robot and this computer; `None` on the robot's own computer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub network: Option<NetworkLatency>,
}

/// The network between a robot and another computer, as the mirror there sees it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct NetworkLatency {
    /// From a frame to the robot until the state that repeats it, without the time that the robot
    /// held it.
    pub round_trip_us: Percentiles,
    /// Upper bound of the time from the sending of a state to its arrival.
    pub state_age_us: Percentiles,
    /// From the arrival of a state to that of the next.
    pub state_interval_us: Percentiles,
    /// States that were sent and did not arrive before a newer one.
    pub lost: u64,
    /// Frames that were damaged, of another version, or older than one before.
    pub refused: u64,
}

/// The time between states and the setpoint that answers them, of one group.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ControlLatency {
    /// See [`Telemetry::control_latency_us`].
    pub control_latency_us: Percentiles,
    /// Number of setpoints first used 1, 2, 3, … cycles after the states that they answer. The last
    /// number counts all longer ones. Missed ticks count as cycles.
    pub cycles: Vec<u64>,
}

/// Part of the latency histograms: those that fit into one answer.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Histograms {
    /// See [`Telemetry::resets`].
    pub resets: u64,
    /// Number of the next histogram; `None` after the last.
    pub next: Option<u32>,
    /// In the order of their numbers.
    pub histograms: Vec<EncodedHistogram>,
}

/// The latencies of one quantity.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct EncodedHistogram {
    /// The member of [`Telemetry`] without its unit, such as `wake_latency`. A histogram of one
    /// joint or group ends with its name: `reply_latency/fl-hip`.
    pub name: String,
    /// Values in ns, in HdrHistogram's "V2 with DEFLATE", in base64.
    pub encoded: String,
}

/// The owner of a group and the beginnings of its phase and stop, up to 50 ms old. `GroupState`
/// contains the current owner and latched cause.
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
    /// The stop to which the latched emergency stop was added.
    pub first: Option<FirstStop>,
}

/// The first stop of a group since its last reset. `GroupState` has the emergency stop that
/// replaced its cause.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct FirstStop {
    /// `Cause` code.
    pub cause: u32,
    /// Index of the joint that caused the stop.
    pub joint: Option<usize>,
    /// Number of the cycle in which it began.
    pub cycle: u64,
    /// The process that requested it, if any.
    pub by: Option<Process>,
}

/// A process, as it identified itself.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Process {
    /// Its id.
    pub pid: u32,
    /// The first 15 bytes of its program's name, any characters; empty if the kernel did not report
    /// it.
    pub program: String,
}

/// A latency distribution, µs.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Percentiles {
    /// Number of values.
    pub count: u64,
    /// Median.
    pub p50: f64,
    /// 99 % quantile.
    pub p99: f64,
    /// 99.9 % quantile.
    pub p99_9: f64,
    /// Maximum.
    pub max: f64,
}

impl Percentiles {
    /// Returns the percentiles of `count` values with the maximum `max_ns`, ns. `at_quantile`
    /// returns the value at a share from 0 to 1.
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
    fn slow_owner_advice_names_period_timeout_and_key() {
        let ms = Duration::from_millis;
        let advice = slow_owner(ms(20), ms(20), ms(0)).unwrap();
        assert!(
            advice.starts_with("Setpoints come every 20.0 ms; setpoint-timeout-ms is 20: raise it"),
            "{advice}"
        );
        assert!(advice.contains("to 60,"), "{advice}");
        assert_eq!(slow_owner(ms(1), ms(20), ms(0)), None, "a fast owner that stops is not slow");
        assert_eq!(slow_owner(ms(10), ms(20), ms(0)), None, "one lost message is no timeout");
        assert_eq!(slow_owner(ms(20), ms(20), ms(25)), None, "the timeout begins at the end of the horizon");
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
