//! The daemon's threads: starts them, and ends them so that the motors are stopped first.
//!
//! | thread | what it does |
//! |---|---|
//! | `motord-cycle` | the cycle; real-time where the machine allows it |
//! | `motord-ipc` | clients |
//! | `motord-telemetry` | histograms, log, housekeeping |
//! | `motord-owners` | detects the deaths of the groups' owners |
//! | `motord-registrar` | registers the daemon's safe frames with its dead man's switch |
//! | `motord-stop` | receives emergency stops on their socket |
//! | `motord-plant` | asks the plant for its steps; only with `--plant` |
//! | `motord-imus` | simulated IMUs; only where there is one |
//! | `motord-imu-line` | an IMU on a serial line; one for each |
//! | `motord-reconnector` | reopens buses that disconnected |
//! | `motord-simulation` | receives faults for simulated buses; only where no bus is real |
//!
//! A panic in any of them stops the robot and ends the daemon, because the work of that thread is
//! missing. The main thread waits for signals and feeds the watchdog of systemd; a panic there ends
//! the process, and the dead man's switch acts.
//!
//! The main thread joins the first three; the others end with the process.

mod cycle;
mod ipc;
mod stages;
mod starter;

use crate::plant::PlantError;
use crate::run_error::RunError;
use motord_bus::Duration;
use motord_core::cycle::Counters;
use motord_realtime::Step;
use starter::Orders;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

/// The running threads.
pub struct Daemon {
    orders: Arc<Orders>,
    counters: Arc<Counters>,
    cycle: cycle::Handle,
    ipc: ipc::Handle,
    telemetry: JoinHandle<()>,
    /// The first file of the runtime directory that was lost.
    lost: Arc<OnceLock<PathBuf>>,
    /// Why the plant ended, if there was one.
    unplanted: Arc<OnceLock<PlantError>>,
}

impl Daemon {
    /// Waits at most `timeout` for the first state, and returns true once it is published.
    #[must_use]
    pub fn await_first_state(&self, timeout: Duration) -> bool {
        self.ipc.first_state.recv_timeout(timeout).is_ok()
    }

    /// The steps by which the cycle thread became real-time, and their outcomes.
    #[must_use]
    pub fn realtime(&self) -> &[Step] {
        &self.cycle.realtime
    }

    /// Number of the newest cycle.
    #[must_use]
    pub fn cycle(&self) -> u64 {
        self.counters.cycle.load(Ordering::Acquire)
    }

    /// Returns true when the last cycle is over, by request or because a thread panicked. Orders
    /// the stop itself when no new client can reach the daemon, or when the plant has ended.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        if self.lost.get().is_some() || self.unplanted.get().is_some() {
            self.stop();
        }
        self.orders.are(Orders::STOP) && self.cycle.thread.is_finished()
    }

    /// Damps and stops the motors; the cycle ends when they are stopped.
    pub fn stop(&self) {
        self.orders.give(Orders::STOP);
    }

    /// Stops the motors without damping them first.
    pub fn stop_now(&self) {
        self.orders.give(Orders::STOP_NOW);
    }

    /// It was ordered to stop.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.orders.are(Orders::STOP)
    }

    /// Stops, and waits for the threads.
    ///
    /// # Errors
    ///
    /// When a thread has panicked, or a motor that was started did not answer its stops.
    pub fn end(self) -> Result<(), RunError> {
        self.stop();
        let _seen_in_orders = self.cycle.thread.join();
        self.orders.give(Orders::END);
        self.ipc.thread.thread().unpark();
        for thread in [self.ipc.thread, self.telemetry] {
            let _seen_in_orders = thread.join();
        }
        if let Some(thread) = self.orders.panicked.get() {
            return Err(RunError::Thread(thread));
        }
        if let Some(motors) = self.orders.unstopped.get() {
            return Err(RunError::Unstopped(motors.clone()));
        }
        if let Some(path) = self.lost.get() {
            return Err(RunError::DirectoryLost(path.clone()));
        }
        if let Some(error) = self.unplanted.get() {
            return Err(RunError::PlantEnded(error.to_string()));
        }
        tracing::info!("the motors are stopped");
        Ok(())
    }
}
