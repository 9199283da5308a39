//! The buses that must be opened again or emptied, as the events of the cycle and the kernel report
//! them.

use motord_bus::Identity;
use motord_bus::socketcan::{Announcement, Announcements};
use motord_settings::settings::{BusSettings, Settings};
use motord_shared::BusCondition;
use std::collections::BTreeSet;
use std::sync::mpsc::Sender;

/// A task of the reconnector, with the index of a bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Task {
    /// Opens the bus again.
    Open(usize),
    /// Discards the frames that wait on a bus which the cycle holds, then opens it again.
    Empty(usize),
}

/// Reports broken and held buses to the reconnector.
pub struct BusWatch {
    tasks: Sender<Task>,
    /// The CAN interface of each bus, by index.
    interfaces: Vec<Option<String>>,
    /// `None` where the kernel refuses them.
    announcements: Option<Announcements>,
    /// The condition of each bus, by index.
    conditions: Vec<BusCondition>,
    /// The conditions since the last [`turn`](Self::turn).
    recorded: Vec<(usize, BusCondition)>,
    /// The buses that are off since the last [`report_off`](Self::report_off).
    off: BTreeSet<usize>,
    /// The buses whose interfaces are down, as the cycle noticed.
    down: BTreeSet<usize>,
    /// The buses whose interfaces are down, as the kernel announced.
    announced_down: BTreeSet<usize>,
}

impl BusWatch {
    /// Reports to `tasks`.
    #[must_use]
    pub fn new(settings: &Settings, tasks: Sender<Task>) -> Self {
        let interface = |bus: &BusSettings| bus.interface().map(str::to_owned);
        let interfaces: Vec<_> = settings.buses.iter().map(interface).collect();
        let has_interfaces = interfaces.iter().any(Option::is_some);
        Self {
            tasks,
            conditions: vec![BusCondition::Active; interfaces.len()],
            interfaces,
            announcements: has_interfaces.then(Announcements::open).and_then(Result::ok),
            recorded: Vec::new(),
            off: BTreeSet::new(),
            down: BTreeSet::new(),
            announced_down: BTreeSet::new(),
        }
    }

    /// Takes in the condition of a bus.
    pub fn record(&mut self, bus: usize, condition: BusCondition) {
        self.recorded.push((bus, condition));
    }

    /// Reports the buses that are gone, and those whose interfaces were down and are up again: they
    /// may have another bit rate, or be in listen-only mode, which opening them checks. The kernel
    /// also announces what happened between two frames, which the cycle did not notice.
    pub fn turn(&mut self) {
        // Whatever was announced before a condition is taken in before it: motord itself takes down
        // an interface that it sets up.
        let announced = self.announced();
        let mut reports: BTreeSet<usize> =
            announced.into_iter().filter_map(|(bus, up)| self.announce(bus, up)).collect();
        for (bus, condition) in std::mem::take(&mut self.recorded) {
            reports.extend(self.take_in(bus, condition));
        }
        reports.into_iter().for_each(|bus| self.report(Task::Open(bus)));
    }

    /// Returns the buses whose interfaces the kernel announced, and whether they are up.
    fn announced(&mut self) -> Vec<(usize, bool)> {
        let mut all: Vec<Announcement> = Vec::new();
        if let Some(announcements) = &mut self.announcements {
            announcements.take(|announcement| all.push(announcement));
        }
        let bus_of = |index: u32| {
            let is_it = |name: &Option<String>| {
                name.as_deref().and_then(Identity::of_interface) == Some(Identity::Interface(index))
            };
            self.interfaces.iter().position(is_it)
        };
        all.into_iter()
            .filter_map(|announcement| Some((bus_of(announcement.index)?, announcement.up)))
            .collect()
    }

    /// Returns a bus whose interface was down and is up again. While the cycle does not use it, the
    /// reconnector does.
    fn announce(&mut self, bus: usize, up: bool) -> Option<usize> {
        use BusCondition::{Active, Passive, Warning};
        let was_down = self.announced_down.remove(&bus);
        let is_used = matches!(self.conditions[bus], Active | Warning | Passive);
        if is_used && !up {
            self.announced_down.insert(bus);
        }
        (is_used && was_down && up).then_some(bus)
    }

    fn take_in(&mut self, bus: usize, condition: BusCondition) -> Option<usize> {
        use BusCondition::{Active, Held, Passive, Warning};
        let before = std::mem::replace(&mut self.conditions[bus], condition);
        // A held bus that was down meanwhile is not held for the first time.
        if condition == Held && matches!(before, Active | Warning | Passive) {
            if self.interfaces[bus].is_some() {
                self.report(Task::Empty(bus));
            }
            return None;
        }
        self.off.remove(&bus);
        let was_down = self.down.remove(&bus);
        match condition {
            BusCondition::Gone => return Some(bus),
            BusCondition::Down => {
                self.down.insert(bus);
            }
            BusCondition::Off => {
                // A controller may return by itself, and is checked then.
                self.off.insert(bus);
                self.down.extend(was_down.then_some(bus));
            }
            _ if was_down => return Some(bus),
            _ => {}
        }
        None
    }

    /// Reports the buses that are still off. A controller that left its bus returns by itself where
    /// `restart-ms` is set.
    pub fn report_off(&mut self) {
        std::mem::take(&mut self.off).into_iter().for_each(|bus| self.report(Task::Open(bus)));
    }

    fn report(&self, task: Task) {
        let _ended = self.tasks.send(task);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{Receiver, channel};

    /// A watch of three buses, the last one with an interface, and its reports.
    fn watch() -> (BusWatch, Receiver<Task>) {
        let (tasks, reports) = channel();
        let watch = BusWatch {
            tasks,
            interfaces: vec![None, None, Some("can0".into())],
            announcements: None,
            conditions: vec![BusCondition::Active; 3],
            recorded: Vec::new(),
            off: BTreeSet::new(),
            down: BTreeSet::new(),
            announced_down: BTreeSet::new(),
        };
        (watch, reports)
    }

    fn record(watch: &mut BusWatch, bus: usize, condition: BusCondition) {
        watch.record(bus, condition);
        watch.turn();
    }

    #[test]
    fn bus_that_recovers_is_not_reported() {
        let (mut watch, reports) = watch();
        record(&mut watch, 0, BusCondition::Off);
        record(&mut watch, 1, BusCondition::Off);
        record(&mut watch, 2, BusCondition::Gone);
        assert_eq!(reports.try_iter().collect::<Vec<_>>(), [Task::Open(2)]);
        record(&mut watch, 0, BusCondition::Active);
        watch.report_off();
        watch.report_off();
        assert_eq!(reports.try_iter().collect::<Vec<_>>(), [Task::Open(1)]);
    }

    #[test]
    fn interface_that_was_down_is_checked_again() {
        let (mut watch, reports) = watch();
        record(&mut watch, 0, BusCondition::Down);
        record(&mut watch, 0, BusCondition::Down);
        assert_eq!(reports.try_iter().count(), 0);
        record(&mut watch, 1, BusCondition::Active);
        record(&mut watch, 0, BusCondition::Off);
        assert_eq!(reports.try_iter().count(), 0);
        record(&mut watch, 0, BusCondition::Active);
        record(&mut watch, 0, BusCondition::Warning);
        assert_eq!(reports.try_iter().collect::<Vec<_>>(), [Task::Open(0)]);
    }

    #[test]
    fn held_interface_is_emptied_once() {
        let (mut watch, reports) = watch();
        record(&mut watch, 0, BusCondition::Held);
        assert_eq!(reports.try_iter().count(), 0, "a bus inside the daemon empties itself");
        record(&mut watch, 2, BusCondition::Held);
        assert_eq!(reports.try_iter().collect::<Vec<_>>(), [Task::Empty(2)]);
        assert_eq!([false, true].map(|up| watch.announce(2, up)), [None, None], "motord took it down");
        record(&mut watch, 2, BusCondition::Down);
        record(&mut watch, 2, BusCondition::Held);
        assert_eq!(reports.try_iter().collect::<Vec<_>>(), [Task::Open(2)]);
        record(&mut watch, 2, BusCondition::Active);
        record(&mut watch, 2, BusCondition::Held);
        assert_eq!(reports.try_iter().collect::<Vec<_>>(), [Task::Empty(2)]);
    }

    #[test]
    fn interface_that_was_down_between_frames_is_checked() {
        let (mut watch, _) = watch();
        assert_eq!([false, false, true, true].map(|up| watch.announce(0, up)), [None, None, Some(0), None]);
        // The reconnector sets up an interface that is gone, off or down.
        for condition in [BusCondition::Gone, BusCondition::Off, BusCondition::Down, BusCondition::Exchanged]
        {
            record(&mut watch, 1, condition);
            assert_eq!([false, true].map(|up| watch.announce(1, up)), [None, None], "{condition}");
        }
    }
}
