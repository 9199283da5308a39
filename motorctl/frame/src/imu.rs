//! The IMUs of a configuration on CAN buses, for decoding a log of their buses.

use crate::object::Object;
use crate::rejected::Rejected;
use motord_bus::Frame;
use motord_protocol::imu::{CanDevice, Measured, SampleField};
use motord_protocol::profile::STEADYWIN;

/// An IMU on an interface.
pub(super) struct LoggedImu {
    name: String,
    interface: String,
    device: CanDevice,
}

impl LoggedImu {
    pub(super) const fn new(name: String, interface: String, device: CanDevice) -> Self {
        Self { name, interface, device }
    }

    /// Decodes a frame from or to this device; `None` for another frame.
    pub(super) fn decode(&self, interface: &str, frame: &Frame) -> Option<Result<Object, Rejected>> {
        if interface != self.interface {
            return None;
        }
        let id = u16::try_from(frame.id().raw()).ok()?;
        let payload = frame.payload();
        let is_request =
            |request: &motord_protocol::imu::CanRequest| request.id() == id && request.payload() == payload;
        if let Some(number) = self.device.requests().position(|request| is_request(&request)) {
            return Some(Ok(self.object("imu_request", self.device.requested(number))));
        }
        if self.device.start().is_some_and(|start| is_request(&start)) {
            return Some(Ok(self.object("imu_start", None)));
        }
        if !self.device.sent_ids().any(|sent| sent == id) {
            return None;
        }
        Some(match self.device.measured(id, payload) {
            Ok(Some(measured)) => Ok(self.sample(&measured)),
            Ok(None) => Ok(self.object("imu_state", None)),
            Err(error) => Err(Rejected::Imu { imu: self.name.clone(), error }),
        })
    }

    fn sample(&self, measured: &Measured) -> Object {
        let mut object = self.object("imu_sample", Some(measured.field()));
        let values = match measured {
            Measured::Acceleration(values) | Measured::AngularVelocity(values) | Measured::Angles(values) => {
                values.to_vec()
            }
            Measured::Orientation(quaternion) => quaternion.parts().to_vec(),
        };
        object.insert("values", values);
        object
    }

    fn object(&self, kind: &str, quantity: Option<SampleField>) -> Object {
        let mut object = Object::new(&STEADYWIN, None);
        object.insert("kind", kind);
        if let Some(quantity) = quantity {
            object.insert("quantity", quantity.to_string());
        }
        object.insert("imu", self.name.as_str());
        object
    }
}
