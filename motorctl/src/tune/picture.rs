//! The picture of `motorctl tune`: the mean response before and with the proposal, and its torque.

use crate::tune::report::{Measured, Report};
use motord_record::{Curve, Layout, Panel, Row};

const LAYOUT: Layout =
    Layout { panel: (760, 300), time: "time since the step, s", has_tall_legend: true, stroke: 2 };

/// Draws the report as an SVG.
///
/// # Errors
///
/// The error of the drawing library.
pub(crate) fn svg(report: &Report) -> Result<Vec<u8>, String> {
    Ok(motord_record::svg(&rows(report), LAYOUT)?.into_bytes())
}

/// Draws the report as a PNG.
///
/// # Errors
///
/// The error of the encoder.
pub(crate) fn png(report: &Report) -> Result<Vec<u8>, String> {
    motord_record::png(&rows(report), LAYOUT)
}

fn rows(report: &Report) -> [Row; 2] {
    let (before, after) = (&report.before, report.after.as_ref());
    let names = || {
        let height = before.curve.last().map_or(0.0, |point| point.target);
        let after = after.map_or_else(String::new, |after| legend("proposed", after));
        [format!("setpoint: {height:.3} rad"), legend("before", before), after]
    };
    let mut position = Panel {
        title: format!("{}: angle since the step, rad", report.joint),
        curves: names().map(Curve::new),
    };
    let mut torque = Panel {
        title: format!("{}: torque in the direction of the step, N·m", report.joint),
        curves: names().map(Curve::new),
    };
    for point in &before.curve {
        position.curves[0].take(point.time, Some(point.target as f32));
    }
    for (index, measured) in [(1, Some(before)), (2, after)] {
        for point in measured.into_iter().flat_map(|measured| &measured.curve) {
            position.curves[index].take(point.time, Some(point.position as f32));
            torque.curves[index].take(point.time, Some(point.torque as f32));
        }
    }
    [position, torque].map(|panel| Row { panels: vec![panel], marks: Vec::new() })
}

/// The name of a curve, with its numbers.
fn legend(which: &str, of: &Measured) -> String {
    let rise = of.rise_ms.map_or_else(String::new, |rise| format!("rise {rise:.0} ms, "));
    let ring = of.ring_hz.zip(of.damping_ratio).map_or_else(String::new, |(frequency, ratio)| {
        format!(", ring {frequency:.1} Hz, damping ratio {ratio:.2}")
    });
    format!("{which}: kp {:.1}, kd {:.2}: {rise}overshoot {:.0} %{ring}", of.kp, of.kd, of.overshoot_percent)
}
