//! Latencies as tables and as JSON.

use crate::hgrm::Point;
use motord_client::{ControlLatency, NetworkLatency, Percentiles, RobotDescription, Telemetry};
use motord_terminal::{Cell, Palette, Table};
use std::io::{self, Write};

/// Returns a table of named latencies, µs.
#[must_use]
pub fn percentiles(rows: &[(&str, Percentiles)]) -> Table {
    let mut table = Table::new(&["µs", "p50", "p99", "p99.9", "max", "count"]);
    for (name, latency) in rows {
        let values = [latency.p50, latency.p99, latency.p99_9, latency.max];
        let mut cells = vec![Cell::plain(name)];
        // Without a sample there are no percentiles.
        cells.extend(values.map(|value| Cell::number((latency.count > 0).then_some(value), 1)));
        cells.push(Cell::plain(latency.count));
        table.row(cells);
    }
    table
}

/// Returns the percentiles of a percentile file: the value of the first step that reaches each.
pub(crate) fn points(points: &[Point]) -> Table {
    let at = |share: f64| points.iter().find(|point| point.share >= share).map(|point| point.value);
    let mut table = Table::new(&["µs", "p50", "p99", "p99.9", "max"]);
    let mut cells = vec![Cell::plain("percentile file")];
    cells.extend([0.5, 0.99, 0.999, 1.0].map(|share| Cell::number(at(share), 1)));
    table.row(cells);
    table
}

fn named<'a>(
    robot: &'a RobotDescription,
    telemetry: &'a Telemetry,
) -> impl Iterator<Item = (&'a str, Percentiles)> {
    robot.joints.iter().map(|joint| joint.name.as_str()).zip(telemetry.joints.iter().copied())
}

/// Returns the ages of the samples of the IMUs by name.
fn imus<'a>(
    robot: &'a RobotDescription,
    telemetry: &'a Telemetry,
) -> impl Iterator<Item = (&'a str, Percentiles)> {
    robot.imus.iter().map(|imu| imu.name.as_str()).zip(telemetry.imus.iter().copied())
}

/// Returns the control latencies of the groups by name.
fn controlled<'a>(
    robot: &'a RobotDescription,
    telemetry: &'a Telemetry,
) -> impl Iterator<Item = (&'a str, &'a ControlLatency)> {
    robot.groups.iter().map(|group| group.name.as_str()).zip(&telemetry.control)
}

/// Returns the setpoints of each group by the cycle that first used them, counted from the states
/// that they answer.
fn control_table(robot: &RobotDescription, telemetry: &Telemetry) -> Table {
    let mut table = Table::new(&["group", "next cycle", "2nd", "3rd", "later", "late %"]);
    for (name, latency) in controlled(robot, telemetry) {
        let of = |cycles: usize| latency.cycles.get(cycles).copied().unwrap_or_default();
        let all: u64 = latency.cycles.iter().sum();
        let late = (all > 0).then(|| 100.0 * (all - of(0)) as f64 / all as f64);
        let counts = [of(0), of(1), of(2), latency.cycles.iter().skip(3).sum()];
        let mut cells = vec![Cell::plain(name)];
        cells.extend(counts.map(Cell::plain));
        cells.push(Cell::number(late, 1));
        table.row(cells);
    }
    table
}

/// Writes all tables.
pub(crate) fn write(out: &mut dyn Write, robot: &RobotDescription, telemetry: &Telemetry) -> io::Result<()> {
    let palette = Palette::of_stdout();
    let mut rows = vec![
        ("cycle", telemetry.cycle_us),
        ("wake latency", telemetry.wake_latency_us),
        ("transmit", telemetry.transmit_us),
        ("reply latency", telemetry.reply_latency_us),
        ("setpoint age", telemetry.setpoint_age_us),
        ("control latency", telemetry.control_latency_us),
        ("last reply to states", telemetry.publication_us),
        ("states to clients", telemetry.delivery_us),
    ];
    if telemetry.polled_us.count > 0 {
        rows.push(("polled for replies", telemetry.polled_us));
    }
    percentiles(&rows).write(out, palette)?;
    writeln!(out, "\nsetpoints by the cycle that used them, after that of the states they answer")?;
    control_table(robot, telemetry).write(out, palette)?;
    let imus: Vec<_> = imus(robot, telemetry).collect();
    if !imus.is_empty() {
        writeln!(out, "\nage of the newest sample of each IMU in the states")?;
        percentiles(&imus).write(out, palette)?;
    }
    if let Some(network) = &telemetry.network {
        writeln!(out, "\nnetwork between the robot and this computer")?;
        network_table(network).write(out, palette)?;
    }
    writeln!(out, "\nreply latency by joint")?;
    let joints: Vec<_> = named(robot, telemetry).collect();
    percentiles(&joints).write(out, palette)?;
    write_counters(out, telemetry)
}

fn network_table(network: &NetworkLatency) -> Table {
    percentiles(&[
        ("round trip", network.round_trip_us),
        ("age of states", network.state_age_us),
        ("between states", network.state_interval_us),
    ])
}

fn write_counters(out: &mut dyn Write, telemetry: &Telemetry) -> io::Result<()> {
    let Telemetry { cycles, seconds, overruns, missed_replies, dropped_records, .. } = telemetry;
    writeln!(
        out,
        "\n{cycles} cycles in {seconds:.1} s; missed ticks {overruns}, missed replies {missed_replies}"
    )?;
    if telemetry.polled_us.count > 0 {
        let Telemetry { polled_us, polled_reads, polled_in_vain, .. } = telemetry;
        let cycles = polled_us.count;
        writeln!(
            out,
            "polled for replies in {cycles} cycles, {polled_in_vain} without a reply; {polled_reads} reads"
        )?;
    }
    if let Some(network) = &telemetry.network {
        writeln!(out, "{} states lost on the network, {} frames refused", network.lost, network.refused)?;
    }
    if *dropped_records > 0 {
        writeln!(
            out,
            "{dropped_records} records were dropped and are not counted here: the daemon is overloaded"
        )?;
    }
    Ok(())
}
