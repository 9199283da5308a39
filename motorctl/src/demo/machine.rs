//! Whether this computer has time for a demo.

use std::fs;
use std::thread;
use std::time::Duration;

/// The threads that want to run are counted so often, with this pause.
const COUNTS: u32 = 20;
const PAUSE: Duration = Duration::from_millis(10);

/// Threads that want to run, and the processors for them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ProcessorLoad {
    /// Mean number of other threads that wanted to run.
    running: f64,
    processors: usize,
}

impl ProcessorLoad {
    /// Asks the kernel for 0.2 s: its mean of the last minute would still count the build of this program. `None` when it does not tell.
    pub(crate) fn read() -> Option<Self> {
        let processors = thread::available_parallelism().ok()?.get();
        let mut sum = 0.0;
        for _ in 0..COUNTS {
            thread::sleep(PAUSE);
            sum += running(&fs::read_to_string("/proc/loadavg").ok()?)?;
        }
        // One of them is this thread.
        Some(Self { running: sum / f64::from(COUNTS) - 1.0, processors })
    }

    /// A sentence without its full stop when others want more processors than there are.
    pub(crate) fn overload(self) -> Option<String> {
        let Self { running, processors } = self;
        let is_overloaded = running > processors as f64;
        is_overloaded.then(|| {
            format!("this computer is overloaded ({running:.1} threads want its {processors} processors)")
        })
    }
}

/// Threads that want to run at this moment. Source: proc_loadavg(5), the fourth field.
fn running(loadavg: &str) -> Option<f64> {
    loadavg.split_whitespace().nth(3)?.split('/').next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_work_than_processors_is_an_overload() {
        let machine = |running| ProcessorLoad { running, processors: 2 };
        assert_eq!(machine(2.0).overload(), None);
        let sentence = "this computer is overloaded (2.5 threads want its 2 processors)";
        assert_eq!(machine(2.5).overload().as_deref(), Some(sentence));
        assert!(ProcessorLoad::read().is_some());
    }

    #[test]
    fn recently_finished_build_is_no_overload() {
        assert_eq!(running("2.20 1.80 0.90 1/512 4711\n"), Some(1.0));
        assert_eq!(running(""), None);
        assert_eq!(running("2.20 1.80 0.90 x/512"), None);
    }
}
