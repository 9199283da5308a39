//! The properties that distinguish one adapter from another, as sysfs shows them.
//!
//! The kernel gives names such as `can0` and `ttyUSB0` in the order of connection. After two
//! adapters were unplugged, each may return under the name of the other.

use core::fmt;
use std::fs;
use std::path::{Component, Path, PathBuf};

use crate::identity::Identity;

/// A property of an adapter, and its value.
type Property = (&'static str, Option<String>);

/// The adapter behind an interface or a serial port: its driver, where it is plugged in, its serial
/// number, and the channel of an adapter with several. Virtual interfaces, pseudo terminals and
/// interfaces of `slcan` have none of these, and cannot be distinguished.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Adapter([Property; 7]);

/// The properties in which an adapter differs from the expected one. Never empty.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference(Vec<(&'static str, String, String)>);

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, (name, expected, received)) in self.0.iter().enumerate() {
            let separator = if index == 0 { "" } else { "; " };
            write!(f, "{separator}{name} {received}, expected {expected}")?;
        }
        Ok(())
    }
}

impl Adapter {
    /// Reads the adapter of a bus. A property that cannot be read is absent. Not for the real-time
    /// thread: reads about ten files.
    #[must_use]
    pub fn of(identity: Identity) -> Self {
        Self::read(&identity.folder())
    }

    /// Returns how `other` differs from this adapter; `None` when it does not.
    #[must_use]
    pub fn difference(&self, other: &Self) -> Option<Difference> {
        let shown = |value: &Option<String>| value.clone().unwrap_or_else(|| "none".into());
        let pairs = self.0.iter().zip(&other.0).filter(|(expected, received)| expected != received);
        let differing: Vec<_> = pairs
            .map(|((name, expected), (_, received))| (*name, shown(expected), shown(received)))
            .collect();
        (!differing.is_empty()).then_some(Difference(differing))
    }

    /// Reads the folder of an interface or a terminal.
    fn read(folder: &Path) -> Self {
        let device = fs::canonicalize(folder.join("device")).ok();
        let device = device.map(|device| without_terminal(device, folder));
        let usb = device.as_deref().and_then(usb_device);
        let of_usb = |file: &str| usb.and_then(|usb| text(&usb.join(file)));
        let driver = device.as_deref().and_then(|device| fs::canonicalize(device.join("driver")).ok());
        let model = of_usb("idVendor").zip(of_usb("idProduct"));
        let channel = |file| text(&folder.join(file));
        Self([
            ("driver", driver.as_deref().and_then(last).map(str::to_owned)),
            ("port", device.as_deref().map(port)),
            ("USB model", model.map(|(vendor, product)| format!("{vendor}:{product}"))),
            ("serial number", of_usb("serial")),
            ("dev_port", channel("dev_port")),
            ("dev_id", channel("dev_id")),
            ("port_number", channel("device/port_number")),
        ])
    }
}

/// The folder that a USB serial adapter has below its USB interface is called like the terminal.
fn without_terminal(mut device: PathBuf, folder: &Path) -> PathBuf {
    let terminal = fs::canonicalize(folder).ok();
    if terminal.as_deref().and_then(last) == last(&device) {
        device.pop();
    }
    device
}

/// Returns the USB device that the device belongs to.
fn usb_device(device: &Path) -> Option<&Path> {
    device.ancestors().find(|folder| folder.join("idVendor").exists())
}

/// Returns the path of a device below `/sys/devices`, without the numbers of USB buses: the kernel
/// gives those in the order in which it starts the controllers.
fn port(device: &Path) -> String {
    let names = device.components().filter_map(|component| match component {
        Component::Normal(name) => name.to_str(),
        _ => None,
    });
    let ports =
        names.skip_while(|name| matches!(*name, "sys" | "devices")).map(|name| match name.split_once('-') {
            _ if name.strip_prefix("usb").is_some_and(is_number) => "usb",
            Some((bus, port)) if is_number(bus) => port,
            _ => name,
        });
    ports.collect::<Vec<_>>().join("/")
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

fn last(path: &Path) -> Option<&str> {
    path.file_name()?.to_str()
}

/// Returns the first line of a file, without control characters: an adapter chooses its serial
/// number.
fn text(file: &Path) -> Option<String> {
    let text = fs::read_to_string(file).ok()?;
    let line: String = text.lines().next()?.trim().chars().filter(|letter| !letter.is_control()).collect();
    (!line.is_empty()).then_some(line)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    /// A USB adapter of sysfs, with one interface `name`.
    fn plug_in(sys: &Path, usb_port: &str, serial: &str, name: &str) -> PathBuf {
        let usb = sys.join(format!("devices/pci0000:00/0000:00:14.0/usb1/1-1/{usb_port}"));
        let interface = usb.join(format!("{usb_port}:1.0"));
        let folder = interface.join("net").join(name);
        fs::create_dir_all(&folder).unwrap();
        fs::create_dir_all(sys.join("drivers/gs_usb")).unwrap();
        symlink(sys.join("drivers/gs_usb"), interface.join("driver")).unwrap();
        symlink(&interface, folder.join("device")).unwrap();
        for (file, value) in [("idVendor", "1d50"), ("idProduct", "606f"), ("serial", serial)] {
            fs::write(usb.join(file), format!("{value}\n")).unwrap();
        }
        fs::write(folder.join("dev_port"), "0\n").unwrap();
        folder
    }

    #[test]
    fn exchanged_adapters_differ_in_port_and_serial_number() {
        let sys = tempfile::tempdir().unwrap();
        let left = Adapter::read(&plug_in(sys.path(), "1-1.2", "LEFT", "can0"));
        let right = Adapter::read(&plug_in(sys.path(), "1-1.3", "RIGHT", "can1"));
        assert_eq!(left.difference(&left), None);
        let difference = left.difference(&right).unwrap().to_string();
        assert!(difference.contains("/usb/1/1.3/1.3:1.0, expected "), "{difference}");
        assert!(difference.ends_with("; serial number RIGHT, expected LEFT"), "{difference}");
    }

    #[test]
    fn number_of_usb_bus_is_no_difference() {
        let paths = ["usb1/1-1/1-1.2/1-1.2:1.0", "usb3/3-1/3-1.2/3-1.2:1.0"];
        let ports = paths.map(|path| port(&Path::new("/sys/devices/pci0000:00/0000:00:14.0").join(path)));
        assert_eq!(ports, ["pci0000:00/0000:00:14.0/usb/1/1.2/1.2:1.0"; 2]);
        assert_eq!(port(Path::new("/sys/devices/platform/soc/spi-0")), "platform/soc/spi-0");
    }

    #[test]
    fn channels_of_one_adapter_differ() {
        let sys = tempfile::tempdir().unwrap();
        let folder = plug_in(sys.path(), "1-2", "BOTH", "can0");
        let first = Adapter::read(&folder);
        fs::write(folder.join("dev_port"), "1\n").unwrap();
        let difference = first.difference(&Adapter::read(&folder)).unwrap();
        assert_eq!(difference.to_string(), "dev_port 1, expected 0");
    }

    #[test]
    fn serial_adapter_is_found_under_another_number() {
        let sys = tempfile::tempdir().unwrap();
        let terminal = |number: u32, port: &str| {
            let folder = plug_in(sys.path(), port, port, "unused");
            let interface = fs::canonicalize(folder.join("device")).unwrap();
            let device = interface.join(format!("ttyUSB{number}"));
            let folder = device.join(format!("tty/ttyUSB{number}"));
            fs::create_dir_all(&folder).unwrap();
            symlink(&device, folder.join("device")).unwrap();
            let adapter = Adapter::read(&folder);
            fs::remove_dir_all(interface.ancestors().nth(1).unwrap()).unwrap();
            adapter
        };
        let before = terminal(0, "1-1.4");
        assert_eq!(before.difference(&terminal(5, "1-1.4")), None);
        assert!(before.difference(&terminal(0, "1-1.3")).is_some());
    }

    #[test]
    fn unreadable_properties_are_no_difference() {
        let missing = Adapter::read(Path::new("/nonexistent"));
        assert_eq!(missing.difference(&missing), None);
        let interface = Adapter::of(Identity::Interface(u32::MAX));
        assert_eq!(interface.difference(&interface.clone()), None);
    }
}
