//! Findings and measurement as text and as JSON.

use crate::finding::{Finding, Level};
use crate::process::RunningDaemon;
use crate::robot::Robot;
use crate::tune::Tuned;
use crate::wake::{self, Wake};
use motord_terminal::{Cell, Colour, Palette};
use serde::Serialize;
use std::io::{self, Write};

/// Length of the longest bar, characters.
const BAR: f64 = 40.0;
/// The indent of texts.
const INDENT: &str = "      ";

/// The output of the command.
#[derive(Debug, Serialize)]
pub(crate) struct Diagnosis {
    /// The worst of all findings and of the measurement.
    pub(crate) verdict: Level,
    rate_hz: f64,
    /// The processor of the cycle; `null` for any.
    cpu: Option<usize>,
    priority: u8,
    /// The changes that were made or tried before the checks.
    tuned: Vec<Tuned>,
    findings: Vec<Finding>,
    /// `null` without a measurement.
    wake: Option<WakeReport>,
    /// The process of the daemon because of which the measurement was skipped.
    daemon: Option<u32>,
}

/// The measurement.
#[derive(Debug, Serialize)]
struct WakeReport {
    level: Level,
    period_us: f64,
    wake_latency_us: WakePercentiles,
    missed_ticks: u64,
    /// Privileges of the cycle that the measurement lacked.
    refused: Vec<&'static str>,
    histogram: Vec<Bar>,
}

/// The keys are those of `motorctl latency --json`.
#[derive(Debug, Serialize)]
struct WakePercentiles {
    p50: f64,
    p99: f64,
    p99_9: f64,
    max: f64,
    count: u64,
}

/// The ticks above the last bar's latency, up to this bar's.
#[derive(Debug, Serialize)]
struct Bar {
    up_to_us: u64,
    count: u64,
}

impl WakeReport {
    fn new(wake: &Wake) -> Self {
        let [p50, p99, p99_9] = [0.5, 0.99, 0.999].map(|share| wake.quantile_us(share));
        Self {
            level: wake.level(),
            period_us: wake.period.as_nanos() as f64 / 1e3,
            wake_latency_us: WakePercentiles {
                p50,
                p99,
                p99_9,
                max: wake.max_us(),
                count: wake.latencies.len(),
            },
            missed_ticks: wake.missed,
            refused: wake.refused().map(|step| step.what).collect(),
            histogram: wake::bars(&wake.latencies)
                .into_iter()
                .map(|(up_to_us, count)| Bar { up_to_us, count })
                .collect(),
        }
    }
}

impl Diagnosis {
    /// Builds the output. `daemon` is the reason for a skipped measurement.
    pub(crate) fn new(
        robot: &Robot,
        tuned: Vec<Tuned>,
        findings: Vec<Finding>,
        wake: Option<&Wake>,
        daemon: Option<RunningDaemon>,
    ) -> Self {
        let wake = wake.map(WakeReport::new);
        let levels = findings.iter().map(|finding| finding.level);
        let verdict = levels.chain(wake.as_ref().map(|wake| wake.level)).max().unwrap_or(Level::Good);
        Self {
            verdict,
            rate_hz: robot.rate_hz,
            cpu: robot.request.cpu,
            priority: robot.priority(),
            tuned,
            findings,
            wake,
            daemon: daemon.map(|daemon| daemon.pid),
        }
    }

    /// Writes it as text.
    ///
    /// # Errors
    ///
    /// When `out` cannot be written.
    pub(crate) fn write(&self, out: &mut dyn Write, palette: Palette) -> io::Result<()> {
        let Self { rate_hz, cpu, priority, .. } = self;
        let cpu = cpu.map_or_else(|| "any processor".to_owned(), |cpu| format!("processor {cpu}"));
        writeln!(out, "A cycle of {rate_hz} Hz at SCHED_FIFO {priority} on {cpu}\n")?;
        self.tuned.iter().try_for_each(|tuned| write_tuned(tuned, out, palette))?;
        let width = self.findings.iter().map(|finding| name(finding).chars().count()).max().unwrap_or(0);
        for finding in &self.findings {
            write_finding(finding, width, out, palette)?;
        }
        match (&self.wake, self.daemon) {
            (Some(wake), _) => write_wake(wake, out, palette)?,
            (None, Some(pid)) => writeln!(
                out,
                "\nThe wake-up latency was not measured, because motord runs (process {pid}): `motorctl latency` shows that of its cycle."
            )?,
            (None, None) => {}
        }
        writeln!(out, "\nverdict: {}", palette.paint(&Cell::new(self.verdict.name(), colour(self.verdict))))
    }
}

fn colour(level: Level) -> Colour {
    match level {
        Level::Good => Colour::Plain,
        Level::Warn => Colour::Magenta,
        Level::Bad => Colour::Red,
    }
}

fn name(finding: &Finding) -> String {
    match &finding.of {
        Some(of) => format!("{of} {}", finding.check),
        None => finding.check.to_owned(),
    }
}

fn write_tuned(Tuned { command, error }: &Tuned, out: &mut dyn Write, palette: Palette) -> io::Result<()> {
    let Some(error) = error else { return writeln!(out, "done  $ {command}") };
    let word = palette.paint(&Cell::new("fail", Colour::Red));
    writeln!(out, "{word}  $ {command}\n{INDENT}{error}")
}

fn write_finding(finding: &Finding, width: usize, out: &mut dyn Write, palette: Palette) -> io::Result<()> {
    let Finding { level, measured, why, command, .. } = finding;
    let word = palette.paint(&Cell::new(format!("{:4}", level.name()), colour(*level)));
    let mut lines = measured.lines();
    writeln!(out, "{word}  {:width$}  {}", name(finding), lines.next().unwrap_or_default())?;
    for line in lines.chain(why.as_deref()) {
        writeln!(out, "{INDENT}{line}")?;
    }
    command.iter().try_for_each(|command| writeln!(out, "{INDENT}$ {command}"))
}

fn write_wake(wake: &WakeReport, out: &mut dyn Write, palette: Palette) -> io::Result<()> {
    let WakeReport { level, period_us, wake_latency_us: latency, missed_ticks, refused, histogram } = wake;
    let word = palette.paint(&Cell::new(format!("{:4}", level.name()), colour(*level)));
    let WakePercentiles { p50, p99, p99_9, max, count } = latency;
    writeln!(
        out,
        "\n{word}  wake-up latency of {count} ticks: p50 {p50:.1} µs, p99 {p99:.1}, p99.9 {p99_9:.1} ({:.1} % of the period), \
         max {max:.1} ({:.1} %), {missed_ticks} ticks missed",
        100.0 * p99_9 / period_us,
        100.0 * max / period_us
    )?;
    if !refused.is_empty() {
        writeln!(
            out,
            "{INDENT}measured without: {}; the daemon may have more rights than you",
            refused.join(", ")
        )?;
        writeln!(out, "{INDENT}$ sudo motorctl doctor")?;
    }
    writeln!(out, "\n{INDENT}  up to µs      ticks  (lengths are logarithmic)")?;
    let most = histogram.iter().map(|bar| bar.count).max().unwrap_or(0);
    for Bar { up_to_us, count } in histogram {
        writeln!(out, "{INDENT}{up_to_us:>10} {count:>10}  {}", bar(*count, most))?;
    }
    Ok(())
}

/// Draws a bar with the length of the logarithm of its count, so that one late tick in a million is
/// visible.
fn bar(count: u64, most: u64) -> String {
    let length = |count: u64| (count as f64).ln_1p();
    let letters = BAR * length(count) / length(most).max(1.0);
    "#".repeat(letters.ceil() as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(findings: Vec<Finding>) -> Diagnosis {
        Diagnosis {
            verdict: Level::Warn,
            rate_hz: 1000.0,
            cpu: Some(3),
            priority: 80,
            tuned: vec![Tuned { command: "sudo tee x".to_owned(), error: None }],
            findings,
            wake: Some(WakeReport {
                level: Level::Good,
                period_us: 1000.0,
                wake_latency_us: WakePercentiles { p50: 4.0, p99: 9.0, p99_9: 20.0, max: 30.0, count: 11 },
                missed_ticks: 0,
                refused: Vec::new(),
                histogram: vec![Bar { up_to_us: 5, count: 10 }, Bar { up_to_us: 10, count: 1 }],
            }),
            daemon: None,
        }
    }

    #[test]
    fn bad_finding_shows_reason_and_command() {
        let findings = vec![
            Finding::good("kernel", "6.1.0-rt"),
            Finding::warn("governor", "powersave", "the clock falls")
                .mended_by("tee x".to_owned())
                .of("cpu3"),
        ];
        let mut out = Vec::new();
        report(findings).write(&mut out, Palette::of_stdout()).unwrap();
        let text = String::from_utf8(out).unwrap();
        let expected = "A cycle of 1000 Hz at SCHED_FIFO 80 on processor 3\n\n\
            done  $ sudo tee x\n\
            good  kernel         6.1.0-rt\n\
            warn  cpu3 governor  powersave\n      the clock falls\n      $ tee x\n\n\
            good  wake-up latency of 11 ticks: p50 4.0 µs, p99 9.0, p99.9 20.0 (2.0 % of the period), max 30.0 (3.0 %), 0 ticks missed\n";
        assert!(text.starts_with(expected), "{text}");
        assert!(text.ends_with("\n\nverdict: warn\n"), "{text}");
    }

    #[test]
    fn one_late_tick_among_many_has_a_bar() {
        assert_eq!(bar(1_000_000, 1_000_000).len(), 40);
        assert!(bar(1, 1_000_000).len() >= 2);
        assert_eq!(bar(0, 0), "");
    }
}
