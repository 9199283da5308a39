//! The cycle with simulated motors, on virtual time.

mod ambiguous;
mod cansimple;
mod conventions;
mod cycle;
mod external_plant;
mod family;
mod faults_bus;
mod faults_client;
mod faults_motor;
mod faults_time;
mod foreign;
mod gim;
mod horizon;
mod imu;
mod imu_can;
mod mixed;
mod myactuator;
mod odrive;
mod power;
mod publication;
mod reads;
mod registers;
mod replay;
mod response;
mod robstride;
mod transitions;
mod turns;

use motord_bus::{Frame, FrameId};

/// A reply of motor 1 with these bytes.
fn reply_with(payload: &[u8]) -> Frame {
    Frame::new(FrameId::new(0x101).expect("it has eleven bits"), payload).expect("at most eight bytes")
}
