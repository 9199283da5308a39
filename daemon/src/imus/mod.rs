//! The IMUs: one thread for each source of samples, outside the real-time thread.
//!
//! ```text
//!   source ──sample──▶ checked, turned into the frame of the body ──wait-free buffer──▶ cycle
//! ```

mod external;
mod gaps;
mod line_limit;
mod port;
mod serial;
mod simulated;
mod writer;

pub use external::ExternalImus;
pub(crate) use line_limit::LineLimit;
pub use port::twin;
pub use serial::SerialImu;
pub use simulated::{SimulatedImus, World};
use writer::Writer;

use motord_bus::Instant;
use motord_core::control::ImuReading;
use motord_settings::imu::{ImuSettings, ImuSource};
use triple_buffer::Input;

/// The IMUs of a robot, by source.
#[derive(Default)]
pub struct Sources {
    /// The simulated ones.
    pub simulated: Option<SimulatedImus>,
    /// Those on serial lines. Each needs a thread, because to open a port can take longer than a sample of another IMU may wait.
    pub serial: Vec<SerialImu>,
    /// Those that other processes publish.
    pub external: Option<ExternalImus>,
}

impl Sources {
    /// Divides `imus`, with their ends of the cycle. The simulated ones begin at `start`, and measure `world`; `boot_id` is that
    /// of the daemon.
    #[must_use]
    pub fn of(
        imus: &[ImuSettings],
        inputs: Vec<Input<ImuReading>>,
        start: Instant,
        world: World,
        boot_id: u64,
    ) -> Self {
        let (mut simulated, mut serial, mut external) = (Vec::new(), Vec::new(), Vec::new());
        for ((index, imu), input) in imus.iter().enumerate().zip(inputs) {
            let writer = Writer::new(input, imu.mount);
            match &imu.source {
                ImuSource::Simulated(errors) => {
                    simulated.push(simulated::Source::new(imu, errors, writer, start));
                }
                ImuSource::Serial(line) => serial.push(SerialImu::new(imu, line, writer)),
                // The cycle reads it.
                ImuSource::Can(_) => {}
                ImuSource::External => external.push(external::Source::new(index, imu, writer)),
            }
        }
        Self {
            simulated: (!simulated.is_empty()).then(|| SimulatedImus::new(simulated, world)),
            serial,
            external: (!external.is_empty()).then(|| ExternalImus::new(external, boot_id)),
        }
    }
}
