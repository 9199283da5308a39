//! A serial line on virtual time: a [`SerialBus`] whose bytes go to simulated motors.

use motord::buses;
use motord_bus::serial::{ByteStream, SerialBus};
use motord_bus::{Bus, Frame, FrameId, Inbox, Instant, Readiness, Sent};
use motord_settings::settings::Settings;
use motord_simulator::{
    Direction, Fault, FaultVerb, InjectError, Recorded, SerialSlave, SharedBus, SimulatedBus,
};
use nix::errno::Errno;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Receiver, type, length, their XOR (GIM document, table 3).
const HEADER: usize = 4;
const FRAME: usize = HEADER + 8;

/// A bus of the robot, on the side of the motors.
#[derive(Clone)]
pub enum Wire {
    /// A simulated CAN bus.
    Bus(SharedBus),
    /// A serial line.
    Line(SharedLine),
}

impl Wire {
    /// Calls `of` with the simulated bus.
    pub fn with<T>(&self, of: impl FnOnce(&mut SimulatedBus) -> T) -> T {
        match self {
            Self::Bus(bus) => of(&mut bus.lock()),
            Self::Line(line) => of(line.lock().slave.bus()),
        }
    }

    /// Returns the CAN bus.
    ///
    /// # Panics
    ///
    /// If it is a serial line.
    pub fn bus(&self) -> &SharedBus {
        match self {
            Self::Bus(bus) => bus,
            Self::Line(_) => panic!("a line is no simulated bus"),
        }
    }

    /// Takes the frames that were on the wire since the last call.
    pub fn take_record(&self) -> Vec<Recorded> {
        match self {
            Self::Bus(bus) => bus.lock().take_record().collect(),
            Self::Line(line) => std::mem::take(&mut line.lock().record),
        }
    }

    /// Injects a fault.
    ///
    /// # Errors
    ///
    /// Those of the simulator.
    pub fn inject(&self, now: Instant, verb: &FaultVerb) -> Result<(), InjectError> {
        match self {
            Self::Bus(bus) => bus.lock().inject(now, verb),
            Self::Line(line) => line.lock().inject(now, verb),
        }
    }

    /// Opens the cycle's side; `None` for a line that is unplugged.
    pub fn open(&self, settings: &Settings, index: usize) -> Option<Box<dyn Bus>> {
        match self {
            Self::Bus(bus) => Some(Box::new(bus.clone())),
            Self::Line(line) => line.open(settings, index).map(|line| Box::new(line) as Box<dyn Bus>),
        }
    }
}

/// The motors of a line behind their port. Clones share the port.
#[derive(Clone)]
pub struct SharedLine(Arc<Mutex<Port>>);

/// The port, on virtual time.
pub struct Port {
    slave: SerialSlave,
    now: Instant,
    /// Bytes that the host has not read.
    arrived: Vec<u8>,
    /// Bytes of the host that the port has not accepted.
    unsent: Vec<u8>,
    blocked: bool,
    unplugged: bool,
    record: Vec<Recorded>,
    /// The last bytes that the host read, which may begin a frame.
    tail: Vec<u8>,
    /// The ids that the motors' replies name, by motor id.
    host_ids: [u8; 256],
    /// The motor of the last request: a reply does not name its sender.
    asked: u8,
}

impl SharedLine {
    /// The line with index `bus` in `settings`.
    pub fn new(slave: SerialSlave, settings: &Settings, bus: usize) -> Self {
        let mut host_ids = [0; 256];
        for motor in settings.motors.iter().filter(|motor| motor.bus == bus) {
            host_ids[usize::from(motor.id)] = motor.host_id.raw() as u8;
        }
        Self(Arc::new(Mutex::new(Port {
            slave,
            now: Instant::ZERO,
            arrived: Vec::new(),
            unsent: Vec::new(),
            blocked: false,
            unplugged: false,
            record: Vec::new(),
            tail: Vec::new(),
            host_ids,
            asked: 0,
        })))
    }

    fn lock(&self) -> MutexGuard<'_, Port> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Delivers a frame to the host that no motor sent.
    pub fn deliver_frame(&self, to: u8, payload: &[u8]) {
        let len = payload.len() as u8;
        self.lock().arrived.extend([&[to, 0, len, to ^ len], payload].concat());
    }

    /// Opens the port again and discards the pending bytes of both directions.
    fn open(&self, settings: &Settings, index: usize) -> Option<Line> {
        let mut port = self.lock();
        if port.unplugged {
            return None;
        }
        port.unsent.clear();
        port.arrived.clear();
        let line = settings.buses[index].kind.line(&buses::nodes(settings, index))?;
        let bus = SerialBus::over(self.clone(), &line);
        Some(Line { bus, port: self.clone() })
    }
}

impl Port {
    /// Moves the pending bytes in both directions.
    fn serve(&mut self, sent: &[u8]) {
        let Self { slave, arrived, now, .. } = self;
        slave.transact(*now, sent, arrived);
        if self.unplugged {
            arrived.clear();
        }
    }

    fn inject(&mut self, now: Instant, verb: &FaultVerb) -> Result<(), InjectError> {
        self.now = now;
        if verb.target != self.slave.name() {
            return self.slave.inject(now, verb);
        }
        match verb.fault {
            Fault::Gone => self.unplugged = true,
            Fault::Blocked => self.blocked = true,
            Fault::Ok => {
                (self.unplugged, self.blocked) = (false, false);
                self.slave.inject(now, verb)?;
                let unsent = std::mem::take(&mut self.unsent);
                self.serve(&unsent);
            }
            _ => self.slave.inject(now, verb)?,
        }
        Ok(())
    }

    fn note(&mut self, direction: Direction, motor: u8, payload: &[u8]) {
        let frame = Frame::new(FrameId::from(motor), payload).expect("a frame has eight bytes");
        self.record.push(Recorded { ready: self.now, at: self.now, direction, frame });
    }

    /// Records each frame that the host has read and that has the host id of the motor of the last
    /// request, as a frame of this motor.
    fn note_read(&mut self, bytes: &[u8]) {
        self.tail.extend_from_slice(bytes);
        let read = std::mem::take(&mut self.tail);
        for frame in read.windows(FRAME) {
            if let [to, 0, 8, check, payload @ ..] = frame
                && *check == to ^ 8
                && *to == self.host_ids[usize::from(self.asked)]
            {
                self.note(Direction::ToHost, self.asked, payload);
            }
        }
        self.tail = read[read.len().saturating_sub(FRAME - 1)..].to_vec();
    }
}

impl ByteStream for SharedLine {
    fn write(&self, bytes: &[u8]) -> Result<usize, Errno> {
        let mut port = self.lock();
        if port.unplugged {
            return Err(Errno::EIO);
        }
        port.asked = bytes[0];
        port.note(Direction::ToMotor, bytes[0], &bytes[HEADER..]);
        if port.blocked {
            port.unsent.extend_from_slice(bytes);
        } else {
            port.serve(bytes);
        }
        Ok(bytes.len())
    }

    fn read(&self, buffer: &mut [u8]) -> Result<usize, Errno> {
        let mut port = self.lock();
        port.serve(&[]);
        let count = port.arrived.len().min(buffer.len());
        if count == 0 {
            return if port.unplugged { Ok(0) } else { Err(Errno::EAGAIN) };
        }
        let read: Vec<u8> = port.arrived.drain(..count).collect();
        buffer[..count].copy_from_slice(&read);
        port.note_read(&read);
        Ok(count)
    }

    fn unsent(&self) -> Result<usize, Errno> {
        Ok(self.lock().unsent.len())
    }

    fn readiness(&self) -> Readiness<'_> {
        Readiness::Never
    }
}

/// The cycle's side of a line.
struct Line {
    bus: SerialBus<SharedLine>,
    port: SharedLine,
}

impl Bus for Line {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        self.port.lock().now = now;
        self.bus.send(now, frames)
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        self.port.lock().now = now;
        self.bus.receive(now, inbox);
    }

    fn readiness(&self) -> Readiness<'_> {
        self.bus.readiness()
    }
}
