//! The IMUs that are not on a CAN bus: their samples are read outside the real-time thread.
//!
//! ```text
//!   Reader, ExternalImus ──sample──▶ Writer: turned into the frame of the body ──wait-free buffer──▶ cycle
//! ```
//!
//! A [`Reader`] has a dedicated thread. The samples of other processes arrive at the ports of the
//! ipc thread, which passes them to [`ExternalImus`].

mod external;
mod gaps;
mod log;
mod reader;
mod serial;
mod simulated;
mod writer;

pub use external::ExternalImus;
pub(crate) use log::LineLimit;
pub use reader::Reader;
pub use simulated::{SimulatedImus, World, simulated_port};

use motord_bus::Instant;
use motord_core::control::ImuReading;
use motord_settings::sensor::imu::{ImuSettings, ImuSource};
use serial::SerialImu;
use triple_buffer::Input;
use writer::Writer;

/// The IMUs of a robot, by source.
#[derive(Default)]
pub struct Sources {
    /// Those with a thread: all simulated ones together, and each on a serial line, because to open
    /// a port can take longer than a sample of another IMU may wait.
    pub readers: Vec<Box<dyn Reader>>,
    /// The simulated ones, for injected faults.
    pub simulated: Option<SimulatedImus>,
    /// Those that other processes publish.
    pub external: Option<ExternalImus>,
}

impl Sources {
    /// Divides `imus`, with their ends of the cycle. The simulated ones begin at `start`, and
    /// measure `world`; `boot_id` is that of the daemon.
    #[must_use]
    pub fn of(
        imus: &[ImuSettings],
        inputs: Vec<Input<ImuReading>>,
        start: Instant,
        world: World,
        boot_id: u64,
    ) -> Self {
        let (mut readers, mut simulated, mut external) =
            (Vec::<Box<dyn Reader>>::new(), Vec::new(), Vec::new());
        for ((index, imu), input) in imus.iter().enumerate().zip(inputs) {
            let writer = Writer::new(input, imu.mount);
            match &imu.source {
                ImuSource::Simulated(errors) => {
                    simulated.push(simulated::Source::new(imu, errors, writer, start));
                }
                ImuSource::Serial(line) => readers.push(Box::new(SerialImu::new(imu, line, writer))),
                // The cycle reads it.
                ImuSource::Can(_) => {}
                ImuSource::External => external.push(external::Source::new(index, imu, writer)),
            }
        }
        let simulated = (!simulated.is_empty()).then(|| SimulatedImus::new(simulated, world, start));
        readers.extend(simulated.clone().map(|imus| Box::new(imus) as Box<dyn Reader>));
        Self {
            readers,
            simulated,
            external: (!external.is_empty()).then(|| ExternalImus::new(external, boot_id)),
        }
    }
}
