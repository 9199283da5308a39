//! The native commands, with types. Source: GIM document 3.2.

use crate::gim::{
    Calibration, Command, ConfigurationItem, ConfigurationKey, ExecutionTime, Finite, Outcome, Pending,
    Refusal, Reply, State, Value, decode_command, decode_reply,
};
use crate::link::{Error, Link, LinkEvent, MotorRefusal, Wire};
use crate::mit::commissioning::Mit;
use crate::{FaultBits, Scales};
use motord_bus::{Duration, FrameId};

/// Values of the bytes that a command leaves free, for two purposes:
/// - A motor in MIT mode reads kp 0, kd 0 and the middle torque code, where the command's own
///   values permit it.
/// - No success equals its request: where its reply has the result (byte 1, 2 or 3), the request is
///   not 0.
const FILLER: [u8; 8] = [0x00, 0x5A, 0x80, 0x10, 0x00, 0x00, 0x08, 0x00];

/// Attempts for a request that may be repeated.
const ATTEMPTS: u32 = 3;
/// Longest calibration. The document specifies no time.
pub const CALIBRATION_MAX: Duration = Duration::from_secs(60);
/// Interval between two reports of progress.
const PROGRESS: Duration = Duration::from_millis(500);
/// Delay after which a motor with a changed link answers again.
const SETTLE: Duration = Duration::from_millis(100);

/// A motor in native mode. A motor in MIT mode reads most of these frames as control frames without
/// torque. It reads the writes and the control commands as a torque: verify the mode first
/// ([`identify`](crate::commissioning::identify)).
pub struct Native<'l> {
    link: &'l mut Link,
    id: u8,
    host_id: Option<FrameId>,
    scales: Scales,
}

/// Address of a motor after its configuration was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NextMotor {
    /// Its id.
    pub id: u8,
    /// The id of its answers; `None` when it is not known.
    pub host_id: Option<FrameId>,
}

/// The way in which a write was confirmed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Confirmation {
    /// The value reads back as it was written.
    ReadBack(Value),
    /// The motor now answers in MIT.
    AnswersInMit,
    /// The motor now has another bit rate than this bus. It can be read back only after the bus was
    /// changed.
    Unreachable,
}

impl Confirmation {
    /// Returns `true` when the motor still answers in this protocol, on this bus.
    pub(crate) const fn is_read_back(self) -> bool {
        matches!(self, Self::ReadBack(_))
    }
}

impl<'l> Native<'l> {
    /// Returns motor `id` on `link`. Without `host_id` an answer may have any id.
    pub fn new(link: &'l mut Link, id: u8, host_id: Option<FrameId>) -> Self {
        // Torques are fractions of the full scale until the motor's own scale is known.
        Self { link, id, host_id, scales: Scales::WITHOUT_CONSTANTS }
    }

    /// Returns the bytes of `command`, as every transaction sends them.
    #[must_use]
    pub fn request(command: &Command) -> [u8; 8] {
        command.encode_over(FILLER)
    }

    /// Returns the motor's address.
    #[must_use]
    pub fn address(&self) -> NextMotor {
        NextMotor { id: self.id, host_id: self.host_id }
    }

    /// Returns the bus.
    pub fn link(&mut self) -> &mut Link {
        self.link
    }

    /// Reads the torque constant and the gear ratio, and uses them to decode torques from now on.
    /// Returns both.
    ///
    /// # Errors
    ///
    /// As for [`configuration`](Self::configuration); [`Error::Protocol`] when the values give no
    /// valid scale.
    pub fn read_scales(&mut self) -> Result<[f64; 2], Error> {
        let constant = self.configuration(ConfigurationItem::TORQUE_CONSTANT)?.as_f64();
        let ratio = self.configuration(ConfigurationItem::GEAR_RATIO)?.as_f64();
        let reason = "its torque constant or its gear ratio is not a positive number";
        self.scales =
            Scales::by_current(constant, ratio).map_err(|_| Error::Protocol { id: self.id, reason })?;
        Ok([constant, ratio])
    }

    /// Reads the firmware's version (3.2.14).
    ///
    /// # Errors
    ///
    /// [`Error::Silent`], [`Error::Refused`], [`Error::NotRead`], [`Error::Bus`], as for all
    /// following methods.
    pub fn version(&mut self) -> Result<u32, Error> {
        match self.transact(&Command::GetVersion)? {
            Reply::Version(outcome) => self.checked(&Command::GetVersion, outcome),
            _ => Err(self.silent(&Command::GetVersion)),
        }
    }

    /// Reads the fault number (3.2.15). A motor with a fault answers this request.
    pub fn fault(&mut self) -> Result<FaultBits, Error> {
        match self.transact(&Command::GetFault)? {
            Reply::Fault(outcome) => self.checked(&Command::GetFault, outcome),
            _ => Err(self.silent(&Command::GetFault)),
        }
    }

    /// Clears the fault (3.2.16). The motor reports it again while its cause remains.
    pub fn acknowledge_fault(&mut self) -> Result<(), Error> {
        self.done(&Command::AcknowledgeFault)
    }

    /// Enters the running state (3.2.5).
    pub fn start(&mut self) -> Result<(), Error> {
        self.done(&Command::StartMotor)
    }

    /// Leaves the running state (3.2.6).
    pub fn stop(&mut self) -> Result<(), Error> {
        self.done(&Command::StopMotor)
    }

    /// Aborts the control command that is being executed (3.2.11).
    pub fn stop_control(&mut self) -> Result<(), Error> {
        self.done(&Command::StopControl)
    }

    /// Applies all modified items (3.2.2). Without it, a modified item may be lost at power-off: no
    /// document specifies this.
    pub fn refresh(&mut self) -> Result<(), Error> {
        self.done(&Command::RefreshConfiguration)
    }

    /// Resets every item to its default (3.2.1). The motor may then have another id, host id, bit
    /// rate and protocol.
    pub fn reset_configuration(&mut self) -> Result<(), Error> {
        self.done(&Command::ResetConfiguration)
    }

    /// Holds `torque`, N·m at the output shaft (3.2.7). Never repeated.
    pub fn torque(&mut self, torque: Finite, duration: ExecutionTime) -> Result<State, Error> {
        self.control(&Command::TorqueControl { torque, duration })
    }

    /// Holds `speed_rpm`, rpm of the output shaft (3.2.8). Never repeated.
    pub fn speed(&mut self, speed_rpm: Finite, duration: ExecutionTime) -> Result<State, Error> {
        self.control(&Command::SpeedControl { speed_rpm, duration })
    }

    /// Moves to `position`, rad of the output shaft (3.2.9). Never repeated.
    pub fn position(&mut self, position: Finite, duration: ExecutionTime) -> Result<State, Error> {
        self.control(&Command::PositionControl { position, duration })
    }

    /// Reads an indicator, in the unit of Table 10 (3.2.17).
    pub fn indicator(&mut self, ind_id: u8) -> Result<f32, Error> {
        let command = Command::RetrieveIndicator { ind_id };
        match self.transact(&command)? {
            Reply::Indicator { outcome, .. } => self.checked(&command, outcome).map(Finite::get),
            _ => Err(self.silent(&command)),
        }
    }

    /// Reads a parameter of the running loops (3.2.13).
    pub fn parameter(&mut self, para_id: u8) -> Result<u32, Error> {
        let command = Command::RetrieveParameter { para_id };
        match self.transact(&command)? {
            Reply::Parameter { outcome, .. } => self.checked(&command, outcome),
            _ => Err(self.silent(&command)),
        }
    }

    /// Writes a parameter, and reads it back (3.2.12).
    ///
    /// # Errors
    ///
    /// As for the others; [`Error::ParameterNotKept`].
    pub fn set_parameter(&mut self, para_id: u8, value: u32) -> Result<(), Error> {
        let command = Command::ModifyParameter { para_id, value };
        match self.transact(&command) {
            Ok(Reply::ParameterModified { outcome, .. }) => self.checked(&command, outcome)?,
            Ok(_) | Err(Error::Silent { .. }) => {}
            Err(error) => return Err(error),
        }
        match self.parameter(para_id)? {
            read if read == value => Ok(()),
            read => Err(Error::ParameterNotKept { id: self.id, item: para_id, written: value, read }),
        }
    }

    /// Reads a configuration item (3.2.4).
    pub fn configuration(&mut self, key: ConfigurationKey) -> Result<Value, Error> {
        let command = Command::RetrieveConfiguration(key);
        match self.transact(&command)? {
            Reply::Configuration { outcome, .. } => self.checked(&command, outcome),
            _ => Err(self.silent(&command)),
        }
    }

    /// Writes a configuration item (3.2.3), and confirms it. A new id, host id, protocol or bit
    /// rate takes effect immediately, so the item is read back at the motor's new address. This
    /// handle follows the motor there.
    ///
    /// # Errors
    ///
    /// As for the others. [`Error::NotKept`] when it reads back as another value;
    /// [`Error::Unconfirmed`] when it cannot be read back.
    pub fn set_configuration(
        &mut self,
        item: &'static ConfigurationItem,
        value: Value,
    ) -> Result<Confirmation, Error> {
        let (key, command) = (item.key(), Command::ModifyConfiguration { conf_id: item.conf_id, value });
        let before = self.host_id;
        if key == ConfigurationItem::HOST_ID {
            // The answer may have the old id or the new one.
            self.host_id = None;
        }
        let reply = self.transact(&command);
        self.host_id = before;
        match reply {
            Ok(Reply::ConfigurationModified { outcome, .. }) => self.checked(&command, outcome)?,
            // The answer may have been lost, or sent with the new id or rate. Reading back gives
            // the result.
            Ok(_) | Err(Error::Silent { .. }) => {}
            Err(error) => return Err(error),
        }
        self.follow(key, value);
        self.confirm(item, value).map_err(|error| match error {
            Error::Silent { id, .. } => Error::Unconfirmed { id, item: item.name, written: value.as_f64() },
            error => error,
        })
    }

    /// Like [`set_configuration`](Self::set_configuration), and requests the motor to store the
    /// item. A motor that now answers in MIT, or is out of reach of this bus, cannot receive that
    /// request.
    ///
    /// # Errors
    ///
    /// As for the others.
    pub fn store_configuration(
        &mut self,
        item: &'static ConfigurationItem,
        value: Value,
    ) -> Result<Confirmation, Error> {
        let confirmation = self.set_configuration(item, value)?;
        if confirmation.is_read_back() {
            self.refresh()?;
        }
        Ok(confirmation)
    }

    /// Calibrates; the shaft turns (3.2.18). Waits for the answer up to [`CALIBRATION_MAX`].
    /// `progress` receives the elapsed time, and cancels the calibration by returning `false`. When
    /// the answer does not arrive or cannot be decoded, the motor is stopped.
    ///
    /// # Errors
    ///
    /// As for the others; [`Error::Interrupted`]. [`Error::Silent`] names `stop motor` when the
    /// motor did not confirm its stop: the shaft may still turn.
    pub fn calibrate(
        &mut self,
        calibration: Calibration,
        progress: &mut dyn FnMut(Duration) -> bool,
    ) -> Result<(), Error> {
        let command = Command::Calibration(calibration);
        let failure = match self.await_calibration(&command, progress) {
            Ok(Answer::Reply(Reply::Calibrated { outcome, .. })) => return self.checked(&command, outcome),
            Ok(Answer::NotRead) => self.not_read(&command),
            Ok(Answer::Reply(_)) => self.silent(&command),
            Err(error) => error,
        };
        self.stop()?;
        Err(failure)
    }

    fn await_calibration(
        &mut self,
        command: &Command,
        progress: &mut dyn FnMut(Duration) -> bool,
    ) -> Result<Answer, Error> {
        let begun = self.link.now();
        let mut answer = self.attempt(command, PROGRESS)?;
        loop {
            let elapsed = self.link.now().since(begun);
            match answer {
                Some(answer) => return Ok(answer),
                None if elapsed >= CALIBRATION_MAX => return Err(self.silent(command)),
                None if !progress(elapsed) => return Err(Error::Interrupted),
                None => answer = self.link.receive(PROGRESS, self.reader(command))?,
            }
        }
    }

    /// Requests the motor to leave the bus and wait for new firmware (3.2.19). The motor sends no
    /// answer; checks that it no longer replies.
    ///
    /// # Errors
    ///
    /// [`Error::Protocol`] when it still answers; [`Error::Bus`].
    pub fn enter_firmware_mode(&mut self) -> Result<(), Error> {
        let _silence = self.attempt(&Command::UpdateFirmware, self.link.timeout())?;
        match self.transact(&Command::GetFault) {
            Err(Error::Silent { .. }) => Ok(()),
            Err(error) => Err(error),
            Ok(_) => Err(Error::Protocol {
                id: self.id,
                reason: "it still answers: it did not enter firmware mode",
            }),
        }
    }

    /// Returns `true` when a motor answers at this address in native mode, with its own id. The
    /// read changes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`].
    pub fn is_there(&mut self) -> Result<bool, Error> {
        match self.configuration(ConfigurationItem::CAN_ID) {
            Ok(Value::Integer(id)) => Ok(id & 0xFF == i32::from(self.id)),
            Err(error @ Error::Bus(_)) => Err(error),
            Ok(_) | Err(_) => Ok(false),
        }
    }

    fn done(&mut self, command: &Command) -> Result<(), Error> {
        match self.transact(command)? {
            Reply::Done { outcome, .. } => self.checked(command, outcome),
            _ => Err(self.silent(command)),
        }
    }

    fn control(&mut self, command: &Command) -> Result<State, Error> {
        match self.transact(command)? {
            Reply::State { outcome, .. } => self.checked(command, outcome),
            _ => Err(self.silent(command)),
        }
    }

    /// Changes the address to the one after `key` was written.
    fn follow(&mut self, key: ConfigurationKey, value: Value) {
        let Value::Integer(value) = value else { return };
        match key {
            ConfigurationItem::CAN_ID => self.id = value as u8,
            ConfigurationItem::HOST_ID => self.host_id = u16::try_from(value).ok().and_then(FrameId::new),
            _ => return,
        }
        self.link.pause(SETTLE);
    }

    fn confirm(&mut self, item: &'static ConfigurationItem, written: Value) -> Result<Confirmation, Error> {
        let key = item.key();
        let is_can = self.link.wire() == Wire::Can;
        if is_can && key == ConfigurationItem::PROTOCOL && written != Value::Integer(0) {
            self.link.pause(SETTLE);
            let scales = self.scales;
            Mit::new(self.link, self.id, self.host_id, scales).stop()?;
            return Ok(Confirmation::AnswersInMit);
        }
        let read = match self.configuration(key) {
            Err(Error::Silent { .. }) if is_can && item.name == "can-baud-rate" => {
                return Ok(Confirmation::Unreachable);
            }
            read => read?,
        };
        if same(key, written, read) {
            return Ok(Confirmation::ReadBack(read));
        }
        let (written, read) = (written.as_f64(), read.as_f64());
        Err(Error::NotKept { id: self.id, item: item.name, written, read })
    }

    /// Sends `command` until an answer arrives, up to three times where repeating is harmless. Each
    /// attempt waits twice as long as the one before: a busy computer may delay an answer. A
    /// command that is sent only once waits as long as the last attempt.
    fn transact(&mut self, command: &Command) -> Result<Reply, Error> {
        let attempts = if may_repeat(command) { 0..ATTEMPTS } else { ATTEMPTS - 1..ATTEMPTS };
        let mut failure = self.silent(command);
        for attempt in attempts {
            match self.attempt(command, self.link.timeout() * (1 << attempt))? {
                Some(Answer::Reply(reply)) => return Ok(reply),
                Some(Answer::NotRead) => failure = self.not_read(command),
                None => {}
            }
        }
        Err(failure)
    }

    fn attempt(&mut self, command: &Command, timeout: Duration) -> Result<Option<Answer>, Error> {
        let reader = self.reader(command);
        self.link.ask(self.id, Self::request(command), timeout, reader)
    }

    /// Returns a function that recognises the answer to `command`.
    fn reader(&self, command: &Command) -> impl FnMut(LinkEvent) -> Option<Answer> + use<> {
        let (command, scales) = (*command, self.scales);
        let host_id = self.host_id.filter(|_| self.link.wire() == Wire::Can);
        let pending = pending(&command);
        move |event| match event {
            LinkEvent::Frame(frame) if host_id.is_none_or(|host_id| host_id == frame.id()) => {
                let reply = decode_reply(frame.payload(), pending, &scales).ok()?;
                reply.answers(&command).then_some(Answer::Reply(reply))
            }
            LinkEvent::NotRead => Some(Answer::NotRead),
            LinkEvent::Frame(_) | LinkEvent::Collision => None,
        }
    }

    fn checked<T>(&self, command: &Command, outcome: Outcome<T>) -> Result<T, Error> {
        outcome.map_err(|refusal| Error::Refused {
            id: self.id,
            request: command.code().name(),
            refusal: refusal.into(),
        })
    }

    fn silent(&self, command: &Command) -> Error {
        Error::Silent { id: self.id, request: command.code().name() }
    }

    fn not_read(&self, command: &Command) -> Error {
        Error::NotRead { id: self.id, request: command.code().name() }
    }
}

/// Returns `true` when `reply` can answer `request`, by the command and the repeated numbers. A
/// serial bus uses it to find replies among noise.
#[must_use]
pub fn answers(request: &[u8], reply: &[u8]) -> bool {
    let Ok(command) = decode_command(request) else { return false };
    let scales = Scales::WITHOUT_CONSTANTS;
    decode_reply(reply, pending(&command), &scales).is_ok_and(|reply| reply.answers(&command))
}

fn pending(command: &Command) -> Pending {
    match command {
        Command::Calibration(_) => Pending::Calibration,
        _ => Pending::Other,
    }
}

#[derive(Debug, Clone, Copy)]
enum Answer {
    Reply(Reply),
    NotRead,
}

/// Returns `true` when `command` may be sent again. Reads change nothing, and a second stop or
/// refresh has no further effect.
fn may_repeat(command: &Command) -> bool {
    match command {
        Command::RetrieveConfiguration(_)
        | Command::RetrieveParameter { .. }
        | Command::RetrieveIndicator { .. }
        | Command::GetVersion
        | Command::GetFault
        | Command::StopMotor
        | Command::StopControl
        | Command::RefreshConfiguration => true,
        Command::ResetConfiguration
        | Command::ModifyConfiguration { .. }
        | Command::ModifyParameter { .. }
        | Command::StartMotor
        | Command::TorqueControl { .. }
        | Command::SpeedControl { .. }
        | Command::PositionControl { .. }
        | Command::PtsControl
        | Command::AcknowledgeFault
        | Command::Calibration(_)
        | Command::UpdateFirmware => false,
    }
}

impl From<Refusal> for MotorRefusal {
    fn from(refusal: Refusal) -> Self {
        Self { code: refusal.code(), reason: refusal.reason() }
    }
}

/// Returns `true` when two values are equal: floats bit by bit, positions within a turn by their
/// lower 16 bits.
pub(crate) fn same(key: ConfigurationKey, a: Value, b: Value) -> bool {
    match (a, b) {
        (Value::Integer(a), Value::Integer(b)) if key.is_position() => a & 0xFFFF == b & 0xFFFF,
        (Value::Integer(a), Value::Integer(b)) => a == b,
        (Value::Float(a), Value::Float(b)) => a.get().to_bits() == b.get().to_bits(),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gim::CommandCode;
    use crate::mit::ControlCodes;

    /// The result has index 1. It has index 2 where the reply repeats a number of the request, and
    /// 3 where it repeats two (GIM document 3.2).
    #[test]
    fn no_success_equals_its_request() {
        for code in CommandCode::ALL {
            let command = decode_command(&[code as u8, 0, 0, 0, 0, 0, 0, 0]).unwrap();
            let request = command.encode_over(FILLER);
            let result = match code as u8 {
                0x83 | 0x84 => request[3],
                0xA1 | 0xA2 | 0xB4 | 0xB5 => request[2],
                // A zero torque has no free byte there. The following bytes distinguish these
                // frames.
                0x93..=0x95 => continue,
                _ => request[1],
            };
            assert_ne!(result, 0, "{code:?}");
        }
    }

    #[test]
    fn valueless_request_means_no_torque_in_mit_mode() {
        for code in CommandCode::ALL {
            let command = decode_command(&[code as u8, 1, 3, 0, 0, 0, 0, 0]).unwrap();
            let codes = ControlCodes::unpack(command.encode_over(FILLER));
            let has_values = matches!(code as u8, 0x83 | 0x93..=0x95 | 0xA1);
            assert_eq!((codes.kp, codes.kd, codes.torque) == (0, 0, 0x800), !has_values, "{code:?}");
        }
    }

    #[test]
    fn moving_or_changing_requests_are_never_repeated() {
        for code in CommandCode::ALL {
            let command = decode_command(&[code as u8, 0, 0, 0, 0, 0, 0, 0]).unwrap();
            let harmless = [0x82, 0x84, 0x92, 0x97, 0xA2, 0xB1, 0xB2, 0xB4].contains(&(code as u8));
            assert_eq!(may_repeat(&command), harmless, "{code:?}");
        }
    }
}
