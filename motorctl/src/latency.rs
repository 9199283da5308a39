//! `motorctl latency`: percentiles of all latencies since the daemon started.

use crate::failure::Failure;
use motord_client::{Client, Percentiles, RobotDescription, Telemetry};
use motord_terminal::{Cell, Palette, Table, json};
use serde_json::{Value, json};
use std::io::{self, Write};

/// Prints the percentiles.
///
/// # Errors
///
/// When no daemon answers, or the output cannot be written.
pub(crate) fn run(instance: &str, as_json: bool) -> Result<(), Failure> {
    let client = Client::connect(instance)?;
    let telemetry = client.telemetry()?;
    let out = &mut io::stdout().lock();
    if as_json {
        json::write_line(out, &object(&client.description(), &telemetry))?;
    } else {
        write(out, &client.description(), &telemetry)?;
    }
    Ok(())
}

/// Percentiles of latencies under a name each, µs.
pub(crate) fn table(rows: &[(&str, Percentiles)]) -> Table {
    let mut table = Table::new(&["µs", "p50", "p99", "p99.9", "max", "count"]);
    for (name, latency) in rows {
        let values = [latency.p50, latency.p99, latency.p99_9, latency.max];
        let mut cells = vec![Cell::plain(name)];
        // Percentiles of nothing are not 0 µs.
        cells.extend(values.map(|value| Cell::number((latency.count > 0).then_some(value), 1)));
        cells.push(Cell::plain(latency.count));
        table.row(cells);
    }
    table
}

fn named<'a>(
    robot: &'a RobotDescription,
    telemetry: &'a Telemetry,
) -> impl Iterator<Item = (&'a str, Percentiles)> {
    robot.joints.iter().map(|joint| joint.name.as_str()).zip(telemetry.joints.iter().copied())
}

fn object(robot: &RobotDescription, telemetry: &Telemetry) -> Value {
    let joints: Vec<Value> = named(robot, telemetry)
        .map(|(name, latency)| json!({ "name": name, "reply_latency_us": latency }))
        .collect();
    let mut object = json!(telemetry);
    // Owners and stops belong to `status`.
    object.as_object_mut().and_then(|object| object.remove("groups"));
    object["instance"] = json!(robot.instance);
    object["joints"] = json!(joints);
    object
}

fn write(out: &mut dyn Write, robot: &RobotDescription, telemetry: &Telemetry) -> io::Result<()> {
    let palette = Palette::of_stdout();
    let rows = [
        ("cycle", telemetry.cycle_us),
        ("wake latency", telemetry.wake_latency_us),
        ("reply latency", telemetry.reply_latency_us),
        ("setpoint age", telemetry.setpoint_age_us),
    ];
    table(&rows).write(out, palette)?;
    writeln!(out, "\nreply latency by joint")?;
    let joints: Vec<_> = named(robot, telemetry).collect();
    table(&joints).write(out, palette)?;
    let Telemetry { cycles, seconds, overruns, missed_replies, dropped_records, .. } = telemetry;
    writeln!(
        out,
        "\n{cycles} cycles in {seconds:.1} s; overruns {overruns}, missed replies {missed_replies}"
    )?;
    if *dropped_records > 0 {
        writeln!(
            out,
            "{dropped_records} records were dropped and are not counted here: the daemon is overloaded"
        )?;
    }
    Ok(())
}
