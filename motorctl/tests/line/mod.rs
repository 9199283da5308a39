//! Native motors on an RS485 line, which is a pseudo terminal here.

#![allow(dead_code, reason = "each test program uses a part of it")]

use motord_bus::{Duration, clock, wait};
use motord_simulator::{BusKind, BusSettings, Dialect, MotorSettings, SerialPort, SerialSlave, SimulatedBus};
use std::path::PathBuf;
use std::sync::mpsc::{Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use tempfile::TempDir;

/// A line with motors, served until it is dropped.
pub(crate) struct Line {
    directory: TempDir,
    verbs: Option<Sender<String>>,
    served: Option<JoinHandle<()>>,
}

/// A native motor that calibrates quickly.
pub(crate) fn motor(name: &str, id: u16) -> MotorSettings {
    let calibration_time = Duration::from_millis(1200);
    MotorSettings {
        name: name.into(),
        id,
        host_id: 0x40 + id,
        dialect: Dialect::Gim,
        calibration_time,
        ..Default::default()
    }
}

impl Line {
    pub(crate) fn new(motors: Vec<MotorSettings>) -> Self {
        let directory = TempDir::new().unwrap();
        let settings = BusSettings {
            name: "line".into(),
            kind: BusKind::Serial,
            bitrate: 921_600,
            ..Default::default()
        };
        let slave = SerialSlave::new(SimulatedBus::new(settings, motors, 7), 7);
        let mut port = SerialPort::open(slave, Some(directory.path().join("tty"))).unwrap();
        let (verbs, received) = channel::<String>();
        let served = std::thread::spawn(move || {
            loop {
                port.serve(clock::monotonic());
                match received.try_recv() {
                    Ok(verb) => port.inject(clock::monotonic(), &verb.parse().unwrap()).unwrap(),
                    Err(TryRecvError::Disconnected) => return,
                    Err(TryRecvError::Empty) => {}
                }
                let now = clock::monotonic();
                let _ready = wait(&[port.readiness()], now, port.due().min(now + Duration::from_millis(2)));
            }
        });
        Self { directory, verbs: Some(verbs), served: Some(served) }
    }

    /// One motor with id 3.
    pub(crate) fn knee() -> Self {
        Self::new(vec![motor("knee", 3)])
    }

    /// Applies a fault verb, and lets it take effect.
    pub(crate) fn inject(&self, verb: &str) {
        self.verbs.as_ref().unwrap().send(verb.to_owned()).unwrap();
        std::thread::sleep(Duration::from_millis(20));
    }

    /// A file in the directory of the line.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    /// The device to open.
    pub(crate) fn device(&self) -> String {
        self.path("tty").display().to_string()
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        drop(self.verbs.take());
        let _ended = self.served.take().map(JoinHandle::join);
    }
}
