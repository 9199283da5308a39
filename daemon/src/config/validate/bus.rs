//! `[[bus]]`, and whether its motors fit on it.

use std::path::Path;

use motord_shared::limits::BUSES_MAX;
use toml::Spanned;

use crate::config::problem::Wrong;
use crate::config::written::{BusType, Integer, Text};
use crate::config::{Findings, fnv1a, range, written};
use motord_core::plan::{BusPlan, WORST_CASE_SOUND};
use motord_core::settings::{BusKind, BusSettings, Settings};

type Written = Spanned<written::Bus>;

/// Where the kernel lists its network interfaces.
const INTERFACES: &str = "/sys/class/net";
/// `IFNAMSIZ` of Linux without the closing zero.
const INTERFACE_BYTES_MAX: usize = 15;

/// All buses, in the order of the file; `None` when one is not understood.
pub(super) fn buses(written: &[Written], findings: &mut Findings<'_>) -> Option<Vec<BusSettings>> {
    if !findings.counted(written, "bus", BUSES_MAX) {
        return None;
    }
    // Collected twice: the first bad bus must not hide the others.
    let buses: Vec<_> = written.iter().map(|bus| self::bus(bus, findings)).collect();
    let names = written.iter().map(|bus| bus.get_ref().name.as_ref());
    let are_named_apart = findings.unique(names, |name| Wrong::DuplicateName { name, what: "bus" });
    let devices =
        written.iter().map(|bus| bus.get_ref().interface.as_ref().or(bus.get_ref().device.as_ref()));
    findings.unique(devices, |name| Wrong::DuplicateDevice { name });
    buses.into_iter().collect::<Option<_>>().filter(|_| are_named_apart)
}

fn bus(written: &Written, findings: &mut Findings<'_>) -> Option<BusSettings> {
    let table = written.span();
    let keys = written.get_ref();
    let name = findings.required(&keys.name, &table, "name", "every [[bus]] needs a name");
    let name = name.and_then(|name| findings.name(name));
    let hint = "give socketcan, serial or simulated";
    let kind = findings.required(&keys.r#type, &table, "type", hint);
    let kind = kind.and_then(|kind| self::kind(kind, written, findings));
    Some(BusSettings { name: name?, kind: kind? })
}

fn kind(kind: &Spanned<BusType>, written: &Written, findings: &mut Findings<'_>) -> Option<BusKind> {
    let keys = written.get_ref();
    refuse_foreign_keys(*kind.get_ref(), keys, findings);
    let bitrate = findings.integer(&keys.bitrate, range::BITRATE) as u32;
    match kind.get_ref() {
        BusType::SocketCan => {
            let hint = "give the CAN interface, such as interface = \"can0\"";
            let interface = findings.required(&keys.interface, &written.span(), "interface", hint)?;
            Some(BusKind::SocketCan { interface: self::interface(interface, findings)?, bitrate })
        }
        BusType::Serial => {
            findings.error(kind.span(), Wrong::SerialBus);
            let hint = "give the serial device, such as device = \"/dev/ttyUSB0\"";
            let device = findings.required(&keys.device, &written.span(), "device", hint)?;
            let baud = findings.integer(&keys.baud, range::BAUD) as u32;
            Some(BusKind::Serial { device: self::device(device, findings)?, baud })
        }
        BusType::Simulated => {
            // Two buses of one file differ in their names, so their noise differs too.
            let seed = keys.name.as_ref().map_or(0, |name| fnv1a(name.get_ref().as_bytes()));
            let seed = keys.seed.as_ref().map_or(seed, |seed| seed.get_ref().cast_unsigned());
            Some(BusKind::Simulated { bitrate, seed })
        }
    }
}

/// A key of another type is a sign that the type is wrong, or the key is believed to act.
fn refuse_foreign_keys(kind: BusType, keys: &written::Bus, findings: &mut Findings<'_>) {
    use BusType::{Serial, Simulated, SocketCan};
    let text = |key: &Text| key.as_ref().map(Spanned::span);
    let integer = |key: &Integer| key.as_ref().map(Spanned::span);
    let owners: [(_, &[BusType]); 5] = [
        (text(&keys.interface), &[SocketCan]),
        (integer(&keys.bitrate), &[SocketCan, Simulated]),
        (text(&keys.device), &[Serial]),
        (integer(&keys.baud), &[Serial]),
        (integer(&keys.seed), &[Simulated]),
    ];
    for (place, kinds) in owners {
        if let Some(place) = place
            && !kinds.contains(&kind)
        {
            findings.error(place, Wrong::NotOfThisBus { kind: kind.name() });
        }
    }
}

/// A name that Linux would accept. An adapter may be plugged in later, so one that is not there is only worth a warning.
fn interface(written: &Spanned<String>, findings: &mut Findings<'_>) -> Option<String> {
    let name = written.get_ref().clone();
    let is_plain = |c: char| c.is_ascii_graphic() && c != '/' && c != ':';
    if !(1..=INTERFACE_BYTES_MAX).contains(&name.len())
        || !name.chars().all(is_plain)
        || name.starts_with('.')
    {
        findings.error(written.span(), Wrong::InterfaceName { name });
        return None;
    }
    if !Path::new(INTERFACES).join(&name).exists() {
        findings.warn(written.span(), Wrong::NoInterface(name.clone()));
    }
    Some(name)
}

fn device(written: &Spanned<String>, findings: &mut Findings<'_>) -> Option<String> {
    let path = written.get_ref().clone();
    if !Path::new(&path).is_absolute() || path.contains('\0') {
        findings.error(written.span(), Wrong::DevicePath { path });
        return None;
    }
    if !Path::new(&path).exists() {
        findings.warn(written.span(), Wrong::NoDevice(path.clone()));
    }
    Some(path)
}

/// Whether every bus has room for its motors in a cycle.
pub(super) fn judge_load(written: &[Written], settings: &Settings, findings: &mut Findings<'_>) {
    let rate_hz = settings.cycle.rate_hz;
    for (plan, place) in BusPlan::of(settings).iter().zip(written) {
        let (motors, percent) = (plan.motors, 100.0 * plan.worst_case_utilisation);
        if motors == 0 {
            findings.warn(place.span(), Wrong::EmptyBus);
        } else if plan.worst_case_utilisation > 1.0 {
            let rate_hz_max = (rate_hz / plan.worst_case_utilisation).floor();
            findings.error(place.span(), Wrong::Overloaded { motors, rate_hz, percent, rate_hz_max });
        } else if plan.worst_case_utilisation > WORST_CASE_SOUND {
            findings.warn(place.span(), Wrong::Tight { motors, rate_hz, percent });
        }
        let polls = settings.safety.fault_poll_hz > 0.0;
        if polls && plan.worst_case_utilisation <= 1.0 && plan.fault_poll_utilisation > 1.0 {
            let percent = 100.0 * plan.fault_poll_utilisation;
            findings.warn(place.span(), Wrong::FaultPollTight { percent });
        }
    }
}
