//! `motorctl imu set --bus`: the CANopen settings of a HiPNUC.

use crate::failure::DirectFailure;
use crate::imu_bus::{self, Node};
use crate::imu_values::{Set, Values};
use motord_bus::arithmetic::{IdWidth, worst_case_bits};
use motord_bus::socketcan::{InterfaceName, SocketCanBus};
use motord_bus::{Bus as _, BusLock, Content, Duration, Frame, FrameId, Inbox, clock, wait};
use motord_protocol::imu::hipnuc::can::Tpdo;
use motord_protocol::imu::hipnuc::command::{self, Answer};
use motord_protocol::imu::{CanAddress, CanDevice, CanProtocol, CanRequest};
use motord_terminal::Interrupt;

/// Longest wait for the answer to a request.
const ANSWER: Duration = Duration::from_millis(300);
/// A request without an answer is sent again this many times: a write has the same effect twice.
const TRIES: usize = 3;
/// Rates whose periods are whole milliseconds, Hz.
const RATES: [u16; 8] = [10, 20, 25, 40, 50, 100, 125, 200];

/// A device on a bus.
struct Device<'a> {
    interface: &'a str,
    node: u8,
    bus: SocketCanBus,
}

/// Sets the device `node`, which must send samples, and measures them.
///
/// # Errors
///
/// The device or its line cannot have the value, the port or bus is in use, or the device does not
/// do as asked.
pub(crate) fn set(
    interface: &str,
    node: u8,
    values: Values,
    interrupt: &Interrupt,
    consent: impl FnOnce(String) -> Result<(), DirectFailure>,
) -> Result<Set, DirectFailure> {
    let name: InterfaceName = interface.parse().map_err(|_| {
        DirectFailure::Usage(format!("`{interface}` is no CAN interface: `ip link` lists them"))
    })?;
    let _lock = BusLock::interface(name)?;
    let mut device = Device { interface, node, bus: SocketCanBus::open_as_is(name)? };
    let requests = device.requests(values)?;
    let present = device.present(interrupt)?;
    if let Some(other) = values.node.filter(|new| present.iter().any(|one| one.id == *new)) {
        return Err(device.failed(format!("node {other} sends on this bus already")));
    }
    consent(format!("This changes and stores the settings of the IMU with node {node} on {interface}."))?;
    for (request, value) in &requests {
        device.write(request, *value)?;
    }
    let found = device.present(interrupt)?;
    let measured_hz = found.iter().find(|one| one.id == node).map_or(0.0, |one| one.measured_hz);
    Ok(Set {
        kind: CanProtocol::Hipnuc.name(),
        device: None,
        bus: Some(interface.to_owned()),
        node_id: Some(node),
        asked: values,
        measured_hz,
        needs_power_cycle: values.node.is_some() || values.bitrate.is_some(),
    })
}

impl Device<'_> {
    fn failed(&self, reason: String) -> DirectFailure {
        DirectFailure::Imu { address: format!("{} node {}", self.interface, self.node), reason }
    }

    /// Returns the requests with their values, or refuses values that the device or the bus cannot
    /// have.
    fn requests(&self, values: Values) -> Result<Vec<(CanRequest, u32)>, DirectFailure> {
        let usage = DirectFailure::Usage;
        let mut requests = Vec::new();
        if let Some(rate) = values.rate_hz {
            if !RATES.contains(&rate) {
                let known: Vec<_> = RATES.iter().map(u16::to_string).collect();
                return Err(usage(format!("{rate} Hz: a HiPNUC on CAN has {}", known.join(", "))));
            }
            self.check_load(rate)?;
            let period = 1000 / rate;
            let tpdos = Tpdo::ALL.into_iter().filter_map(|tpdo| command::period(self.node, tpdo, period));
            requests.extend(tpdos.map(|request| (request, period.into())));
        }
        if let Some(node) = values.node {
            let request = command::set_node(self.node, node);
            requests
                .push((request.ok_or_else(|| usage(format!("node {node}: expected 1 to 64")))?, node.into()));
        }
        if let Some(rate) = values.bitrate {
            let request = command::set_bit_rate(self.node, rate);
            let expected = "expected 125000, 250000, 500000 or 1000000";
            requests.push((request.ok_or_else(|| usage(format!("{rate} bit/s: {expected}")))?, rate));
        }
        Ok(requests)
    }

    /// Refuses a rate whose frames alone are more than the bus carries.
    fn check_load(&self, rate: u16) -> Result<(), DirectFailure> {
        let Some(bitrate) = self.bus.link().bitrate else { return Ok(()) };
        let address = CanAddress { node_id: self.node, ..CanAddress::default() };
        let frames = CanDevice::new(CanProtocol::Hipnuc, address).frames();
        let bits: u32 = frames.map(|(_, bytes)| worst_case_bits(IdWidth::Standard, bytes)).sum();
        let most = bitrate / bits;
        if u32::from(rate) > most {
            return Err(DirectFailure::Usage(format!(
                "{rate} Hz: {} with {bitrate} bit/s carries at most {most} Hz, without other devices",
                self.interface
            )));
        }
        Ok(())
    }

    /// Returns the HiPNUC devices that send, among which this one must be: a request to another one
    /// could command a motor.
    fn present(&self, interrupt: &Interrupt) -> Result<Vec<Node>, DirectFailure> {
        let nodes = imu_bus::listen(self.interface, interrupt)?;
        if nodes.iter().any(|one| one.id == self.node) {
            return Ok(nodes);
        }
        Err(self.failed(
            "no HiPNUC with this node sends its TPDOs 1, 2 and 4, so nothing is written: check power, wiring and bit rate; \
             `motorctl imu find --bus` lists the nodes"
                .to_owned(),
        ))
    }

    /// Writes a value, and reads it back.
    fn write(&mut self, request: &CanRequest, value: u32) -> Result<(), DirectFailure> {
        self.ask(request)?;
        match self.ask(&command::read_back(request))? {
            Answer::Value(stored) if stored == value => Ok(()),
            Answer::Value(stored) => Err(self.failed(format!("wrote {value}, read back {stored}"))),
            _ => Err(self.failed(format!("wrote {value}; the device does not return the value"))),
        }
    }

    /// Sends a request until the device answers.
    fn ask(&mut self, request: &CanRequest) -> Result<Answer, DirectFailure> {
        let frame = FrameId::new(request.id()).and_then(|id| Frame::new(id, request.payload()));
        let frame = frame.ok_or_else(|| self.failed("the request has no frame".to_owned()))?;
        for _ in 0..TRIES {
            let sent = self.bus.send(clock::monotonic(), &[frame]);
            if let Some(refusal) = sent.refusal {
                return Err(motord_protocol::commissioning::Error::Bus(refusal).into());
            }
            match self.answer(request) {
                Some(Answer::Refused(code)) => {
                    return Err(self.failed(format!("the device refuses with the CANopen code {code:#010X}")));
                }
                Some(answer) => return Ok(answer),
                None => {}
            }
        }
        Err(self.failed("the device does not answer SDO requests".to_owned()))
    }

    /// Waits for the answer to a request.
    fn answer(&mut self, request: &CanRequest) -> Option<Answer> {
        let end = clock::monotonic() + ANSWER;
        let mut inbox = Inbox::new();
        loop {
            let now = clock::monotonic();
            if now >= end || !wait(&[self.bus.readiness()], now, end).any() {
                return None;
            }
            inbox.clear();
            self.bus.receive(clock::monotonic(), &mut inbox);
            let answer = inbox.arrivals().iter().find_map(|arrival| match &arrival.content {
                Content::Frame(frame) if !frame.id().is_extended() => {
                    command::answer(request, u16::try_from(frame.id().raw()).ok()?, frame.payload())
                }
                _ => None,
            });
            if answer.is_some() {
                return answer;
            }
        }
    }
}
