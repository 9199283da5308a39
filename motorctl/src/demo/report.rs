//! The result of a demo run, and its verdict.

use crate::demo::tracking::Tracking;
use motord_client::{Percentiles, RobotDescription, Telemetry};
use motord_latency::percentile_table;
use motord_terminal::{Cell, Colour, Palette, Table};
use serde::Serialize;
use std::io::{self, Write};

/// Largest relative difference between the measured and the configured rate of ticks.
const RATE_TOLERANCE: f64 = 0.01;
/// Largest share of missed ticks, and of replies that late cycles may miss. A shared machine stalls now and then, and the demo judges motord,
/// not the machine.
const MISSED_TICKS_MAX: f64 = 0.1;
/// Share of missed ticks above which a good run reports them.
const MISSED_TICKS_WORTH_TELLING: f64 = 0.01;
/// Largest tracking error of the trot, rad RMS, of the worst joint.
const TRACKING_RMS_MAX: f64 = 0.05;

/// The run, as `--json` prints it.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct DemoReport {
    /// True if the run is within all limits.
    pub(crate) passed: bool,
    /// The reasons of a failure; an overload of the computer first.
    pub(crate) failures: Vec<String>,
    /// Motors that moved and answered.
    pub(crate) motors: usize,
    /// Time from the daemon's first cycle to its last, s.
    pub(crate) seconds: f64,
    /// Cycles that were run.
    pub(crate) cycles: u64,
    /// Cycles per second that were run.
    pub(crate) rate_hz: f64,
    /// Replies that did not arrive within their cycle.
    pub(crate) missed_replies: u64,
    /// Ticks that were missed.
    pub(crate) overruns: u64,
    /// Tracking error of the worst joint, rad RMS.
    pub(crate) tracking_rms_rad: f64,
    /// Largest tracking error of any joint, rad.
    pub(crate) tracking_max_rad: f64,
    /// From the beginning of a cycle to the publication of its states.
    pub(crate) cycle_us: Percentiles,
    /// From a tick to the beginning of its cycle.
    pub(crate) wake_latency_us: Percentiles,
    /// From a command to its reply.
    pub(crate) reply_latency_us: Percentiles,
    /// From the sending of a setpoint to the cycle that used it.
    pub(crate) setpoint_age_us: Percentiles,
    /// Joint by joint.
    pub(crate) joints: Vec<JointTracking>,
}

/// The result of one joint.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct JointTracking {
    /// Its name.
    pub(crate) name: String,
    /// Tracking error, rad RMS.
    pub(crate) tracking_rms_rad: f64,
    /// Largest tracking error, rad.
    pub(crate) tracking_max_rad: f64,
    /// From a command to its reply.
    pub(crate) reply_latency_us: Percentiles,
}

/// A limit that a run exceeded.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub(crate) enum Shortfall {
    /// A motor did not take part.
    #[error("{received} of {expected} motors took part")]
    Motors { expected: usize, received: usize },
    /// The time grid is off.
    #[error("the ticks came at {received:.1} Hz instead of {expected:.1} Hz")]
    Rate { expected: f64, received: f64 },
    /// Too many ticks passed without a cycle.
    #[error("{missed} of {ticks} ticks were missed: is the computer overloaded?")]
    MissedTicks { missed: u64, ticks: u64 },
    /// More replies were missed than missed ticks and late cycles explain.
    #[error("{0} replies did not arrive within their cycle")]
    MissedReplies(u64),
    /// A joint was too far from its setpoint.
    #[error("the tracking error is {received:.3} rad RMS; it must be below {expected:.3} rad RMS")]
    Tracking { expected: f64, received: f64 },
}

impl DemoReport {
    /// Builds the report from the tracking and the daemon's telemetry.
    pub(crate) fn new(robot: &RobotDescription, telemetry: &Telemetry, tracking: &[Tracking]) -> Self {
        let joint = |(index, tracking): (usize, &Tracking)| JointTracking {
            name: robot.joints.get(index).map_or_else(String::new, |joint| joint.name.clone()),
            tracking_rms_rad: tracking.rms(),
            tracking_max_rad: tracking.max,
            reply_latency_us: telemetry.joints.get(index).copied().unwrap_or_default(),
        };
        let worst = |error: fn(&Tracking) -> f64| tracking.iter().map(error).fold(0.0, worse);
        Self {
            passed: false,
            failures: Vec::new(),
            motors: tracking.iter().filter(|tracking| tracking.samples > 0).count(),
            seconds: telemetry.seconds,
            cycles: telemetry.cycles,
            rate_hz: telemetry.cycles.saturating_sub(1) as f64 / telemetry.seconds,
            missed_replies: telemetry.missed_replies,
            overruns: telemetry.overruns,
            tracking_rms_rad: worst(Tracking::rms),
            tracking_max_rad: worst(|tracking| tracking.max),
            cycle_us: telemetry.cycle_us,
            wake_latency_us: telemetry.wake_latency_us,
            reply_latency_us: telemetry.reply_latency_us,
            setpoint_age_us: telemetry.setpoint_age_us,
            joints: tracking.iter().enumerate().map(joint).collect(),
        }
    }

    /// Sets the verdict of a run on `robot`, with an `overload` of the computer. Returns the
    /// exceeded limits.
    pub(crate) fn conclude(&mut self, robot: &RobotDescription, overload: Option<&str>) -> Vec<Shortfall> {
        let shortfalls = self.shortfalls(robot);
        self.passed = shortfalls.is_empty();
        self.failures = failures(overload, &shortfalls);
        shortfalls
    }

    /// Returns the exceeded limits; none after a good run.
    fn shortfalls(&self, robot: &RobotDescription) -> Vec<Shortfall> {
        let (motors, rate) = (robot.joints.len(), robot.rate_hz);
        let (ticks, missed) = (self.ticks(), self.overruns);
        let tick_rate = ticks.saturating_sub(1) as f64 / self.seconds;
        // NaN fails these comparisons.
        let on_grid = (tick_rate - rate).abs() <= RATE_TOLERANCE * rate;
        let on_track = self.tracking_rms_rad < TRACKING_RMS_MAX;
        let checks = [
            // An overloaded computer explains the others.
            (missed as f64 <= MISSED_TICKS_MAX * ticks as f64, Shortfall::MissedTicks { missed, ticks }),
            (on_grid, Shortfall::Rate { expected: rate, received: tick_rate }),
            (self.motors == motors, Shortfall::Motors { expected: motors, received: self.motors }),
            (
                self.missed_replies <= self.excused_replies(robot),
                Shortfall::MissedReplies(self.missed_replies),
            ),
            (on_track, Shortfall::Tracking { expected: TRACKING_RMS_MAX, received: self.tracking_rms_rad }),
        ];
        checks.into_iter().filter(|(good, _)| !good).map(|(_, shortfall)| shortfall).collect()
    }

    /// Replies that motord may miss on a computer that is late: each of a missed tick, and a share of all
    /// where the computer ran a cycle so late or so slowly that it ended before the last replies.
    fn excused_replies(&self, robot: &RobotDescription) -> u64 {
        let motors = robot.joints.len() as u64;
        let is_late = (self.wake_latency_us.max + self.cycle_us.max) * robot.rate_hz > 1e6;
        let of_late_cycles =
            if is_late { MISSED_TICKS_MAX * self.ticks() as f64 * motors as f64 } else { 0.0 };
        (self.overruns * motors).max(of_late_cycles as u64)
    }

    /// Ticks of the run, missed ones included.
    fn ticks(&self) -> u64 {
        self.cycles.saturating_add(self.overruns)
    }

    /// Returns the text of a good run, with its missed ticks.
    pub(crate) fn praise(&self) -> String {
        let (missed, ticks) = (self.overruns, self.ticks());
        let share = missed as f64 / ticks as f64;
        if share < MISSED_TICKS_WORTH_TELLING {
            return "PASS".to_owned();
        }
        format!(
            "PASS, but {missed} of {ticks} ticks were missed ({:.1} %): the computer is busy",
            100.0 * share
        )
    }

    /// Writes the run as tables.
    ///
    /// # Errors
    ///
    /// When `out` cannot be written.
    pub(crate) fn write(&self, out: &mut dyn Write, palette: Palette) -> io::Result<()> {
        let mut table = Table::new(&["joint", "tracking RMS rad", "max rad", "reply p50 µs", "p99.9 µs"]);
        for joint in &self.joints {
            let late = joint.tracking_rms_rad >= TRACKING_RMS_MAX;
            table.row(vec![
                Cell::new(&joint.name, if late { Colour::Red } else { Colour::Plain }),
                Cell::number(Some(joint.tracking_rms_rad), 4),
                Cell::number(Some(joint.tracking_max_rad), 4),
                Cell::number(Some(joint.reply_latency_us.p50), 0),
                Cell::number(Some(joint.reply_latency_us.p99_9), 0),
            ]);
        }
        table.write(out, palette)?;
        writeln!(out)?;
        let rows = [
            ("cycle", self.cycle_us),
            ("wake latency", self.wake_latency_us),
            ("reply latency", self.reply_latency_us),
            ("setpoint age", self.setpoint_age_us),
        ];
        percentile_table(&rows).write(out, palette)?;
        let Self { motors, seconds, cycles, rate_hz, missed_replies, overruns, .. } = self;
        writeln!(
            out,
            "\n{motors} motors, {cycles} cycles in {seconds:.1} s: {rate_hz:.1} Hz; missed ticks {overruns}, missed replies \
             {missed_replies}"
        )
    }
}

/// Returns the reasons of a failure as sentences, an overload first; none after a good run.
pub(crate) fn failures(overload: Option<&str>, shortfalls: &[Shortfall]) -> Vec<String> {
    let overload = overload.filter(|_| !shortfalls.is_empty()).map(str::to_owned);
    overload.into_iter().chain(shortfalls.iter().map(ToString::to_string)).collect()
}

/// Returns the larger error; NaN counts as the largest.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_client::JointDescription;

    fn description() -> RobotDescription {
        let joints =
            ["fl-hip", "fl-thigh"].map(|name| JointDescription { name: name.into(), ..Default::default() });
        RobotDescription { rate_hz: 1000.0, joints: joints.into(), ..RobotDescription::default() }
    }

    fn telemetry() -> Telemetry {
        Telemetry { cycles: 3001, seconds: 3.0, ..Telemetry::default() }
    }

    fn tracked(error: f32) -> Tracking {
        let mut tracking = Tracking::default();
        tracking.count(error, 0.0);
        tracking
    }

    fn shortfalls(telemetry: &Telemetry, tracking: &[Tracking]) -> Vec<Shortfall> {
        DemoReport::new(&description(), telemetry, tracking).shortfalls(&description())
    }

    #[test]
    fn a_good_run_has_no_shortfall() {
        assert_eq!(shortfalls(&telemetry(), &[tracked(0.01), tracked(-0.04)]), []);
    }

    #[test]
    fn worst_joint_decides_the_tracking() {
        let report = DemoReport::new(&description(), &telemetry(), &[tracked(0.01), tracked(-0.06)]);
        assert!((report.tracking_rms_rad - 0.06).abs() < 1e-6);
        assert!(matches!(report.shortfalls(&description())[..], [Shortfall::Tracking { .. }]));
    }

    #[test]
    fn a_motor_that_was_never_seen_falls_short() {
        let shortfalls = shortfalls(&telemetry(), &[tracked(0.01), Tracking::default()]);
        assert_eq!(shortfalls[0], Shortfall::Motors { expected: 2, received: 1 });
    }

    #[test]
    fn one_missed_reply_falls_short() {
        let telemetry = Telemetry { missed_replies: 1, ..telemetry() };
        assert_eq!(shortfalls(&telemetry, &[tracked(0.0), tracked(0.0)]), [Shortfall::MissedReplies(1)]);
    }

    #[test]
    fn missed_ticks_excuse_only_their_replies() {
        let stalled = |missed_replies| Telemetry { cycles: 2998, overruns: 3, missed_replies, ..telemetry() };
        let tracking = [tracked(0.0), tracked(0.0)];
        assert_eq!(shortfalls(&stalled(6), &tracking), []);
        assert_eq!(shortfalls(&stalled(7), &tracking), [Shortfall::MissedReplies(7)]);
    }

    #[test]
    fn late_cycle_excuses_a_share_of_replies() {
        let at_most = |max| Percentiles { max, ..Percentiles::default() };
        let late = |wake, missed_replies| Telemetry {
            wake_latency_us: at_most(wake),
            cycle_us: at_most(700.0),
            missed_replies,
            ..telemetry()
        };
        let tracking = [tracked(0.0), tracked(0.0)];
        assert_eq!(shortfalls(&late(299.0, 2), &tracking), [Shortfall::MissedReplies(2)]);
        assert_eq!(shortfalls(&late(301.0, 600), &tracking), []);
        assert_eq!(shortfalls(&late(301.0, 601), &tracking), [Shortfall::MissedReplies(601)]);
    }

    #[test]
    fn wrong_or_unknown_rate_falls_short() {
        for seconds in [2.9, 3.1, 0.0] {
            let telemetry = Telemetry { seconds, ..telemetry() };
            let shortfalls = shortfalls(&telemetry, &[tracked(0.0), tracked(0.0)]);
            assert!(matches!(shortfalls[..], [Shortfall::Rate { .. }]), "{seconds} s");
        }
    }

    #[test]
    fn tenth_of_ticks_may_be_missed_and_reported() {
        let stalled = |overruns| Telemetry { cycles: 3001 - overruns, overruns, ..telemetry() };
        let tracking = [tracked(0.0), tracked(0.0)];
        assert_eq!(shortfalls(&stalled(300), &tracking), []);
        assert_eq!(
            shortfalls(&stalled(301), &tracking),
            [Shortfall::MissedTicks { missed: 301, ticks: 3001 }]
        );
        let praise = |overruns| DemoReport::new(&description(), &stalled(overruns), &tracking).praise();
        assert_eq!(praise(30), "PASS");
        assert_eq!(praise(31), "PASS, but 31 of 3001 ticks were missed (1.0 %): the computer is busy");
    }

    #[test]
    fn overload_is_reported_only_for_failed_runs() {
        let mut report = DemoReport::new(&description(), &telemetry(), &[tracked(0.01), tracked(0.01)]);
        report.conclude(&description(), Some("overloaded"));
        assert!(report.passed && report.failures.is_empty());
        let slow = Telemetry { cycles: 2501, overruns: 500, missed_replies: 1001, ..telemetry() };
        let mut report = DemoReport::new(&description(), &slow, &[tracked(0.01), tracked(0.01)]);
        report.conclude(&description(), Some("overloaded"));
        assert!(!report.passed);
        assert_eq!((report.failures.len(), report.failures[0].as_str()), (3, "overloaded"));
        assert!(report.failures[1].contains("is the computer overloaded?"), "{:?}", report.failures);
    }

    #[test]
    fn the_json_has_the_agreed_keys() {
        let report = DemoReport::new(&description(), &telemetry(), &[tracked(0.01), tracked(0.02)]);
        let json = serde_json::to_value(report).unwrap();
        for key in
            ["motors", "seconds", "cycles", "rate_hz", "missed_replies", "overruns", "tracking_rms_rad"]
        {
            assert!(json[key].is_number(), "{key}");
        }
        for key in ["wake_latency_us", "reply_latency_us", "setpoint_age_us", "cycle_us"] {
            for percentile in ["p50", "p99", "p99_9", "max"] {
                assert!(json[key][percentile].is_number(), "{key}.{percentile}");
            }
        }
    }
}
