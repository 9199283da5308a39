//! The faults of a bus, and the nodes that acknowledge its frames.

use super::{Flood, Link, SimulatedBus, controller_report, unexpected_frame};
use crate::contention::{Contender, Sender};
use crate::fault::{Fault, InjectError};
use crate::motor::Motor;
use motord_bus::{Content, Duration, ErrorFrame, Instant};

impl SimulatedBus {
    pub(super) fn disturb(&mut self, fault: Fault) -> Result<(), InjectError> {
        match fault {
            Fault::Ok => self.recover()?,
            Fault::PowerOff => {
                self.has_no_power = true;
                self.each_motor(Fault::PowerOff)?;
            }
            Fault::BusOff => {
                self.cut(Link::Off);
                self.report(ErrorFrame { class: ErrorFrame::BUS_OFF, data: [0; 8] });
            }
            Fault::TxFull(space) => self.link = Link::Full { space },
            Fault::NoAck => {
                self.link = Link::Unacknowledged;
                self.report(ErrorFrame { class: ErrorFrame::NO_ACKNOWLEDGE, data: [0; 8] });
            }
            Fault::Down => self.cut(Link::Down),
            Fault::Gone => self.cut(Link::Gone),
            Fault::Flood(rate) => self.flood(rate),
            Fault::Bitrate(bitrate) => self.set_bitrate(bitrate),
            Fault::Report(state) => self.report(controller_report(state)),
            Fault::Unsupported(unsupported) => self.arrive(self.now, Content::Unsupported(unsupported)),
            // Byte 1 of CAN_ERR_CRTL in linux/can/error.h: RX buffer overflow.
            Fault::Overrun => {
                self.report(ErrorFrame { class: ErrorFrame::CONTROLLER, data: [0, 1, 0, 0, 0, 0, 0, 0] });
            }
            Fault::Overflow(frames) => self.lost = self.lost.saturating_add(frames),
            Fault::Echo
            | Fault::Glue(_)
            | Fault::Loss(_)
            | Fault::Corruption(_)
            | Fault::Silent
            | Fault::Blocked => return Err(InjectError::OnlySerial),
            _ => return Err(InjectError::NotForBuses),
        }
        Ok(())
    }

    /// Injects `fault` into each motor.
    fn each_motor(&mut self, fault: Fault) -> Result<(), InjectError> {
        for (index, motor) in self.motors.iter_mut().enumerate() {
            self.answers.forget(Sender::Motor(index));
            motor.inject(self.now, fault)?;
        }
        Ok(())
    }

    fn recover(&mut self) -> Result<(), InjectError> {
        if core::mem::take(&mut self.has_no_power) {
            self.each_motor(Fault::Ok)?;
        }
        if self.link == Link::Off {
            self.report(ErrorFrame { class: ErrorFrame::RESTARTED, data: [0; 8] });
        }
        self.link = Link::Up;
        self.flood = None;
        Ok(())
    }

    /// Returns the time from which a node acknowledges the host's frames; `None` for never.
    pub(super) fn acknowledged_from(&self) -> Option<Instant> {
        if self.link == Link::Unacknowledged {
            return None;
        }
        if self.settings.adapter.is_none() || !self.imus.is_empty() || self.flood.is_some() {
            return Some(Instant::ZERO);
        }
        self.motors.iter().filter_map(Motor::acknowledges_from).min()
    }

    /// Takes the host off the bus. Its queue and its frame on the wire are lost.
    fn cut(&mut self, link: Link) {
        self.link = link;
        self.queue.clear();
        self.wire = self.wire.filter(|transfer| transfer.sender != Sender::Host);
    }

    pub(super) fn report(&mut self, error: ErrorFrame) {
        self.arrive(self.now, Content::Error(error));
    }

    fn set_bitrate(&mut self, bitrate: u32) {
        self.settings.bitrate = bitrate;
        self.motors.iter_mut().for_each(|motor| motor.set_bitrate(bitrate));
    }

    fn flood(&mut self, rate: u32) {
        let period = Duration::from_secs(1) / rate.max(1);
        let frame = unexpected_frame(&mut self.random);
        let duration = self.duration(&frame);
        let contender = Contender { sender: Sender::Flood, frame, ready: self.now, duration };
        self.flood = Some(Flood { period, contender });
    }
}
