//! Creates a cycle from settings, and runs the real-time loop.
//!
//! ```text
//!   Run ──────▶ Stop ──every group disarmed──▶ last cycles ──every motor stopped, or STOP_TIME──▶ end
//!                └── StopNow, or SHUTDOWN_MARGIN too late: stopped without further damping
//! ```

use super::{Cycle, Ends, Tick, link};
use motord_bus::{Bus, Clock, Duration};
use motord_settings::plan::BusPlan;
use motord_settings::settings::Settings;

/// Cycles with stop frames before the loop leaves a stopped robot.
const LAST_CYCLES: u32 = 3;
/// A robot that is not disarmed this long after its damping should have ended is stopped without
/// further damping.
const SHUTDOWN_MARGIN: Duration = Duration::from_secs(1);
/// Time for a motor to answer its stop: a few probes of one that does not answer.
const STOP_TIME: Duration = Duration::from_millis(500);

/// An order to the loop. A later order never revokes an earlier one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Order {
    /// Continue.
    Run,
    /// Damp and stop the motors, then end.
    Stop,
    /// Stop the motors without damping them first, then end.
    StopNow,
}

impl Cycle {
    /// Runs cycles until `order` is to stop, then those that stop the robot. Returns when every
    /// group has been disarmed for `LAST_CYCLES`, and every motor that was started has answered its
    /// stop or had `STOP_TIME` for it.
    ///
    /// Real-time: allocates nothing; blocks only in the clock; `order` is asked once per cycle and
    /// must not block.
    pub fn run_until(&mut self, order: impl Fn() -> Order) {
        let mut tick = Tick { number: 1, at: self.clock.now() + self.timing.period };
        while order() == Order::Run {
            tick = self.run(tick);
        }
        tick = self.disarm(tick, order);
        let end = tick.at + STOP_TIME;
        while self.unstopped().next().is_some() && tick.at < end {
            tick = self.run(tick);
        }
    }

    /// Damps and stops every group, within the time of a safe stop and [`SHUTDOWN_MARGIN`].
    fn disarm(&mut self, mut tick: Tick, order: impl Fn() -> Order) -> Tick {
        self.shut_down();
        let end = tick.at + self.timing.damp + SHUTDOWN_MARGIN;
        let mut last = LAST_CYCLES;
        while last > 0 {
            tick = self.run(tick);
            if order() == Order::StopNow || tick.at > end {
                self.stop_now();
            }
            last -= u32::from(self.is_disarmed());
        }
        tick
    }
}

/// Creates the cycle of `settings` on `buses`, and its other ends. Allocates; nothing in the cycle
/// does after it.
///
/// `buses` stand in the order of the configuration, and are open. `clock` is the machine's or one
/// of virtual time. `boot_id` must differ from that of every earlier run whose leases a client may
/// still hold. Any number is correct where all clients are in this program.
///
/// # Panics
///
/// When there are not as many buses as in the settings, or a motor is not in exactly one group.
#[must_use]
pub fn assemble(
    settings: &Settings,
    buses: Vec<Box<dyn Bus>>,
    clock: impl Clock + Send + 'static,
    boot_id: u64,
) -> (Cycle, Ends) {
    assert_eq!(buses.len(), settings.buses.len(), "every bus of the settings is there");
    let (link, ends) = link(settings.groups.len(), settings.sensors.imus.len());
    (Cycle::new(settings, &BusPlan::of(settings), buses, Box::new(clock), link, boot_id), ends)
}
