//! The thread that takes faults for simulated buses from `motorctl sim`. Only a daemon without a
//! real bus has it.

use crate::buses::injection::Injectors;
use motord_bus::Duration;
use motord_ports::injection::InjectionListener;
use motord_realtime::process::program;

/// Between two failures of the system, such as that no descriptors are left.
const BACK_OFF: Duration = Duration::from_secs(1);

/// Serves one requester after the other. Never returns.
pub fn run(listener: &InjectionListener, injectors: &mut Injectors) -> ! {
    loop {
        let served = listener.serve(|line, pid| {
            let program = program(pid).unwrap_or_default();
            let outcome = injectors.obey(line).map_err(|error| error.to_string());
            match &outcome {
                Ok(()) => tracing::info!(fault = line, program, pid, "simulated fault"),
                Err(error) => tracing::info!(fault = line, program, pid, "no simulated fault: {error}"),
            }
            outcome
        });
        if served.is_err() {
            std::thread::sleep(BACK_OFF);
        }
    }
}
