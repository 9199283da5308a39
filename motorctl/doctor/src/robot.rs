//! The requirements of a robot, from its configuration.

use crate::finding::Finding;
use crate::tree::Tree;
use motord_configuration as configuration;
use motord_realtime::SchedulingRequest;
use motord_settings::settings::{IpcMode, Settings};
use std::path::Path;

/// The default configuration of motord.
const DEFAULT_CONFIG: &str = "/etc/motord/motord.toml";
/// The default instance.
const DEFAULT_INSTANCE: &str = "robot";
/// From the kernel's `if_arp.h`.
const ARPHRD_CAN: i64 = 280;
/// The defaults of the configuration.
const RATE_HZ: f64 = 1000.0;
const PRIORITY: u8 = 80;

/// A CAN interface of the robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Interface {
    /// Its name.
    pub name: String,
    /// The configured bit rate, bit/s; `None` without a configuration.
    pub bitrate: Option<u32>,
    /// Number of its motors; 0 without a configuration.
    pub motors: usize,
    /// Frames of a cycle that ask its IMUs.
    pub requests: usize,
}

/// The serial line of an IMU.
#[derive(Debug, Clone, PartialEq)]
pub struct ImuLine {
    /// The device.
    pub device: String,
    /// Bit/s.
    pub baud: u32,
    /// Part of the line that the samples take, 1 for all of it.
    pub utilisation: f64,
}

/// The requirements of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// Cycles per second.
    pub rate_hz: f64,
    /// The processor and the priority of the cycle.
    pub request: SchedulingRequest,
    /// `SCHED_FIFO` priority of a polling ipc thread.
    pub spins_at: Option<u8>,
    /// CAN interfaces.
    pub interfaces: Vec<Interface>,
    /// Serial devices, of buses and of IMUs.
    pub devices: Vec<String>,
    /// The lines of IMUs.
    pub imus: Vec<ImuLine>,
    /// The units of systemd that read the configuration: daemon and dead man's switch.
    pub units: Vec<String>,
    /// The instance of its daemon.
    pub instance: String,
    /// The process of its daemon, if it runs.
    pub daemon: Option<u32>,
}

/// Returns the units that read this configuration; none if it is not in `/etc/motord`.
fn units(configuration: &Path) -> Vec<String> {
    let instance = match configuration.parent() == Path::new(DEFAULT_CONFIG).parent() {
        true => configuration.file_name().and_then(|name| name.to_str()?.strip_suffix(".toml")),
        false => None,
    };
    let suffix = match instance {
        None => return Vec::new(),
        Some("motord") => String::new(),
        Some(instance) => format!("@{instance}"),
    };
    ["motord", "motord-deadman"].map(|name| format!("{name}{suffix}.service")).into()
}

/// Returns the requests to the IMUs of a bus in a cycle.
fn requests(settings: &Settings, bus: usize) -> usize {
    let imus = settings.sensors.imus.iter().filter_map(|imu| imu.source.can()).filter(|can| can.bus == bus);
    imus.map(|can| can.device.requests().count()).sum()
}

impl Default for Robot {
    /// Returns the requirements without a configuration: no interface and no device.
    fn default() -> Self {
        Self {
            rate_hz: RATE_HZ,
            request: SchedulingRequest { cpu: None, priority: Some(PRIORITY) },
            spins_at: None,
            interfaces: Vec::new(),
            devices: Vec::new(),
            imus: Vec::new(),
            units: Vec::new(),
            instance: DEFAULT_INSTANCE.to_owned(),
            daemon: None,
        }
    }
}

impl Robot {
    /// Reads the requirements from checked settings.
    #[must_use]
    pub fn of(settings: &Settings) -> Self {
        let mut robot = Self {
            rate_hz: settings.cycle.rate_hz,
            request: SchedulingRequest { cpu: settings.cycle.cpu, priority: Some(settings.cycle.priority) },
            spins_at: settings.ipc.priority.filter(|_| settings.ipc.mode == IpcMode::Spin),
            instance: settings.instance.clone(),
            ..Self::default()
        };
        for (index, bus) in settings.buses.iter().enumerate() {
            robot.interfaces.extend(bus.interface().map(|interface| Interface {
                name: interface.to_owned(),
                bitrate: Some(bus.kind.bitrate()),
                motors: settings.motors.iter().filter(|motor| motor.bus == index).count(),
                requests: requests(settings, index),
            }));
            robot.devices.extend(bus.kind.port().map(str::to_owned));
        }
        for imu in &settings.sensors.imus {
            let Some(line) = imu.source.serial() else { continue };
            let (device, utilisation) = (line.device.clone(), line.utilisation(imu.rate_hz));
            robot.devices.push(device.clone());
            robot.imus.push(ImuLine { device, baud: line.baud, utilisation });
        }
        robot
    }

    /// Returns the defaults, with every CAN interface of the computer.
    #[must_use]
    pub fn without_configuration(tree: &Tree) -> Self {
        let names = tree.names("sys/class/net").into_iter();
        let is_can = |name: &String| tree.number(&format!("sys/class/net/{name}/type")) == Some(ARPHRD_CAN);
        let interface = |name| Interface { name, bitrate: None, motors: 0, requests: 0 };
        Self { interfaces: names.filter(is_can).map(interface).collect(), ..Self::default() }
    }

    /// Loads the configuration at `file` or at the default path of `instance`. A refused one
    /// becomes a finding, and the defaults are returned.
    pub(crate) fn configured(file: Option<&Path>, instance: Option<&str>, tree: &Tree) -> (Self, Finding) {
        let default = Path::new(DEFAULT_CONFIG);
        let of_instance = instance.map(|name| default.with_file_name(format!("{name}.toml")));
        let path = file.or(of_instance.as_deref()).unwrap_or(default);
        let shown = path.display();
        let without = |instance: Option<&str>| {
            let robot = Self::without_configuration(tree);
            let instance = instance.map_or_else(|| robot.instance.clone(), str::to_owned);
            Self { instance, ..robot }
        };
        if file.is_none() && !path.exists() {
            let measured = format!("none at {shown}: defaults, and the CAN interfaces that are there");
            return (without(instance), Finding::good("configuration", measured));
        }
        match configuration::load(path) {
            Ok(loaded) => {
                let robot = Self { units: units(path), ..Self::of(&loaded.settings) };
                (robot, Finding::good("configuration", shown.to_string()))
            }
            Err(error) => {
                let why = "motord refuses it; the checks below are those of a configuration of defaults";
                let finding = Finding::bad("configuration", error.to_string(), why)
                    .mended_by(format!("motord check --config '{shown}'"));
                (without(instance), finding)
            }
        }
    }

    /// Returns the processors that the cycle may run on.
    pub(crate) fn processors(&self, tree: &Tree) -> Vec<usize> {
        self.request.cpu.map_or_else(|| tree.processors("sys/devices/system/cpu/online"), |cpu| vec![cpu])
    }

    /// Returns the priority of the cycle.
    pub(crate) fn priority(&self) -> u8 {
        self.request.priority.unwrap_or(PRIORITY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_a_configuration_have_its_name() {
        assert_eq!(units(Path::new("/etc/motord/motord.toml")), ["motord.service", "motord-deadman.service"]);
        assert_eq!(
            units(Path::new("/etc/motord/arm.toml")),
            ["motord@arm.service", "motord-deadman@arm.service"]
        );
        for other in ["robot.toml", "/etc/motord/arm", "/etc/motord.toml", "/", ""] {
            assert_eq!(units(Path::new(other)), [""; 0], "{other}");
        }
    }
}
