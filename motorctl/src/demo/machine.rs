//! The load of this computer before a demo.

use std::fs;
use std::thread;
use std::time::Duration;

/// Number of samples of the runnable threads, with this pause.
const COUNTS: u32 = 20;
const PAUSE: Duration = Duration::from_millis(10);

/// Runnable threads and processors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ProcessorLoad {
    /// Mean number of other runnable threads.
    running: f64,
    processors: usize,
}

impl ProcessorLoad {
    /// Samples the load for 0.2 s. The mean of the last minute would include the build of this
    /// program. `None` if the kernel does not return it.
    pub(crate) fn read() -> Option<Self> {
        let processors = thread::available_parallelism().ok()?.get();
        let mut sum = 0.0;
        for _ in 0..COUNTS {
            thread::sleep(PAUSE);
            sum += running(&fs::read_to_string("/proc/loadavg").ok()?)?;
        }
        // Subtract this thread.
        Some(Self { running: sum / f64::from(COUNTS) - 1.0, processors })
    }

    /// Returns a sentence without its full stop if there are more runnable threads than processors.
    pub(crate) fn overload(self) -> Option<String> {
        let Self { running, processors } = self;
        let is_overloaded = running > processors as f64;
        is_overloaded.then(|| {
            format!("this computer is overloaded ({running:.1} threads want its {processors} processors)")
        })
    }
}

/// Returns the runnable threads. Source: proc_loadavg(5), the fourth field.
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
