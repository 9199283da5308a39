//! The orders to the threads, and the start of a thread that obeys them.

use crate::run_error::RunError;
use motord_bus::Duration;
use motord_core::cycle::{Counters, Order};
use motord_ports::instance::InstanceLock;
use motord_realtime::{SchedulingRequest, prepare_thread};
use motord_settings::settings::Settings;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, OnceLock};
use std::thread::{Builder, JoinHandle};

/// The stack of a thread. The memory of the process is locked, so every byte of it is resident. In a
/// debug build the ipc thread needs most, 250 KiB.
const STACK_BYTES: usize = 384 * 1024;
/// The stack of a thread that passes messages on. [`prepare_thread`] touches 96 KiB of it, and it
/// needs 10 KiB in a debug build.
const SMALL_STACK_BYTES: usize = 128 * 1024;
/// Period in which a thread that panicked checks whether the last cycle is over.
const END_TURN: Duration = Duration::from_millis(50);

/// The orders to the threads: run, stop with damping, stop now, or end.
#[derive(Debug, Default)]
pub(super) struct Orders {
    order: AtomicU32,
    /// The first thread that panicked.
    pub(super) panicked: OnceLock<&'static str>,
    /// The motors that may still run after the last cycle, if there are any.
    pub(super) unstopped: OnceLock<Vec<String>>,
}

impl Orders {
    pub(super) const STOP: u32 = 1;
    pub(super) const STOP_NOW: u32 = 2;
    pub(super) const END: u32 = 3;

    pub(super) fn give(&self, order: u32) {
        self.order.fetch_max(order, Ordering::Relaxed);
    }

    /// Returns true when `order` or a stronger one was given. Each thread that orders can end
    /// checks this in every turn of its loop.
    pub(super) fn are(&self, order: u32) -> bool {
        #[cfg(feature = "panic-on-request")]
        crate::host::panics::panic_if_asked();
        self.order.load(Ordering::Relaxed) >= order
    }

    /// The order for the cycle, for which the end of the daemon is the same as to stop now.
    pub(super) fn cycle_order(&self) -> Order {
        match (self.are(Self::STOP_NOW), self.are(Self::STOP)) {
            (true, _) => Order::StopNow,
            (false, true) => Order::Stop,
            (false, false) => Order::Run,
        }
    }

    /// Stops the robot because `thread` panicked.
    pub(super) fn stop_without(&self, thread: &'static str) {
        let _not_the_first = self.panicked.set(thread);
        self.give(Self::STOP);
    }

    /// Runs `body` of `thread`. When it panics, the order to stop the robot is given at once, and
    /// this returns after the last cycle: what `body` uses lives on until then.
    pub(super) fn outlive_the_cycle(&self, thread: &'static str, body: impl FnOnce()) {
        if catch_unwind(AssertUnwindSafe(body)).is_err() {
            self.stop_without(thread);
            while !self.are(Self::END) {
                std::thread::sleep(END_TURN);
            }
        }
    }
}

/// The context of every start.
pub(super) struct Starter {
    pub(super) settings: Settings,
    pub(super) lock: Arc<InstanceLock>,
    pub(super) orders: Arc<Orders>,
    pub(super) counters: Arc<Counters>,
    pub(super) boot_id: u64,
}

/// Gives the order to stop when its thread panics.
struct StopsOnPanic {
    orders: Arc<Orders>,
    thread: &'static str,
}

impl Drop for StopsOnPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.orders.stop_without(self.thread);
        }
    }
}

impl Starter {
    /// Starts `motord-{thread}`, whose panic stops the robot.
    pub(super) fn start(
        &self,
        thread: &'static str,
        body: impl FnOnce(&Orders) + Send + 'static,
    ) -> Result<JoinHandle<()>, RunError> {
        self.spawn(thread, STACK_BYTES, body)
    }

    /// Starts a thread that ends with the process, and only passes messages on.
    pub(super) fn detach(
        &self,
        thread: &'static str,
        body: impl FnOnce(&Orders) + Send + 'static,
    ) -> Result<(), RunError> {
        self.spawn(thread, SMALL_STACK_BYTES, body).map(drop)
    }

    fn spawn(
        &self,
        thread: &'static str,
        stack_bytes: usize,
        body: impl FnOnce(&Orders) + Send + 'static,
    ) -> Result<JoinHandle<()>, RunError> {
        let stops = StopsOnPanic { orders: Arc::clone(&self.orders), thread };
        let run = move || {
            let stops = stops;
            body(&stops.orders);
        };
        Ok(Builder::new().name(format!("motord-{thread}")).stack_size(stack_bytes).spawn(run)?)
    }

    /// As [`detach`](Self::detach), a thread that sleeps most of the time, and must not wait when it
    /// is needed: its priority is below the cycle.
    pub(super) fn detach_below_the_cycle(
        &self,
        thread: &'static str,
        body: impl FnOnce(&Orders) + Send + 'static,
    ) -> Result<(), RunError> {
        let priority = self.settings.cycle.priority.saturating_sub(1).max(1);
        let body = move |orders: &Orders| {
            let request = SchedulingRequest { cpu: None, priority: Some(priority) };
            let _refused_like_the_cycle = prepare_thread(request);
            body(orders);
        };
        self.detach(thread, body)
    }
}

/// Waits for the report of a thread that was started.
pub(super) fn await_report<T>(receiver: &Receiver<T>, thread: &'static str) -> Result<T, RunError> {
    receiver.recv().map_err(|_| RunError::Thread(thread))
}
