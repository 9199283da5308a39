//! Simulated motors at their end of a bus, for a daemon in another process.

use crate::{FaultVerb, InjectError, SimulatedBus};
use motord_bus::transport::{MotorsBus, MotorsEnd, OpenError};
use motord_bus::{Bus, Content, IdFilter, Inbox, Instant, Readiness};

/// Passes the commands that arrive at the motors' end of a bus to a simulated bus, and sends the
/// motors' answers there.
///
/// The simulated bus keeps its bit rate, so that motors on a virtual interface answer at the times
/// of real ones. The bridge also sends its error reports: on a virtual interface they look like
/// those of the controller. Frames that the simulated bus loses are lost for the daemon. Inject a
/// full queue or an unplugged interface on the daemon's side.
pub struct Bridge {
    end: Box<dyn MotorsBus>,
    simulated: SimulatedBus,
    /// The ids that the end receives.
    listening: Vec<IdFilter>,
    inbox: Inbox,
}

impl Bridge {
    /// Opens `end` for the motors of `simulated`. A motor whose id changes receives frames
    /// with the new one.
    ///
    /// # Errors
    ///
    /// The error of the end, with a remedy.
    pub fn open(simulated: SimulatedBus, end: &dyn MotorsEnd) -> Result<Self, OpenError> {
        let listening = addresses(&simulated);
        Ok(Self { end: end.open(&listening)?, simulated, listening, inbox: Inbox::new() })
    }

    /// Returns the motors.
    pub fn bus(&mut self) -> &mut SimulatedBus {
        &mut self.simulated
    }

    /// Transfers the frames that have arrived by `now`, in both directions.
    pub fn serve(&mut self, now: Instant) {
        self.inbox.clear();
        self.end.receive(now, &mut self.inbox);
        for arrival in self.inbox.arrivals() {
            if let Content::Frame(command) = arrival.content {
                self.simulated.send(arrival.at, &[command]);
            }
        }
        self.inbox.clear();
        self.simulated.receive(now, &mut self.inbox);
        for arrival in self.inbox.arrivals() {
            match arrival.content {
                Content::Frame(answer) => self.end.send(now, &[answer]),
                Content::Error(report) => self.end.report(&report),
                Content::Unsupported(_) | Content::Refused(_) => continue,
            };
        }
        self.follow();
    }

    /// Receives the ids that the motors have now. When the kernel refuses, the next call tries
    /// again.
    fn follow(&mut self) {
        let addresses = addresses(&self.simulated);
        if addresses != self.listening && self.end.listen(&addresses).is_ok() {
            self.listening = addresses;
        }
    }

    /// Returns the descriptor that becomes readable when a command arrives.
    #[must_use]
    pub fn readiness(&self) -> Readiness<'_> {
        self.end.readiness()
    }

    /// Returns the earliest time of an answer, if no command arrives before.
    #[must_use]
    pub fn due(&self) -> Instant {
        match self.simulated.readiness() {
            Readiness::At(instant) => instant,
            Readiness::Readable(_) | Readiness::Never => Instant::FAR_FUTURE,
        }
    }

    /// Applies `verb` to the bus or to one of its motors.
    ///
    /// # Errors
    ///
    /// As for [`SimulatedBus::inject`].
    pub fn inject(&mut self, now: Instant, verb: &FaultVerb) -> Result<(), InjectError> {
        self.simulated.inject(now, verb)
    }
}

/// Returns each filter once: the kernel may deliver a frame once per filter.
fn addresses(bus: &SimulatedBus) -> Vec<IdFilter> {
    let motors = bus.motors().iter().flat_map(crate::Motor::addresses);
    let mut addresses = Vec::new();
    for address in motors.chain(bus.imu_addresses().map(IdFilter::exact)) {
        if !addresses.contains(&address) {
            addresses.push(address);
        }
    }
    addresses
}
