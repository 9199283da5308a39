//! Curves over time as an SVG: a row for each joint, a panel for each quantity.

use plotters::coord::Shift;
use plotters::prelude::{
    BLACK, ChartBuilder, DrawingArea, IntoDrawingArea, LineSeries, PathElement, RGBColor, SVGBackend,
    SeriesLabelPosition, WHITE,
};
use plotters::style::Color;
use std::error::Error;
use std::ops::Range;

/// The size of a panel.
const PANEL: (u32, u32) = (480, 260);
/// Limit on the steps of a curve: more than a panel has pixels.
const STEPS_MAX: usize = 1024;
/// From the palette of Okabe and Ito, for people with a colour vision deficiency.
const COLOURS: [RGBColor; 3] = [RGBColor(230, 159, 0), RGBColor(0, 158, 115), RGBColor(0, 114, 178)];

/// The lowest and the highest value of some cycles, at the time of the first of them.
#[derive(Debug, Clone, Copy)]
struct Step {
    time: f64,
    low: f32,
    high: f32,
}

/// A curve. Each step keeps the lowest and the highest value, so no peak is lost. When the limit is
/// reached, pairs of steps are merged.
#[derive(Debug)]
pub(crate) struct Curve {
    name: &'static str,
    steps: Vec<Step>,
    /// Values per step.
    length: u32,
    /// Values in the last step.
    filled: u32,
}

impl Curve {
    pub(crate) fn new(name: &'static str) -> Self {
        Self { name, steps: Vec::with_capacity(STEPS_MAX), length: 1, filled: 1 }
    }

    /// Adds the value at a time, s. A missing value leaves no gap.
    pub(crate) fn take(&mut self, time: f64, value: Option<f32>) {
        let Some(value) = value.filter(|value| value.is_finite()) else { return };
        match self.steps.last_mut() {
            Some(last) if self.filled < self.length => {
                (last.low, last.high) = (last.low.min(value), last.high.max(value));
                self.filled += 1;
            }
            _ => {
                if self.steps.len() == STEPS_MAX {
                    self.halve();
                }
                self.steps.push(Step { time, low: value, high: value });
                self.filled = 1;
            }
        }
    }

    fn halve(&mut self) {
        let pairs = self.steps.chunks(2).map(|pair| {
            let extremes = |step: &Step| [step.low, step.high];
            let (low, high) = pair
                .iter()
                .flat_map(extremes)
                .fold((f32::MAX, f32::MIN), |(low, high), value| (low.min(value), high.max(value)));
            Step { time: pair[0].time, low, high }
        });
        self.steps = pairs.collect();
        self.length = self.length.saturating_mul(2);
    }

    fn points(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.steps.iter().flat_map(|step| {
            let low = (step.time, f64::from(step.low));
            let high = (step.time, f64::from(step.high));
            [Some(low), Some(high).filter(|_| step.low < step.high)].into_iter().flatten()
        })
    }
}

/// A quantity of a joint.
#[derive(Debug)]
pub(crate) struct Panel {
    pub(crate) title: String,
    pub(crate) curves: [Curve; 3],
}

impl Panel {
    pub(crate) fn is_empty(&self) -> bool {
        self.curves.iter().all(|curve| curve.steps.is_empty())
    }

    fn points(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.curves.iter().flat_map(Curve::points)
    }

    /// Returns the range of values, with a margin.
    fn values(&self) -> Range<f64> {
        let (low, high) = extremes(self.points().map(|(_, value)| value)).unwrap_or((0.0, 1.0));
        let air = ((high - low) * 0.05).max(1e-3);
        low - air..high + air
    }
}

fn extremes(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.fold(None, |known, value| match known {
        None => Some((value, value)),
        Some((low, high)) => Some((value.min(low), value.max(high))),
    })
}

/// Draws the panels as an SVG.
///
/// # Errors
///
/// The error of the drawing library.
pub(crate) fn draw(rows: &[Vec<Panel>]) -> Result<String, String> {
    let times = rows.iter().flatten().flat_map(Panel::points).map(|(time, _)| time);
    let (begin, end) = extremes(times).unwrap_or((0.0, 1.0));
    let times = begin..end.max(begin + 1e-3);
    let mut svg = String::new();
    draw_rows(&mut svg, rows, &times).map_err(|error| error.to_string())?;
    Ok(svg)
}

fn draw_rows(svg: &mut String, rows: &[Vec<Panel>], times: &Range<f64>) -> Result<(), Box<dyn Error>> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let size = (PANEL.0 * u32::try_from(columns)?, PANEL.1 * u32::try_from(rows.len())?);
    let area = SVGBackend::with_string(svg, size).into_drawing_area();
    area.fill(&WHITE)?;
    let panels = rows.iter().flatten();
    for (index, (panel, area)) in panels.zip(area.split_evenly((rows.len(), columns))).enumerate() {
        draw_panel(&area, panel, times.clone(), index == 0)?;
    }
    Ok(area.present()?)
}

fn draw_panel(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    panel: &Panel,
    times: Range<f64>,
    has_legend: bool,
) -> Result<(), Box<dyn Error>> {
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .x_label_area_size(28)
        .y_label_area_size(52)
        .caption(&panel.title, ("sans-serif", 15))
        .build_cartesian_2d(times, panel.values())
        .map_err(|error| error.to_string())?;
    let mesh = chart.configure_mesh().x_labels(6).y_labels(6).x_desc("s").draw();
    mesh.map_err(|error| error.to_string())?;
    for (curve, colour) in panel.curves.iter().zip(COLOURS) {
        let line = LineSeries::new(curve.points(), colour.stroke_width(1));
        let series = chart.draw_series(line).map_err(|error| error.to_string())?;
        series
            .label(curve.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
    }
    if has_legend {
        let mut labels = chart.configure_series_labels();
        let labels = labels.position(SeriesLabelPosition::UpperRight).background_style(WHITE);
        labels.border_style(BLACK).draw().map_err(|error| error.to_string())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_curve_is_reduced_and_keeps_peaks() {
        let mut curve = Curve::new("reported");
        for index in 0..100_000_u32 {
            let value = if index == 77_777 { 9.0 } else { (index % 7) as f32 };
            curve.take(f64::from(index), Some(value));
        }
        assert!(curve.steps.len() <= STEPS_MAX);
        assert_eq!(extremes(curve.points().map(|(_, value)| value)), Some((0.0, 9.0)));
        let peak = curve.points().find(|(_, value)| *value > 8.0).unwrap().0;
        assert!((77_000.0..77_778.0).contains(&peak), "{peak}");
    }

    #[test]
    fn picture_has_panel_per_quantity_and_curve_names() {
        let mut panel = ["position, rad", "velocity, rad/s", "torque, N·m"].map(|quantity| Panel {
            title: format!("knee <b>: {quantity}"),
            curves: ["setpoint", "applied", "reported"].map(Curve::new),
        });
        panel[0].curves[2].take(0.5, Some(1.0));
        panel[0].curves[2].take(0.6, Some(f32::NAN));
        let svg = draw(&[panel.into()]).unwrap();
        for text in
            ["<svg", "knee &lt;b&gt;: velocity, rad/s", "torque, N·m", "setpoint", "applied", "reported"]
        {
            assert!(svg.contains(text), "{text}");
        }
    }
}
