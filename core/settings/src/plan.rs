//! The bus plan: the part of a cycle that each bus needs for its motors.
//!
//! On CAN every motor is asked once in `every` cycles. In addition at most one motor of a bus is
//! asked for its faults or an indicator. The length of a frame depends on its bits: the worst case
//! must fit, and the length without stuffing bits is the least time until a reply.
//!
//! Frames that motors send by themselves are spread over the time: the frames of a cycle take longer
//! by their share of the bus.
//!
//! The highest rate of a CAN bus is the one at which its last reply is expected at the reply
//! deadline: a later reply is missed.
//!
//! On a serial line one request is open at a time. A turn lasts for a request, the turnaround and
//! the reply, in whole cycles: the reply is read when a cycle begins.

use motord_bus::Duration;
use motord_bus::arithmetic::{FdBits, FrameLength, SERIAL_FRAME_BITS, utilisation, wire_time};

use motord_protocol::drive::UnpromptedFrame;

use crate::imu_load::SensorLoad;
use crate::settings::{MotorSettings, Settings};

/// Time of the host in a reply time: from the time stamp of the commands to their first bit, and
/// from the end of the last reply to its time stamp.
const HOST_TIME: Duration = Duration::from_micros(20);

/// Answering time of a motor without `[motor.simulation]`.
const ANSWERING_TIME: Duration = Duration::from_micros(50);

/// Largest share of a bus that is subtracted for frames which motors send by themselves.
const REPORTS_MAX: f64 = 0.99;

/// Above this worst-case utilisation a bus has too little time for retransmissions and faults: a
/// warning.
pub const WORST_CASE_SOUND: f64 = 0.8;

/// The load of one bus. Utilisations of a CAN bus are fractions of its fullest cycle: 1.0 leaves no
/// gap. Those of a serial line are fractions of the time in which each motor has one turn.
#[derive(Debug, Clone, PartialEq)]
pub struct BusPlan {
    /// Number of its motors.
    pub motors: usize,
    /// Commands and replies of all its motors, every stuffing bit included; on a line with the
    /// turnarounds.
    pub worst_case_utilisation: f64,
    /// The same frames without stuffing bits and turnarounds.
    pub unstuffed_utilisation: f64,
    /// The part of `worst_case_utilisation` that is for frames which motors send by themselves.
    pub unprompted_utilisation: f64,
    /// The worst case with a fault request to one motor.
    pub fault_poll_utilisation: f64,
    /// Least wire time of one command and its reply.
    pub transaction_least: Duration,
    /// Most wire time of one command and its reply.
    pub transaction_worst: Duration,
    /// Most time from the sending of a question to its reply.
    pub question: Duration,
    /// The least `every` with which the turns of a line do not overlap; 1 on CAN.
    pub every_least: u32,
    /// From the sending of a cycle's commands to its last reply, as expected; on a line the time of
    /// a turn.
    pub last_reply: Duration,
    /// The part of `last_reply` that is for IMUs.
    pub imu_time: Duration,
    /// The highest rate of the cycle, Hz: at it the last reply is expected at the reply deadline,
    /// and turns of a line do not overlap. Infinite for a bus that asks nothing.
    pub rate_hz_max: f64,
}

impl BusPlan {
    /// The plan of every bus, in the order of `settings.buses`.
    #[must_use]
    pub fn of(settings: &Settings) -> Vec<Self> {
        let plan = |bus: usize| {
            let kind = &settings.buses[bus].kind;
            match kind.turnaround() {
                Some(turnaround) => Self::of_line(settings, bus, kind.bitrate(), turnaround),
                None => Self::of_can(settings, bus, [kind.bitrate(), kind.data_bitrate()]),
            }
        };
        (0..settings.buses.len()).map(plan).collect()
    }

    /// `bitrates` are those of arbitration and of the payloads of CAN FD, bit/s.
    fn of_can(settings: &Settings, bus: usize, bitrates: [u32; 2]) -> Self {
        let [bitrate, _] = bitrates;
        let motors = settings.motors.iter().enumerate().filter(|(_, motor)| motor.bus == bus);
        let turn = |(rank, (index, motor)): (usize, (usize, &MotorSettings))| {
            let answering = settings.simulation.get(index).map_or(ANSWERING_TIME, |it| it.reply_latency);
            (settings.first_turn(bus, rank), TransactionBits::of(motor, answering, bitrates))
        };
        let turns: Vec<_> = motors.enumerate().map(turn).collect();
        let cycle = &settings.cycle;
        let deadline = cycle.reply_deadline.as_secs_f64() / cycle.period.as_secs_f64();
        let with_sensors = Self::of_turns(&turns, bitrate, cycle.rate_hz, deadline).with_sensors(
            &SensorLoad::of(settings, bus),
            &turns,
            (bitrate, cycle.rate_hz, deadline),
        );
        let motors = settings.motors.iter().filter(|motor| motor.bus == bus);
        let frames = motors.flat_map(|motor| motor.protocol.family().reports);
        with_sensors.with_reports(frames, bitrates)
    }

    /// Adds the frames that motors send by themselves.
    fn with_reports<'f>(self, frames: impl Iterator<Item = &'f UnpromptedFrame>, bitrates: [u32; 2]) -> Self {
        let shares = frames.map(|frame| {
            let length = frame.length;
            [length.worst_case(), length.unstuffed(), length.expected()]
                .map(|bits| utilisation(bits.at(bitrates[0], bitrates[1]), frame.rate_hz, bitrates[0]))
        });
        let add = |[a, b, c]: [f64; 3], [d, e, f]: [f64; 3]| [a + d, b + e, c + f];
        let [worst, unstuffed, expected] = shares.fold([0.0; 3], add);
        let left = 1.0 - expected.min(REPORTS_MAX);
        Self {
            worst_case_utilisation: self.worst_case_utilisation + worst,
            unstuffed_utilisation: self.unstuffed_utilisation + unstuffed,
            unprompted_utilisation: worst,
            fault_poll_utilisation: self.fault_poll_utilisation + worst,
            last_reply: self.last_reply.div_f64(left),
            imu_time: self.imu_time.div_f64(left),
            rate_hz_max: self.rate_hz_max * left,
            ..self
        }
    }

    /// Adds the frames of sensors. The cycle that asks them is the fullest; frames without a
    /// request are spread over all.
    fn with_sensors(
        self,
        sensors: &SensorLoad,
        turns: &[(u32, TransactionBits)],
        (bitrate, rate_hz, deadline): (u32, f64, f64),
    ) -> Self {
        if *sensors == SensorLoad::default() {
            return self;
        }
        let part = |asked: u32, sent: f64| utilisation(asked, rate_hz, bitrate) + sent / f64::from(bitrate);
        let worst = part(sensors.asked_worst, sensors.sent_worst);
        let cycles = turns.iter().map(|(cycle, _)| *cycle).chain([0]);
        let last_reply =
            cycles.map(|cycle| last_reply(turns, cycle, bitrate, sensors)).max().unwrap_or_default();
        let rate_hz_max =
            if last_reply.is_zero() { f64::INFINITY } else { deadline / last_reply.as_secs_f64() };
        Self {
            worst_case_utilisation: self.worst_case_utilisation + worst,
            unstuffed_utilisation: self.unstuffed_utilisation
                + part(sensors.asked_unstuffed, sensors.sent_unstuffed),
            fault_poll_utilisation: self.fault_poll_utilisation + worst,
            imu_time: last_reply.saturating_sub(self.last_reply),
            last_reply,
            rate_hz_max,
            ..self
        }
    }

    /// Of transactions with their cycles. `deadline` is the reply deadline as a fraction of the
    /// period.
    fn of_turns(turns: &[(u32, TransactionBits)], bitrate: u32, rate_hz: f64, deadline: f64) -> Self {
        let transactions = || turns.iter().map(|(_, transaction)| transaction);
        let fullest = |bits: fn(&TransactionBits) -> u32| {
            let in_cycle = |cycle| turns.iter().filter(move |(other, _)| *other == cycle);
            let load = |cycle| in_cycle(cycle).map(|(_, transaction)| bits(transaction)).sum();
            turns.iter().map(|(cycle, _)| load(*cycle)).max().unwrap_or(0)
        };
        let (worst_case, unstuffed) = (fullest(|it| it.worst_case), fullest(|it| it.unstuffed));
        let fault_poll = transactions().map(|transaction| transaction.worst_case).max().unwrap_or(0);
        let least = transactions().map(|transaction| transaction.unstuffed).min().unwrap_or(0);
        let answering = transactions().map(|transaction| transaction.answering).max().unwrap_or_default();
        let transaction_worst = wire_time(fault_poll, bitrate);
        let none = SensorLoad::default();
        let last_reply = turns.iter().map(|(cycle, _)| last_reply(turns, *cycle, bitrate, &none)).max();
        let last_reply = last_reply.unwrap_or_default();
        Self {
            motors: turns.len(),
            worst_case_utilisation: utilisation(worst_case, rate_hz, bitrate),
            unstuffed_utilisation: utilisation(unstuffed, rate_hz, bitrate),
            unprompted_utilisation: 0.0,
            fault_poll_utilisation: utilisation(worst_case + fault_poll, rate_hz, bitrate),
            imu_time: Duration::ZERO,
            transaction_least: wire_time(least, bitrate),
            transaction_worst,
            question: transaction_worst + answering,
            every_least: 1,
            last_reply,
            rate_hz_max: deadline / last_reply.as_secs_f64(),
        }
    }

    fn of_line(settings: &Settings, bus: usize, baud: u32, turnaround: Duration) -> Self {
        let motors = settings.motors.iter().filter(|motor| motor.bus == bus).count();
        let (turns, period) = (settings.turns(bus), settings.cycle.period);
        let wire = wire_time(2 * SERIAL_FRAME_BITS, baud);
        let turn = wire + turnaround;
        let round = f64::from(settings.buses[bus].every.get()) * period.as_secs_f64();
        let share = |count: usize, time: Duration| count as f64 * time.as_secs_f64() / round;
        let cycles = turn.as_nanos().div_ceil(period.as_nanos());
        Self {
            motors,
            worst_case_utilisation: share(motors, turn),
            unstuffed_utilisation: share(motors, wire),
            unprompted_utilisation: 0.0,
            fault_poll_utilisation: share(turns, turn),
            imu_time: Duration::ZERO,
            transaction_least: wire,
            transaction_worst: turn,
            question: turn,
            every_least: u32::try_from(cycles * turns as u128).unwrap_or(u32::MAX).max(1),
            last_reply: turn,
            rate_hz_max: (settings.buses[bus].every.get() as usize / turns.max(1)) as f64
                / turn.as_secs_f64(),
        }
    }
}

/// When the last reply to the commands of `cycle` is expected. The commands occupy the bus first,
/// one after the other; then the replies, each when its motor has it ready. Requests to IMUs follow
/// the commands. Zero for a cycle without a request.
fn last_reply(turns: &[(u32, TransactionBits)], cycle: u32, bitrate: u32, sensors: &SensorLoad) -> Duration {
    let asked = turns.iter().filter(|(other, _)| *other == cycle).map(|(_, transaction)| transaction);
    let motors = asked.map(|transaction| (transaction.command, transaction.reply, transaction.answering));
    let asked = sensors.asked.iter().map(|[request, reply]| (*request, *reply, ANSWERING_TIME));
    let requests: Vec<_> = motors.chain(asked).collect();
    if requests.is_empty() {
        return Duration::ZERO;
    }
    let mut free = HOST_TIME + wire_time(requests.iter().map(|(request, ..)| request).sum(), bitrate);
    let mut received = HOST_TIME;
    for (request, reply, answering) in requests {
        received += wire_time(request, bitrate);
        free = free.max(received + answering) + wire_time(reply, bitrate);
    }
    free + wire_time(sensors.blocking, bitrate)
}

/// Bits of a command and its reply, and the time between them.
struct TransactionBits {
    worst_case: u32,
    unstuffed: u32,
    /// Of the command alone, as expected.
    command: u32,
    /// Of the reply alone, as expected.
    reply: u32,
    /// Time that the motor needs from the end of a command to the beginning of its reply.
    answering: Duration,
}

impl TransactionBits {
    /// `bitrates` are those of arbitration and of the payloads of CAN FD, bit/s.
    fn of(motor: &MotorSettings, answering: Duration, bitrates: [u32; 2]) -> Self {
        let frames = motor.frame_lengths();
        let bits = |length: fn(FrameLength) -> FdBits| {
            frames.map(|frame| length(frame).at(bitrates[0], bitrates[1]))
        };
        let [command, reply] = bits(FrameLength::expected);
        Self {
            worst_case: bits(FrameLength::worst_case).iter().sum(),
            unstuffed: bits(FrameLength::unstuffed).iter().sum(),
            command,
            reply,
            answering,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn mit(cycle: u32) -> (u32, TransactionBits) {
        let answering = Duration::from_micros(50);
        (cycle, TransactionBits { worst_case: 250, unstuffed: 206, command: 129, reply: 110, answering })
    }

    #[test]
    fn three_mit_motors_fill_bus_with_fault_poll() {
        let plan = BusPlan::of_turns(&[mit(0), mit(0), mit(0)], 1_000_000, 1000.0, 0.8);
        assert_eq!((plan.worst_case_utilisation, plan.unstuffed_utilisation), (0.75, 0.618));
        assert_eq!(plan.fault_poll_utilisation, 1.0);
        assert_eq!(plan.transaction_least, Duration::from_micros(206));
    }

    /// 12 motors at 500 kbit/s: 110 frames a second of 111 bits each are 29 % without stuff bits, and
    /// 36 % with 135.
    #[test]
    fn unprompted_frames_lengthen_cycles() {
        let frames =
            [10.0, 100.0].map(|rate_hz| UnpromptedFrame { length: FrameLength::classic(8), rate_hz });
        let plan = BusPlan::of_turns(&[mit(0)], 500_000, 100.0, 0.8);
        let alone = (plan.last_reply, plan.worst_case_utilisation, plan.rate_hz_max);
        let plan = plan.with_reports([frames; 12].as_flattened().iter(), [500_000; 2]);
        assert!((plan.unprompted_utilisation - 12.0 * 110.0 * 135.0 / 5e5).abs() < 1e-9);
        assert!((plan.worst_case_utilisation - alone.1 - plan.unprompted_utilisation).abs() < 1e-9);
        let left = 1.0 - 12.0 * 110.0 * 129.0 / 5e5;
        let longer = plan.last_reply.as_secs_f64() / alone.0.as_secs_f64();
        assert!((longer * left - 1.0).abs() < 1e-3, "{longer} {left}");
        assert!((plan.rate_hz_max / alone.2 - left).abs() < 1e-9);
    }

    #[test]
    fn a_bus_without_motors_needs_nothing() {
        let plan = BusPlan::of_turns(&[], 1_000_000, 1000.0, 0.8);
        assert_eq!((plan.fault_poll_utilisation, plan.transaction_least), (0.0, Duration::ZERO));
    }

    #[test]
    fn motors_in_turns_need_bus_in_own_cycles() {
        let plan = BusPlan::of_turns(&[mit(0), mit(1), mit(0), mit(1)], 1_000_000, 1000.0, 0.8);
        assert_eq!((plan.motors, plan.worst_case_utilisation), (4, 0.5));
        assert_eq!(plan.fault_poll_utilisation, 0.75);
    }

    /// Commands of 129 bits and replies of 110, with ¾ of the stuff bits; 20 µs of the host.
    #[test]
    fn answering_time_counts_only_on_idle_bus() {
        let last = |turns: &[_]| BusPlan::of_turns(turns, 1_000_000, 1000.0, 0.8).last_reply;
        assert_eq!(last(&[mit(0)]), Duration::from_micros(20 + 129 + 50 + 110));
        assert_eq!(last(&[mit(0), mit(0), mit(0)]), Duration::from_micros(20 + 3 * 129 + 3 * 110));
        assert_eq!(last(&[mit(0), mit(1)]), last(&[mit(0)]));
    }

    #[test]
    fn highest_rate_puts_last_reply_at_deadline() {
        let rate_hz_max = |turns: &[_]| BusPlan::of_turns(turns, 1_000_000, 1000.0, 0.8).rate_hz_max.floor();
        assert_eq!(rate_hz_max(&[mit(0)]), 2588.0);
        assert_eq!(rate_hz_max(&[mit(0), mit(0), mit(0)]), 1085.0);
        assert_eq!(rate_hz_max(&[]), f64::INFINITY);
    }
}
