//! An IMU on a CAN bus: the requests to it, and the samples in its frames.
//!
//! Real-time: after [`on_bus`] nothing here allocates, blocks or calls the system.

use super::device::Sensor;
use crate::control::{ImuReading, Reading, Repetition};
use motord_bus::time::nanos;
use motord_bus::{Duration, Frame, FrameId, Instant};
use motord_protocol::imu::{CanDecoder, SampleError};
use motord_settings::sensor::imu::{ImuCan, ImuSample, ImuSettings, Mount};
use motord_settings::settings::Settings;

/// A device that gave no sample for this many requests is asked only once in [`PROBE_PERIOD`]: the
/// cycle would wait for its replies each time.
const SILENT_MAX: u32 = 10;
/// Time between two requests to a device that is silent.
const PROBE_PERIOD: Duration = Duration::from_millis(100);

/// An IMU on a CAN bus.
#[derive(Debug)]
struct CanImu {
    /// Its index in the configuration.
    imu: usize,
    can: ImuCan,
    ids: Vec<FrameId>,
    /// The requests for a sample, in their order.
    requests: Vec<Frame>,
    /// Starts a device that sends by itself, on a bus where nothing else is sent: only the refusal
    /// of a frame shows that the interface is unplugged.
    start: Option<Frame>,
    decoder: CanDecoder,
    mount: Mount,
    period: Duration,
    /// Cycles from one request to the next.
    every: u64,
    /// Cycles from one request to the next while the device is silent.
    probe_every: u64,
    /// The next cycle with a request.
    due: u64,
    /// The requests that are not answered, by bit.
    open: u8,
    sent_at: Instant,
    /// A sample was asked for and has not arrived.
    is_awaited: bool,
    /// Requests for a sample in a row without one.
    silent: u32,
    /// Arrival of the last sample, sound or not; `None` after a disconnection.
    last: Option<Instant>,
    repetition: Repetition,
    reading: ImuReading,
    is_new: bool,
    /// Its bus is off or gone: frames that were not read before are not used.
    is_cut: bool,
}

/// Returns the IMUs of `bus`. Allocates.
pub(super) fn on_bus(settings: &Settings, bus: usize) -> Vec<Box<dyn Sensor>> {
    let imus = settings.sensors.imus.iter().enumerate();
    let on_bus = imus.filter_map(|(index, imu)| Some((index, imu, imu.source.can()?)));
    let has_motors = settings.motors.iter().any(|motor| motor.bus == bus);
    let new = |(index, imu, can)| Box::new(CanImu::new((index, imu), can, settings, has_motors));
    on_bus.filter(|(_, _, can)| can.bus == bus).map(|imu| new(imu) as Box<dyn Sensor>).collect()
}

impl CanImu {
    fn new((index, imu): (usize, &ImuSettings), can: &ImuCan, settings: &Settings, has_motors: bool) -> Self {
        let period = Duration::from_secs_f64(1.0 / imu.rate_hz);
        let cycle_hz = settings.cycle.rate_hz;
        let requests = can.device.requests();
        let start = can.device.start().filter(|_| !has_motors);
        Self {
            imu: index,
            can: can.clone(),
            ids: can.device.sent_ids().filter_map(FrameId::new).collect(),
            requests: requests.filter_map(|request| frame(request.id(), request.payload())).collect(),
            start: start.and_then(|start| frame(start.id(), start.payload())),
            decoder: can.device.decoder(nanos(period) / 1000),
            mount: imu.mount,
            period,
            every: ImuCan::every(imu.rate_hz, cycle_hz).into(),
            probe_every: (PROBE_PERIOD.as_secs_f64() * cycle_hz).ceil() as u64,
            due: 0,
            open: 0,
            sent_at: Instant::ZERO,
            is_awaited: false,
            silent: 0,
            last: None,
            repetition: Repetition::default(),
            reading: ImuReading::default(),
            is_new: false,
            is_cut: false,
        }
    }

    /// Gives up the sample that was asked for, if it has not arrived.
    fn end_sample(&mut self) {
        if core::mem::take(&mut self.is_awaited) {
            self.decoder.drop_sample();
            self.silent = self.silent.saturating_add(1);
            self.miss(1);
        }
    }

    fn miss(&mut self, samples: u32) {
        self.reading.missing = self.reading.missing.wrapping_add(samples);
        self.is_new = true;
    }

    /// Closes the request with this number, if it is the next that the device answers: it answers
    /// in the order of the requests.
    const fn answers(&mut self, number: usize, at: Instant) -> bool {
        let is_answer =
            at.as_nanos() >= self.sent_at.as_nanos() && self.open.trailing_zeros() as usize == number;
        if is_answer {
            self.open &= self.open - 1;
        }
        is_answer
    }

    fn take(&mut self, id: FrameId, payload: &[u8], at: Instant) {
        match self.decoder.push(id.raw() as u16, payload, at.as_nanos() / 1000) {
            Ok(None) | Err(SampleError::Incomplete { .. }) => {}
            Ok(Some(sample)) => match ImuSample::of(&sample).and_then(|sample| sample.checked()) {
                Some(sound) if !self.repetition.is_stuck(&sound, at) => self.deliver(&sound, at),
                Some(_) | None => self.reject(at),
            },
            Err(_) => self.reject(at),
        }
    }

    fn deliver(&mut self, sample: &ImuSample, at: Instant) {
        if self.silent >= SILENT_MAX {
            // The request was a rare one: the next follows in the next cycle.
            self.due = 0;
        }
        self.end_gap(at);
        self.reading = ImuReading {
            sample: self.mount.to_body(sample),
            received: at,
            sequence: self.reading.sequence + 1,
            is_connected: true,
            ..self.reading
        };
        self.is_new = true;
    }

    fn reject(&mut self, at: Instant) {
        self.end_gap(at);
        self.reading.rejected = self.reading.rejected.wrapping_add(1);
        self.is_new = true;
    }

    /// Takes a sample at `at` into account, sound or not. A device that sends by itself lost those
    /// that were due before it.
    fn end_gap(&mut self, at: Instant) {
        (self.is_awaited, self.silent) = (false, 0);
        let before = self.last.replace(at);
        if self.can.device.protocol().is_asked() {
            return;
        }
        if let Some(before) = before {
            let periods = at.since(before).as_secs_f64() / self.period.as_secs_f64();
            self.miss((periods.round() as u32).saturating_sub(1));
        }
    }
}

impl Sensor for CanImu {
    fn frames_max(&self) -> usize {
        self.requests.len() + self.start.iter().len()
    }

    fn requests(&mut self, cycle: u64, now: Instant) -> &[Frame] {
        if cycle < self.due {
            return &[];
        }
        if self.requests.is_empty() {
            let is_silent = self.last.is_none_or(|last| now.since(last) > PROBE_PERIOD);
            self.due = cycle + self.probe_every;
            return if is_silent { self.start.as_slice() } else { &[] };
        }
        self.end_sample();
        let is_silent = self.silent >= SILENT_MAX;
        self.due = cycle + if is_silent { self.probe_every.max(self.every) } else { self.every };
        (self.open, self.sent_at, self.is_awaited) = ((1 << self.requests.len()) - 1, now, true);
        &self.requests
    }

    fn accepted(&mut self, frames: usize) {
        // The device answers only the requests that the bus accepted.
        self.is_cut &= frames == 0;
        self.open &= (1_u32 << if frames < 8 { frames } else { 8 }).wrapping_sub(1) as u8;
        self.is_awaited &= frames > 0;
    }

    fn open(&self) -> usize {
        self.open.count_ones() as usize
    }

    fn receive(&mut self, frame: &Frame, at: Instant) -> Option<bool> {
        let id = frame.id();
        if !self.ids.contains(&id) {
            return None;
        }
        if self.is_cut {
            return Some(false);
        }
        let request = self.can.device.answered(frame.payload());
        let is_answer = request.is_some_and(|number| self.answers(number, at));
        match request {
            // Answers an earlier request, which was given up.
            Some(_) if !is_answer && (at < self.sent_at || self.open != 0) => {}
            Some(_) if !is_answer => self.reject(at),
            _ => self.take(id, frame.payload(), at),
        }
        Some(is_answer)
    }

    fn disconnect(&mut self) {
        self.decoder.drop_sample();
        (self.open, self.is_awaited, self.silent, self.last) = (0, false, 0, None);
        self.reading.is_connected = false;
        (self.is_new, self.is_cut) = (true, true);
    }

    fn reconnect(&mut self) {
        self.is_cut = false;
    }

    fn take_reading(&mut self) -> Option<Reading<'_>> {
        core::mem::take(&mut self.is_new).then_some(Reading::Imu(self.imu, &self.reading))
    }
}

fn frame(id: u16, payload: &[u8]) -> Option<Frame> {
    Frame::with_format(FrameId::new(id)?, motord_bus::Format::Classic, payload)
}
