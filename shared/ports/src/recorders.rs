//! The daemon's port for records, which exists only while a recorder is connected.

use crate::iceoryx::Payload;
use crate::reserved_space;
use crate::service::{Part, Service, ServiceError};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::BackpressureStrategy;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use motord_shared::CycleRecord;
use motord_shared::limits::{RECORDERS_MAX, RECORDS_KEPT};
use std::path::PathBuf;
use std::sync::Arc;

/// Records in memory. All recorders share the newest records; each recorder may read an older one,
/// and one is written.
const RECORDS: usize = RECORDS_KEPT + RECORDERS_MAX + 2;
/// The file of the records, and the connections of the recorders.
const BYTES: usize = RECORDS * size_of::<CycleRecord>() + (1 << 20);

/// The recorders that are connected.
#[derive(Debug, Clone)]
pub struct Recorders {
    service: Arc<PortFactory<Service, Payload<CycleRecord>, ()>>,
    directory: PathBuf,
}

/// Sends records to every recorder.
#[derive(Debug)]
pub struct RecordSender(Publisher<Service, Payload<CycleRecord>, ()>);

impl Recorders {
    pub(crate) fn new(service: PortFactory<Service, Payload<CycleRecord>, ()>, directory: PathBuf) -> Self {
        Self { service: Arc::new(service), directory }
    }

    /// Returns `true` while a recorder is connected.
    #[must_use]
    pub fn are_connected(&self) -> bool {
        self.service.dynamic_config().number_of_subscribers() > 0
    }

    /// Opens the port, with memory for a quarter of a second of a 1 kHz cycle. Takes milliseconds:
    /// use it on a thread without deadlines.
    ///
    /// # Errors
    /// The reason why it could not be opened.
    pub fn open(&self) -> Result<RecordSender, ServiceError> {
        reserved_space::check(&self.directory, BYTES as i64).map_err(Part::Record.failed())?;
        let publisher = self
            .service
            .publisher_builder()
            .max_loaned_samples(1)
            .override_sample_preallocation(|_| RECORDS)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(Part::Record.failed())?;
        reserved_space::occupy(&self.directory).map_err(Part::Record.failed())?;
        Ok(RecordSender(publisher))
    }
}

impl RecordSender {
    /// Sends `record` to every recorder. A recorder whose buffer is full loses its oldest record.
    /// Never blocks.
    ///
    /// # Errors
    /// A damaged connection; the other recorders have received the record.
    pub fn send(&self, record: &CycleRecord) -> Result<(), ServiceError> {
        let sample = self.0.loan_uninit().map_err(Part::Record.failed())?;
        sample.write_payload(Payload(*record)).send().map_err(Part::Record.failed())?;
        Ok(())
    }
}
