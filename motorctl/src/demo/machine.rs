//! Whether this computer has time for a demo.

use std::fs;

/// Processes that want to run, and the processors for them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Machine {
    /// Mean number of the processes that wanted to run in the last minute.
    load: f64,
    processors: usize,
}

impl Machine {
    /// Asks the kernel. `None` when it does not tell.
    pub(crate) fn read() -> Option<Self> {
        let text = fs::read_to_string("/proc/loadavg").ok()?;
        let load = text.split_whitespace().next()?.parse().ok()?;
        Some(Self { load, processors: std::thread::available_parallelism().ok()?.get() })
    }

    /// A sentence without its full stop when others want more processors than there are.
    pub(crate) fn overload(self) -> Option<String> {
        let Self { load, processors } = self;
        let is_overloaded = load > processors as f64;
        is_overloaded
            .then(|| format!("this computer is overloaded (load {load:.1} on {processors} processors)"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_work_than_processors_is_an_overload() {
        let machine = |load| Machine { load, processors: 2 };
        assert_eq!(machine(2.0).overload(), None);
        let sentence = "this computer is overloaded (load 2.5 on 2 processors)";
        assert_eq!(machine(2.5).overload().as_deref(), Some(sentence));
        assert!(Machine::read().is_some());
    }
}
