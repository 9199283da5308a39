//! The configuration file: what the bridge publishes, and whether it accepts commands.

mod foxglove;
mod gamepad;
mod gpio;
mod web;

pub(crate) use self::foxglove::Foxglove;
pub(crate) use self::gamepad::Gamepad;
pub(crate) use self::gpio::{Gpio, RunLevel};
pub(crate) use self::web::Web;

use serde::Deserialize;
use serde::de::{self, Deserializer, SeqAccess, Visitor};
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The file that `run` and `check` read by default.
pub(crate) const DEFAULT_FILE: &str = "/etc/motord/bridge.toml";

/// Highest domain id whose UDP ports exist.
pub(crate) const DOMAIN_MAX: u16 = 232;

/// The whole file. Every key has a default, so an empty file only publishes.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub(crate) struct Config {
    pub(crate) robot: Robot,
    pub(crate) ros2: Ros2,
    pub(crate) foxglove: Foxglove,
    pub(crate) commands: Commands,
    pub(crate) web: Web,
    pub(crate) gamepad: Gamepad,
    pub(crate) gpio: Gpio,
    /// By the name of the group.
    pub(crate) group: BTreeMap<String, Gains>,
}

/// The daemon.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub(crate) struct Robot {
    /// The instance's name.
    pub(crate) instance: String,
}

impl Default for Robot {
    fn default() -> Self {
        Self { instance: motord_client::DEFAULT_INSTANCE.to_owned() }
    }
}

/// The addresses with which the bridge exchanges messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Range {
    /// 127.0.0.1 only.
    Localhost,
    /// Every interface.
    Subnet,
}

/// The node and its topics.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub(crate) struct Ros2 {
    /// Accept commands, and the services except stop.
    pub(crate) commands: bool,
    /// `None`: `ROS_DOMAIN_ID`, or 0.
    pub(crate) domain_id: Option<u16>,
    /// `None`: `ROS_LOCALHOST_ONLY`, `ROS_AUTOMATIC_DISCOVERY_RANGE`, or localhost.
    pub(crate) discovery_range: Option<Range>,
    /// Publish states reliably. Otherwise best effort, which reliable subscriptions do not match. A
    /// lost reliable state delays those after it.
    pub(crate) reliable_states: bool,
    /// Messages per second, 0 for none. At most one per cycle.
    pub(crate) joint_states_hz: f64,
    /// As `joint_states_hz`.
    pub(crate) imu_hz: f64,
    /// As `joint_states_hz`.
    pub(crate) group_states_hz: f64,
    /// As `joint_states_hz`, at most 10.
    pub(crate) diagnostics_hz: f64,
    /// The `frame_id` of IMUs: motord turns their samples into the frame of the body.
    pub(crate) imu_frame: String,
    /// The URDF that `/robot_description` publishes.
    pub(crate) robot_description: Option<PathBuf>,
}

impl Default for Ros2 {
    fn default() -> Self {
        Self {
            commands: false,
            domain_id: None,
            discovery_range: None,
            reliable_states: false,
            joint_states_hz: 100.0,
            imu_hz: 100.0,
            group_states_hz: 50.0,
            diagnostics_hz: 1.0,
            imu_frame: "base_link".to_owned(),
            robot_description: None,
        }
    }
}

/// Which commands count.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub(crate) struct Commands {
    /// Longest time from the arrival of a command, or from the end of its horizon or trajectory,
    /// to the next one. Then the bridge disables the group.
    pub(crate) timeout_ms: f64,
    /// Largest age of a command's stamp when it arrives.
    pub(crate) max_age_ms: f64,
    /// Most that a stamp may be ahead of this computer's clock.
    pub(crate) max_ahead_ms: f64,
    /// A stamp of zero is replaced by the time at which the DDS writer sent the message.
    pub(crate) allow_zero_stamp: bool,
    /// Step of a trajectory that needs no time, rad. A longer one needs the time that the joint's
    /// velocity limit demands.
    pub(crate) trajectory_step_rad: f64,
    /// Longest trajectory. A writer that dies does not end its trajectory.
    pub(crate) trajectory_max_s: f64,
}

impl Default for Commands {
    fn default() -> Self {
        Self {
            timeout_ms: 100.0,
            max_age_ms: 100.0,
            max_ahead_ms: 10.0,
            allow_zero_stamp: false,
            trajectory_step_rad: 0.05,
            trajectory_max_s: 10.0,
        }
    }
}

impl Commands {
    pub(crate) fn timeout(&self) -> Duration {
        Duration::from_secs_f64(self.timeout_ms / 1e3)
    }
}

/// The gains of commands that have none, by joint of the group.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub(crate) struct Gains {
    /// N·m/rad.
    pub(crate) kp: Numbers,
    /// N·m·s/rad.
    pub(crate) kd: Numbers,
}

/// One number for every joint of the group, or one for each, in the group's order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Numbers {
    All(f64),
    Each(Vec<f64>),
}

impl Numbers {
    /// Returns a number for each of `count` joints; `None` for a list of another length.
    pub(crate) fn of(&self, count: usize) -> Option<Vec<f64>> {
        match self {
            Self::All(number) => Some(vec![*number; count]),
            Self::Each(numbers) => (numbers.len() == count).then(|| numbers.clone()),
        }
    }

    fn are_gains(&self) -> bool {
        let is_gain = |number: &f64| number.is_finite() && (0.0..=1e5).contains(number);
        match self {
            Self::All(number) => is_gain(number),
            Self::Each(numbers) => !numbers.is_empty() && numbers.iter().all(is_gain),
        }
    }
}

impl<'a> Deserialize<'a> for Numbers {
    fn deserialize<D: Deserializer<'a>>(deserializer: D) -> Result<Self, D::Error> {
        struct AnyOf;
        impl<'a> Visitor<'a> for AnyOf {
            type Value = Numbers;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, or a list with one number per joint of the group")
            }
            fn visit_f64<E: de::Error>(self, number: f64) -> Result<Numbers, E> {
                Ok(Numbers::All(number))
            }
            fn visit_i64<E: de::Error>(self, number: i64) -> Result<Numbers, E> {
                Ok(Numbers::All(number as f64))
            }
            fn visit_seq<S: SeqAccess<'a>>(self, mut numbers: S) -> Result<Numbers, S::Error> {
                let mut each = Vec::new();
                while let Some(number) = numbers.next_element()? {
                    each.push(number);
                }
                Ok(Numbers::Each(each))
            }
        }
        deserializer.deserialize_any(AnyOf)
    }
}

/// The reason why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ConfigError {
    #[error("cannot read {}: {error}. Write it after the example `bridge.toml`, or name another file with --config", path.display())]
    Read { path: PathBuf, error: std::io::Error },
    #[error("{}: {error}", path.display())]
    Syntax { path: PathBuf, error: toml::de::Error },
    #[error("{key} is {value}; it must be {allowed}")]
    Value { key: String, value: String, allowed: String },
    /// The page cannot be served in this way.
    #[error("{0}")]
    Web(String),
    /// A device cannot be used in this way.
    #[error("{0}")]
    Device(String),
}

impl Config {
    /// Reads and checks the file.
    pub(crate) fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| ConfigError::Read { path: path.to_owned(), error })?;
        let config: Self =
            toml::from_str(&text).map_err(|error| ConfigError::Syntax { path: path.to_owned(), error })?;
        config.check()?;
        Ok(config)
    }

    fn check(&self) -> Result<(), ConfigError> {
        let (ros2, commands) = (&self.ros2, &self.commands);
        within("ros2.joint-states-hz", ros2.joint_states_hz, 0.0, 1000.0)?;
        within("ros2.imu-hz", ros2.imu_hz, 0.0, 1000.0)?;
        within("ros2.group-states-hz", ros2.group_states_hz, 0.0, 1000.0)?;
        within("ros2.diagnostics-hz", ros2.diagnostics_hz, 0.0, 10.0)?;
        within("ros2.domain-id", f64::from(ros2.domain_id.unwrap_or(0)), 0.0, f64::from(DOMAIN_MAX))?;
        within("commands.timeout-ms", commands.timeout_ms, 5.0, 1000.0)?;
        within("commands.max-age-ms", commands.max_age_ms, 1.0, 1000.0)?;
        within("commands.max-ahead-ms", commands.max_ahead_ms, 0.0, 1000.0)?;
        within("commands.trajectory-step-rad", commands.trajectory_step_rad, 0.0, 1.0)?;
        within("commands.trajectory-max-s", commands.trajectory_max_s, 0.1, 60.0)?;
        self.web.check().map_err(ConfigError::Web)?;
        self.gamepad.check().map_err(ConfigError::Device)?;
        self.gpio.check().map_err(ConfigError::Device)?;
        self.check_foxglove()?;
        for (name, gains) in &self.group {
            for (key, numbers) in [("kp", &gains.kp), ("kd", &gains.kd)] {
                if !numbers.are_gains() {
                    let allowed = "from 0 to 100000 for each joint".to_owned();
                    let key = format!("group.{name}.{key}");
                    return Err(ConfigError::Value { key, value: format!("{numbers:?}"), allowed });
                }
            }
        }
        Ok(())
    }
}

impl Config {
    fn check_foxglove(&self) -> Result<(), ConfigError> {
        let foxglove = &self.foxglove;
        within("foxglove.joints-hz", foxglove.joints_hz, 0.0, 1000.0)?;
        within("foxglove.imus-hz", foxglove.imus_hz, 0.0, 1000.0)?;
        within("foxglove.groups-hz", foxglove.groups_hz, 0.0, 1000.0)?;
        within("foxglove.buses-hz", foxglove.buses_hz, 0.0, 1000.0)?;
        within("foxglove.latencies-hz", foxglove.latencies_hz, 0.0, 10.0)?;
        within("foxglove.backlog", foxglove.backlog.into(), 16.0, 16384.0)?;
        let refuse = |key: &str, value: String, allowed: &str| {
            Err(ConfigError::Value { key: key.to_owned(), value, allowed: allowed.to_owned() })
        };
        if !foxglove.is_local() && !foxglove.allow_remote {
            let allowed = "127.0.0.1 or ::1, or `allow-remote = true` must permit everyone who reaches it to stop the robot";
            return refuse("foxglove.address", foxglove.address.to_string(), allowed);
        }
        match (&foxglove.tls_certificate, &foxglove.tls_key) {
            (Some(_), None) => {
                refuse("foxglove.tls-key", "missing".to_owned(), "the key of `tls-certificate`")
            }
            (None, Some(_)) => {
                refuse("foxglove.tls-certificate", "missing".to_owned(), "the certificate of `tls-key`")
            }
            _ => Ok(()),
        }
    }
}

fn within(key: &str, value: f64, least: f64, most: f64) -> Result<(), ConfigError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    let allowed = format!("from {least} to {most}");
    Err(ConfigError::Value { key: key.to_owned(), value: value.to_string(), allowed })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Config, String> {
        let config: Config = toml::from_str(text).map_err(|error| error.to_string())?;
        config.check().map_err(|error| error.to_string())?;
        Ok(config)
    }

    #[test]
    fn empty_file_accepts_no_commands() {
        assert!(!parse("").unwrap().ros2.commands);
    }

    #[test]
    fn shipped_example_has_the_default_values() {
        let example = parse(include_str!("../bridge.toml")).unwrap();
        assert_eq!(Config { group: BTreeMap::new(), ..example }, Config::default());
    }

    #[test]
    fn unknown_key_is_refused_by_name() {
        let error = parse("[ros2]\ncomands = true").unwrap_err();
        assert!(error.contains("comands") && error.contains("commands"), "{error}");
    }

    #[test]
    fn values_out_of_range_name_key_and_range() {
        for (text, key) in [
            ("[ros2]\njoint-states-hz = -1.0", "ros2.joint-states-hz"),
            ("[ros2]\nimu-hz = nan", "ros2.imu-hz"),
            ("[ros2]\ndomain-id = 233", "ros2.domain-id"),
            ("[commands]\ntimeout-ms = 1e9", "commands.timeout-ms"),
            ("[foxglove]\njoints-hz = 1e9", "foxglove.joints-hz"),
            ("[foxglove]\nbacklog = 1", "foxglove.backlog"),
            ("[group.legs]\nkp = -1\nkd = 1", "group.legs.kp"),
            ("[group.legs]\nkp = 1\nkd = [1.0, inf]", "group.legs.kd"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(key) && error.contains("from"), "{error}");
        }
    }

    #[test]
    fn server_for_viewers_is_off_and_local() {
        let Config { foxglove, .. } = parse("").unwrap();
        assert!(!foxglove.enabled && foxglove.is_local() && !foxglove.allow_remote);
    }

    #[test]
    fn devices_are_off_by_default() {
        let config = parse("").unwrap();
        assert!(!config.gamepad.enabled && !config.gpio.enabled);
    }

    #[test]
    fn remote_address_needs_explicit_permission() {
        for address in ["0.0.0.0", "192.168.1.2", "::", "::ffff:127.0.0.1"] {
            let text = format!("[foxglove]\naddress = \"{address}\"\n");
            let error = parse(&text).unwrap_err();
            assert!(error.contains("allow-remote"), "{error}");
            assert!(parse(&(text + "allow-remote = true")).is_ok());
        }
        assert!(parse("[foxglove]\naddress = \"::1\"").is_ok());
    }

    #[test]
    fn certificate_and_key_need_each_other() {
        let error = parse("[foxglove]\ntls-key = \"key.pem\"").unwrap_err();
        assert!(error.contains("tls-certificate"), "{error}");
        let error = parse("[foxglove]\ntls-certificate = \"cert.pem\"").unwrap_err();
        assert!(error.contains("tls-key"), "{error}");
    }

    #[test]
    fn gains_are_one_number_or_one_each() {
        let config = parse("[group.legs]\nkp = 40\nkd = [1.0, 2.0]").unwrap();
        let gains = &config.group["legs"];
        assert_eq!(gains.kp.of(2), Some(vec![40.0, 40.0]));
        assert_eq!(gains.kd.of(2), Some(vec![1.0, 2.0]));
        assert_eq!(gains.kd.of(3), None);
    }
}
