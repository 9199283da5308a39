//! The simulated motors of a serial bus behind a pseudo terminal, served by a separate thread.

use motord::buses;
use motord_bus::{Duration, clock};
use motord_realtime::SchedulingRequest;
use motord_settings::settings::Settings;
use motord_simulator::{Motor, SerialPort, SerialSlave, SimulatedBus};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, sleep, spawn};

/// Interval of moving the bytes of the line: within the default turnaround of a line.
const TURN: Duration = Duration::from_micros(100);

/// Sets real-time scheduling, where it is permitted.
pub(crate) fn prepare_thread(priority: u8) {
    let _not_permitted =
        motord_realtime::prepare_thread(SchedulingRequest { cpu: None, priority: Some(priority) });
}

/// The motors of one line.
pub(crate) struct Motors {
    port: Arc<Mutex<SerialPort>>,
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Motors {
    /// Starts the motors of the bus with this index. `link` leads to their terminal.
    pub(crate) fn start(settings: &Settings, bus: usize, link: PathBuf) -> Self {
        let (wire, motors) = buses::physics(settings, bus);
        let slave = SerialSlave::new(SimulatedBus::new(wire, motors, 7), 7);
        let port =
            Arc::new(Mutex::new(SerialPort::open(slave, Some(link)).expect("there are pseudo terminals")));
        let end = Arc::new(AtomicBool::new(false));
        let (served, ended) = (Arc::clone(&port), Arc::clone(&end));
        let thread = spawn(move || {
            // Above the cycle: motors do not wait for a processor.
            prepare_thread(60);
            while !ended.load(Ordering::Relaxed) {
                served.lock().expect("nobody panicked").serve(clock::monotonic());
                sleep(TURN);
            }
        });
        Self { port, end, thread: Some(thread) }
    }

    /// Injects a fault into the line or one of its motors.
    pub(crate) fn inject(&self, verb: &str) {
        let verb = verb.parse().unwrap_or_else(|error| panic!("{verb}: {error}"));
        let mut port = self.port.lock().expect("nobody panicked");
        port.inject(clock::monotonic(), &verb).expect("the line has it");
    }

    /// Returns the result of `of` for every motor.
    pub(crate) fn each<T>(&self, of: impl Fn(&Motor) -> T) -> Vec<T> {
        self.port.lock().expect("nobody panicked").bus().motors().iter().map(of).collect()
    }
}

impl Drop for Motors {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        let _panicked = self.thread.take().map(JoinHandle::join);
    }
}
