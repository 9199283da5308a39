//! A stop circuit at a GPIO line, normally closed: an opened switch, a broken wire, a lost chip and a
//! silent one stop the robot, as long as they last.
//!
//! ```text
//!  chip ◀─ poll ─ gpio-read ──newest reading──▶ gpio ──requests──▶ stop
//! ```
//!
//! A driver may block: `gpio-read` waits for it, and `gpio` for `gpio-read`, for a bounded time.

mod line;

use crate::config::Gpio;
use crate::hold::{Demand, Hold, View};
use crate::shared::Shared;
use crate::slot::Slot;
use crate::stop::StopDesk;
use crate::threads::spawn;
use line::Line;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Interval of readings.
const PERIOD: Duration = Duration::from_millis(5);
/// Time without a reading after which the line counts as lost.
const SILENCE: Duration = Duration::from_millis(200);
/// Between two attempts to get the line.
const RETRY: Duration = Duration::from_millis(100);

/// A reading of the line.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Reading {
    Closed,
    Open,
    /// With the reason, a sentence.
    Lost(String),
    /// No reading arrives.
    Silent,
}

/// Starts the threads; `None` where no line is configured.
pub(crate) fn start(
    config: &Gpio,
    shared: &Arc<Shared>,
    desk: &Arc<StopDesk>,
) -> Result<Option<JoinHandle<()>>, String> {
    if !config.enabled {
        return Ok(None);
    }
    let readings = Arc::new(Slot::default());
    let (gpio, slot, of_reader) = (config.clone(), Arc::clone(&readings), Arc::clone(shared));
    // Nothing waits for its end: its driver may never return.
    let _detached = spawn("gpio-read", move || read(&gpio, &slot, &of_reader))?;
    let (shared, desk) = (Arc::clone(shared), Arc::clone(desk));
    let watcher = Watcher::new(config, desk);
    spawn("gpio", move || watcher.run(&readings, &shared)).map(Some)
}

/// Reads the line until the bridge ends.
fn read(gpio: &Gpio, readings: &Slot<Reading>, shared: &Shared) {
    while !shared.ends() {
        let reason = match Line::request(gpio) {
            Ok(line) => read_line(&line, readings, shared),
            Err(reason) => reason,
        };
        readings.put(Reading::Lost(reason));
        std::thread::sleep(RETRY);
    }
}

/// Reads `line` until it is lost. Returns the reason.
fn read_line(line: &Line, readings: &Slot<Reading>, shared: &Shared) -> String {
    while !shared.ends() {
        match line.is_closed() {
            Ok(true) => readings.put(Reading::Closed),
            Ok(false) => readings.put(Reading::Open),
            Err(error) => return format!("the chip does not answer ({error})"),
        }
        std::thread::sleep(PERIOD);
    }
    "the bridge ends".to_owned()
}

/// The level that counts: a new one counts once it has lasted.
#[derive(Debug)]
struct Debounce {
    time: Duration,
    /// `None` until the first level has lasted.
    is_closed: Option<bool>,
    other_since: Option<Instant>,
}

impl Debounce {
    fn new(time: Duration) -> Self {
        Self { time, is_closed: None, other_since: None }
    }

    /// Takes a reading of `now`, and returns the level that counts.
    fn take(&mut self, is_closed: bool, now: Instant) -> Option<bool> {
        if self.is_closed == Some(is_closed) {
            self.other_since = None;
        } else if now.saturating_duration_since(*self.other_since.get_or_insert(now)) >= self.time {
            return self.set(is_closed);
        }
        self.is_closed
    }

    /// Makes a level count at once.
    fn set(&mut self, is_closed: bool) -> Option<bool> {
        (self.is_closed, self.other_since) = (Some(is_closed), None);
        self.is_closed
    }
}

/// Requests the stops of the line.
struct Watcher {
    name: String,
    desk: Arc<StopDesk>,
    debounce: Debounce,
    /// The last reading that was not the closed circuit.
    opened: Reading,
    was_closed: Option<bool>,
    hold: Hold,
    begun: Instant,
}

impl Watcher {
    fn new(config: &Gpio, desk: Arc<StopDesk>) -> Self {
        let name = format!("the GPIO line {} of {}", config.line.unwrap_or_default(), config.chip.display());
        let debounce = Debounce::new(config.debounce());
        let (hold, begun) = (Hold::default(), Instant::now());
        Self { name, desk, debounce, opened: Reading::Open, was_closed: None, hold, begun }
    }

    fn run(mut self, readings: &Slot<Reading>, shared: &Shared) {
        while !shared.ends() {
            let reading = readings.wait(SILENCE).unwrap_or(Reading::Silent);
            let now = Instant::now();
            let view = View::of(shared.latest.newest().as_ref(), self.begun, now);
            self.serve(reading, view, now);
        }
    }

    fn serve(&mut self, reading: Reading, view: View, now: Instant) {
        let is_closed = match reading {
            // It has lasted.
            Reading::Silent => self.debounce.set(false),
            _ => self.debounce.take(reading == Reading::Closed, now),
        };
        if reading != Reading::Closed {
            self.opened = reading;
        }
        if is_closed != self.was_closed {
            self.log(is_closed);
            self.was_closed = is_closed;
        }
        let demand = if is_closed == Some(false) { Demand::Latch } else { Demand::Nothing };
        let (name, opened, desk) = (&self.name, &self.opened, &self.desk);
        self.hold.serve(demand, view, now, || {
            desk.request(match opened {
                Reading::Lost(reason) => format!("{name}, which is lost: {reason}"),
                Reading::Silent => format!("{name}, which does not answer"),
                Reading::Open | Reading::Closed => format!("{name}, which is open"),
            })
        });
    }

    fn log(&self, is_closed: Option<bool>) {
        let name = &self.name;
        match (is_closed, &self.opened) {
            (Some(true), _) => log::info!("{name} is closed: it demands no stop"),
            (Some(false), Reading::Silent) => {
                log::error!("{name} does not answer for {} ms, which stops the robot", SILENCE.as_millis());
            }
            (Some(false), Reading::Lost(reason)) => {
                log::error!("{name} is lost, which stops the robot: {reason}");
            }
            (Some(false), _) => log::warn!("{name} is open, which stops the robot"),
            (None, _) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn watcher(debounce_ms: f64) -> Watcher {
        let gpio = Gpio { enabled: true, line: Some(17), debounce_ms, ..Gpio::default() };
        Watcher::new(&gpio, Arc::default())
    }

    fn latched(is_latched: bool, published: Instant) -> View {
        View::Known { is_running: false, is_latched, published }
    }

    #[test]
    fn level_counts_once_it_has_lasted() {
        let (begun, mut debounce) = (Instant::now(), Debounce::new(10 * MS));
        let mut take = |ms, is_closed| debounce.take(is_closed, begun + ms * MS);
        assert_eq!([take(0, true), take(9, true), take(10, true)], [None, None, Some(true)]);
        assert_eq!([take(20, false), take(25, true), take(31, false)], [Some(true); 3], "it bounces");
        assert_eq!([take(41, false), take(42, true), take(52, true)], [Some(false), Some(false), Some(true)]);
    }

    #[test]
    fn open_and_lost_lines_stop() {
        let now = Instant::now();
        for (reading, part) in [
            (Reading::Open, "the GPIO line 17 of /dev/gpiochip0, which is open"),
            (Reading::Lost("unplugged".to_owned()), "which is lost: unplugged"),
        ] {
            let mut watcher = watcher(0.0);
            watcher.serve(Reading::Closed, latched(false, now), now);
            assert_eq!(watcher.desk.waiting(), [""; 0]);
            watcher.serve(reading, latched(false, now), now);
            let waiting = watcher.desk.waiting();
            assert!(waiting.len() == 1 && waiting[0].contains(part), "{waiting:?}");
        }
    }

    #[test]
    fn closed_line_of_running_robot_stops_nothing() {
        let mut watcher = watcher(10.0);
        let begun = Instant::now();
        for ms in 0..1000 {
            let now = begun + ms * MS;
            watcher.serve(Reading::Closed, latched(false, now), now);
        }
        assert_eq!(watcher.desk.waiting(), [""; 0]);
    }

    #[test]
    fn silent_reader_stops_the_robot() {
        let shared = crate::fixtures::shared();
        let watcher = watcher(100.0);
        let desk = Arc::clone(&watcher.desk);
        let readings = Slot::default();
        std::thread::scope(|scope| {
            scope.spawn(|| watcher.run(&readings, &shared));
            while desk.waiting().is_empty() {
                std::thread::yield_now();
            }
            shared.ends.store(true, std::sync::atomic::Ordering::Relaxed);
        });
        assert!(desk.waiting()[0].contains("does not answer"), "{:?}", desk.waiting());
    }

    #[test]
    fn disabled_line_starts_no_thread() {
        let shared = crate::fixtures::shared();
        assert!(start(&Gpio::default(), &shared, &Arc::default()).unwrap().is_none());
    }
}
