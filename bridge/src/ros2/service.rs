//! The services, in both mappings of ROS 2 to DDS.
//!
//! rmw_fastrtps (Enhanced) identifies a request by a parameter of its DDS sample, rmw_cyclonedds
//! (Cyclone) by a header in the payload. Both use the same topics, so a server for each mapping
//! reads each request, and ignores those of the other mapping.

use crate::request::{Answer, Operation, Request};
use crate::ros2::messages::TriggerResponse;
use crate::stop::{NO_RECEIPT, StopDesk};
use ros2_client::dds::{Node, Server, ServiceMapping};
use ros2_client::qos::{History, QosProfile, WhenFull};
use ros2_client::{Message, Name, ServiceTypeName};
use serde::de::{Deserialize, Deserializer, SeqAccess, Visitor};
use serde::ser::{Serialize, SerializeTuple, Serializer};
use std::fmt;
use std::sync::mpsc::{SyncSender, TrySendError};

/// A request of the Enhanced mapping has one byte, and padding. One of Cyclone begins with a header
/// of this many bytes.
const CYCLONE_HEADER: usize = 16;

/// Both mappings.
pub(crate) const MAPPINGS: [ServiceMapping; 2] = [ServiceMapping::Enhanced, ServiceMapping::Cyclone];

/// The request of `std_srvs/Trigger`, which has no field, by its number of bytes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TriggerRequest {
    bytes: usize,
}

impl Message for TriggerRequest {}

impl Serialize for TriggerRequest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut bytes = serializer.serialize_tuple(1)?;
        bytes.serialize_element(&0u8)?;
        bytes.end()
    }
}

impl<'a> Deserialize<'a> for TriggerRequest {
    fn deserialize<D: Deserializer<'a>>(deserializer: D) -> Result<Self, D::Error> {
        struct Bytes;
        impl<'a> Visitor<'a> for Bytes {
            type Value = usize;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("bytes")
            }
            fn visit_seq<S: SeqAccess<'a>>(self, mut bytes: S) -> Result<usize, S::Error> {
                let mut count = 0;
                // The end of the payload is an error.
                while let Ok(Some(_)) = bytes.next_element::<u8>() {
                    count += 1;
                }
                Ok(count)
            }
        }
        deserializer.deserialize_tuple(CYCLONE_HEADER, Bytes).map(|bytes| Self { bytes })
    }
}

/// A server of one service in one mapping.
pub(crate) struct TriggerServer {
    mapping: ServiceMapping,
    server: Server<TriggerRequest, TriggerResponse>,
}

impl TriggerServer {
    /// Creates the server of the service `name`.
    pub(crate) fn new(node: &mut Node, name: &Name, mapping: ServiceMapping) -> Result<Self, String> {
        let qos = QosProfile::publisher_default()
            .reliability_reliable(WhenFull::Fail)
            .history(History::KeepLast { depth: 10 });
        let service_type = ServiceTypeName::new("std_srvs", "Trigger");
        let server = node.create_server(mapping, name, &service_type, qos.clone(), qos);
        let server = server.map_err(|error| format!("cannot create the service {name:?}: {error}"))?;
        Ok(Self { mapping, server })
    }

    /// Serves requests one after the other, by `perform`. Yields after each, so that a flood of
    /// requests delays the other tasks of the thread by one request at most.
    pub(crate) async fn serve<F: Future<Output = Answer>>(self, perform: impl Fn() -> F) {
        loop {
            // A request that cannot be decoded is one of the other mapping, or none.
            if let Ok((id, request)) = self.server.async_receive_request().await
                && self.is_ours(request)
            {
                let answer = perform().await;
                let success = answer.is_ok();
                let message = answer.unwrap_or_else(|error| error);
                if let Err(error) = self.server.send_response(id, TriggerResponse { success, message }) {
                    log::warn!("the answer of a service was not sent: {error:?}");
                }
            }
            futures_lite::future::yield_now().await;
        }
    }

    fn is_ours(&self, request: TriggerRequest) -> bool {
        matches!(self.mapping, ServiceMapping::Cyclone) || request.bytes < CYCLONE_HEADER
    }
}

/// Requests an operation of the motor thread, and waits for its answer without blocking the thread.
pub(crate) async fn request(requests: &SyncSender<Request>, group: usize, operation: Operation) -> Answer {
    let (sender, answer) = async_channel::bounded(1);
    match requests.try_send(Request { group, operation, answer: sender }) {
        Ok(()) => answer.recv().await.unwrap_or_else(|_| Err("the bridge is ending".to_owned())),
        Err(TrySendError::Full(_)) => Err("too many requests wait: try again".to_owned()),
        Err(TrySendError::Disconnected(_)) => Err("the bridge is ending".to_owned()),
    }
}

/// Requests an emergency stop, and waits for its receipt without blocking the thread.
pub(crate) async fn stop(desk: &StopDesk, source: &str) -> Answer {
    match desk.request(source.to_owned()).recv().await {
        Ok(receipt) if receipt.is_confirmed => Ok(receipt.message),
        Ok(receipt) => Err(receipt.message),
        Err(_) => Err(NO_RECEIPT.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros2_client::dds::rustdds::RepresentationIdentifier;
    use ros2_client::dds::rustdds::serialization::deserialize_from_cdr_with_rep_id;

    #[test]
    fn mapping_of_a_request_is_its_length() {
        let bytes = |length: usize| {
            let payload = vec![0; length];
            let encoding = RepresentationIdentifier::CDR_LE;
            deserialize_from_cdr_with_rep_id::<TriggerRequest>(&payload, encoding).unwrap().0.bytes
        };
        assert_eq!([0, 1, 4, 17, 5000].map(bytes), [0, 1, 4, CYCLONE_HEADER, CYCLONE_HEADER]);
    }
}
