//! `[[imu]]` on a CAN bus: its ids, its rate and its load.

use motord_bus::FrameId;
use motord_protocol::imu::{CanAddress, CanDevice, CanProtocol};
use motord_settings::plan::BusPlan;
use motord_settings::sensor::imu::{ImuCan, ImuSettings};
use motord_settings::settings::{MotorSettings, Settings};

use super::bus::{check_sensor_load, motor_with};
use crate::entry::{At, Item};
use crate::findings::Findings;
use crate::keys::{self, ImuTables};
use crate::problem::Wrong;

/// A rate this near to one of the device is that rate: 166.7 Hz is one in 6 ms.
const RATE_TOLERANCE: f64 = 0.005;

/// Returns the device with its ids.
pub(super) fn device(protocol: CanProtocol, keys: &keys::Imu) -> CanDevice {
    let new = CanAddress::default();
    let id = |value: Option<i64>, default: u16| value.map_or(default, |id| id as u16);
    let address = CanAddress {
        node_id: keys.node_id.value.map_or(new.node_id, |node| node as u8),
        can_id: id(keys.can_id.value, new.can_id),
        master_id: id(keys.master_id.value, new.master_id),
        firmware: id(keys.firmware.value, new.firmware),
    };
    CanDevice::new(protocol, address)
}

/// Reports what the device or its bus cannot do.
pub(super) fn check(items: &[Item<ImuTables>], settings: &Settings, findings: &mut Findings<'_>) {
    let plans = BusPlan::of(settings);
    for (index, (imu, item)) in settings.sensors.imus.iter().zip(items).enumerate() {
        let Some(can) = imu.source.can() else { continue };
        let keys = &item.keys.keys;
        check_ids(keys, (index, can), settings, findings);
        match can.device.protocol().rates_hz() {
            Some(rates) => check_rate(keys.rate_hz.at, imu.rate_hz, rates, findings),
            None => check_asked_rate(keys.rate_hz.at, imu.rate_hz, settings.cycle.rate_hz, findings),
        }
        check_sensor_load((keys.bus.at, "IMU"), &plans[can.bus], settings, findings);
    }
}

/// Reports an id that another node of the bus sends, or that a motor takes for a command.
fn check_ids(
    keys: &keys::Imu,
    (index, can): (usize, &ImuCan),
    settings: &Settings,
    findings: &mut Findings<'_>,
) {
    let mut motors = settings.motors.iter().filter(|motor| motor.bus == can.bus);
    let obeyed = |motor: &MotorSettings| {
        let ids = (0..=FrameId::MAX.raw() as u16).filter(|id| can.device.obeys(*id));
        ids.filter_map(FrameId::new).find(|id| motor.addresses().replies.matches(*id))
    };
    if let Some((id, motor)) = motors.find_map(|motor| Some((obeyed(motor)?.raw(), motor.name.clone()))) {
        findings.error(keys.bus.at, Wrong::ImuObeys { id, motor });
    }
    let (sent_by, key) = match can.device.request_id() {
        Some(_) => (keys.master_id.at, "master-id"),
        None => (keys.node_id.at, "node-id"),
    };
    let sent = can.device.sent_ids().map(|id| (id, sent_by, key));
    let asked = can.device.request_id().map(|id| (id, keys.can_id.at, "can-id"));
    let motors = sent.chain(asked).find_map(|it| Some((it, motor_with(settings, can.bus, it.0)?)));
    let used = motors.or_else(|| {
        let sent = can.device.sent_ids().map(|id| (id, sent_by, key));
        sent.chain(asked).find_map(|it| Some((it, imu_with(settings, index, it.0)?)))
    });
    if let Some(((id, at, key), other)) = used {
        findings.error(at, Wrong::SensorId { id, other, key });
    }
}

/// Returns the use that this IMU itself or an earlier one makes of an id, in words.
fn imu_with(settings: &Settings, index: usize, id: u16) -> Option<String> {
    let can = settings.sensors.imus[index].source.can()?;
    let sends = |can: &ImuCan| can.device.sent_ids().any(|sent| sent == id);
    let requests = |can: &ImuCan| can.device.request_id() == Some(id);
    if sends(can) && requests(can) {
        return Some("the requests to it".to_owned());
    }
    let collides = |other: &&ImuSettings| {
        let other = other.source.can().filter(|other| other.bus == can.bus);
        other.is_some_and(|other| match sends(can) || sends(other) {
            false => requests(can) && requests(other) && !have_own_requests(can, other, id),
            true => sends(other) || requests(other),
        })
    };
    let other = settings.sensors.imus[..index].iter().find(collides)?;
    Some(format!("the IMU {:?}", other.name))
}

/// Returns whether requests with the same `id` name one of the two devices in their payload.
fn have_own_requests(one: &ImuCan, other: &ImuCan, id: u16) -> bool {
    let [one, other] = [one, other].map(|can| can.device.address().can_id);
    one != other && one != id && other != id
}

fn check_rate(at: At, rate_hz: f64, [least, most]: [f64; 2], findings: &mut Findings<'_>) {
    let nearest = 1000.0 / (1000.0 / rate_hz.clamp(least, most)).round();
    if !is_near(rate_hz, nearest) {
        findings.error(at, Wrong::ImuRate { least, most, nearest: rounded(nearest) });
    }
}

fn check_asked_rate(at: At, rate_hz: f64, cycle_hz: f64, findings: &mut Findings<'_>) {
    let nearest = cycle_hz / f64::from(ImuCan::every(rate_hz, cycle_hz));
    if !is_near(rate_hz, nearest) {
        findings.error(at, Wrong::ImuNotAskedAt { cycle_hz, nearest: rounded(nearest) });
    }
}

fn is_near(rate_hz: f64, nearest: f64) -> bool {
    (rate_hz - nearest).abs() <= RATE_TOLERANCE * nearest
}

/// Returns the rate with one decimal.
fn rounded(rate_hz: f64) -> f64 {
    (10.0 * rate_hz).round() / 10.0
}
