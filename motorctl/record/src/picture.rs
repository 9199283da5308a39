//! Curves over time as an SVG or a PNG: a row for each joint or IMU, a panel for each quantity, and
//! a line for each stop and fault.

use crate::bitmap::{self, Bitmap};
use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::{
    ChartBuilder, ChartContext, Circle, DrawingArea, DrawingBackend, EmptyElement, IntoDrawingArea,
    LineSeries, PathElement, RGBColor, SVGBackend, Text, WHITE,
};
use plotters::style::{Color, FontTransform, IntoFont};
use std::borrow::Cow;
use std::ops::Range;

/// Height of a line of names of curves above a panel.
const LEGEND: u32 = 18;
/// Limit on the steps of a curve: more than a panel has pixels.
const STEPS_MAX: usize = 1024;
/// From the palette of Okabe and Ito, for people with a colour vision deficiency, with the dashes
/// that distinguish them in black and white.
const STYLES: [(RGBColor, &[u32]); 3] =
    [(RGBColor(230, 159, 0), &[2, 2]), (RGBColor(0, 158, 115), &[7, 3]), (RGBColor(0, 114, 178), &[])];
const MARK: (RGBColor, &[u32]) = (RGBColor(204, 0, 0), &[1, 3]);
/// Pixels of a PNG for each pixel of an SVG, which has no fixed size.
const PNG_SCALE: u32 = 2;
/// Largest number of pixels of a PNG: 16 joints in 8 recordings.
const PNG_PIXELS_MAX: u64 = 200_000_000;

/// The lowest and the highest value of some cycles, at the time of the first of them.
#[derive(Debug, Clone, Copy)]
struct Step {
    time: f64,
    low: f32,
    high: f32,
    /// No line leads to this step from the one before.
    follows_gap: bool,
}

/// Sizes and texts that the panels of a picture share.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Width and height of a panel, pixels.
    pub panel: (u32, u32),
    /// The text at the axis of the time.
    pub time: &'static str,
    /// Each curve has a line of the legend, for names that contain numbers.
    pub has_tall_legend: bool,
    /// Width of a curve, pixels.
    pub stroke: u32,
}

impl Layout {
    /// Panels side by side, with short names of curves.
    pub(crate) const WIDE: Self = Self { panel: (480, 260), time: "s", has_tall_legend: false, stroke: 1 };

    /// Height of the legend, pixels, which all panels of a row of short names keep free.
    fn legend(&self, is_drawn: bool) -> u32 {
        match self.has_tall_legend {
            true if is_drawn => STYLES.len() as u32 * LEGEND,
            true => 0,
            false => LEGEND,
        }
    }
}

/// A curve. Each step keeps the lowest and the highest value, so no peak is lost. When the limit is
/// reached, pairs of steps are merged.
#[derive(Debug)]
pub struct Curve {
    name: Cow<'static, str>,
    steps: Vec<Step>,
    /// Values per step.
    length: u32,
    /// Values in the last step.
    filled: u32,
    /// The last value was missing.
    is_gap: bool,
}

impl Curve {
    /// Creates a curve without values. Without a name, the legend omits it.
    #[must_use]
    pub fn new(name: impl Into<Cow<'static, str>>) -> Self {
        Self { name: name.into(), steps: Vec::with_capacity(STEPS_MAX), length: 1, filled: 1, is_gap: true }
    }

    /// Adds the value at a time, s. A missing value leaves a gap.
    pub fn take(&mut self, time: f64, value: Option<f32>) {
        let Some(value) = value.filter(|value| value.is_finite()) else {
            self.is_gap = true;
            return;
        };
        let follows_gap = std::mem::take(&mut self.is_gap);
        match self.steps.last_mut() {
            Some(last) if self.filled < self.length && !follows_gap => {
                (last.low, last.high) = (last.low.min(value), last.high.max(value));
                self.filled += 1;
            }
            _ => {
                if self.steps.len() == STEPS_MAX {
                    self.halve();
                }
                self.steps.push(Step { time, low: value, high: value, follows_gap });
                self.filled = 1;
            }
        }
    }

    /// Merges pairs of steps. It keeps pairs that contain a gap apart, unless most pairs contain
    /// one.
    fn halve(&mut self) {
        let steps = merged(&self.steps, |next| !next.follows_gap);
        let is_shorter = steps.len() <= STEPS_MAX * 3 / 4;
        self.steps = if is_shorter { steps } else { merged(&self.steps, |_| true) };
        self.length = self.length.saturating_mul(2);
    }

    fn points(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.steps.iter().flat_map(Step::points)
    }

    /// Returns the parts between gaps.
    fn parts(&self) -> impl Iterator<Item = Vec<(f64, f64)>> + '_ {
        let parts = self.steps.chunk_by(|_, next| !next.follows_gap);
        parts.map(|part| part.iter().flat_map(Step::points).collect())
    }
}

/// Merges each step with the next one where `joins` says so.
fn merged(steps: &[Step], joins: impl Fn(&Step) -> bool) -> Vec<Step> {
    let (mut merged, mut steps) = (Vec::with_capacity(STEPS_MAX), steps.iter().peekable());
    while let Some(step) = steps.next() {
        let next = steps.next_if(|next| joins(next)).unwrap_or(step);
        merged.push(Step {
            low: step.low.min(next.low),
            high: step.high.max(next.high),
            follows_gap: step.follows_gap || next.follows_gap,
            ..*step
        });
    }
    merged
}

impl Step {
    fn points(&self) -> impl Iterator<Item = (f64, f64)> + use<> {
        let (low, high) = ((self.time, f64::from(self.low)), (self.time, f64::from(self.high)));
        [Some(low), Some(high).filter(|_| self.low < self.high)].into_iter().flatten()
    }
}

/// A stop or a fault.
#[derive(Debug, Clone, PartialEq)]
pub struct Mark {
    /// Its time, s.
    pub time: f64,
    /// Its name.
    pub name: String,
}

/// The panels of a joint or an IMU in one recording.
#[derive(Debug)]
pub struct Row {
    /// From left to right.
    pub panels: Vec<Panel>,
    /// Lines over the height of every panel.
    pub marks: Vec<Mark>,
}

/// A quantity with its three curves.
#[derive(Debug)]
pub struct Panel {
    /// The quantity and its unit.
    pub title: String,
    /// The first is dotted, the second dashed.
    pub curves: [Curve; 3],
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

/// Draws the rows as an SVG.
///
/// # Errors
///
/// The error of the drawing library.
pub fn svg(rows: &[Row], layout: Layout) -> Result<String, String> {
    let mut svg = String::new();
    draw(SVGBackend::with_string(&mut svg, size(rows, layout, 1)), rows, layout, 1)?;
    Ok(dashed(svg))
}

/// Draws the rows as a PNG.
///
/// # Errors
///
/// The picture would be too large, or the error of the encoder.
pub fn png(rows: &[Row], layout: Layout) -> Result<Vec<u8>, String> {
    let size = size(rows, layout, PNG_SCALE);
    let count = u64::from(size.0) * u64::from(size.1);
    if count > PNG_PIXELS_MAX {
        return Err(format!(
            "{} x {} pixels are too many for a PNG: name fewer joints, or use --svg",
            size.0, size.1
        ));
    }
    let mut pixels = vec![255; 3 * count as usize];
    draw(Bitmap::new(&mut pixels, size, dashes, PNG_SCALE), rows, layout, PNG_SCALE)?;
    bitmap::encode(&pixels, size)
}

fn size(rows: &[Row], layout: Layout, scale: u32) -> (u32, u32) {
    let columns = rows.iter().map(|row| row.panels.len()).max().unwrap_or(0);
    let pixels =
        |panels: usize, size: u32| u32::try_from(panels).unwrap_or(u32::MAX).saturating_mul(size * scale);
    (pixels(columns, layout.panel.0), pixels(rows.len(), layout.panel.1))
}

fn styles() -> impl Iterator<Item = (RGBColor, &'static [u32])> {
    STYLES.into_iter().chain([MARK])
}

/// Returns the dashes of a colour: the drawing library knows none.
fn dashes((red, green, blue): (u8, u8, u8)) -> &'static [u32] {
    let mut styles = styles().filter(|(colour, _)| *colour == RGBColor(red, green, blue));
    styles.next().map_or(&[], |(_, dashes)| dashes)
}

/// Adds the dashes of each colour.
fn dashed(svg: String) -> String {
    styles().filter(|(_, dashes)| !dashes.is_empty()).fold(svg, |svg, (colour, dashes)| {
        let stroke = format!("stroke=\"#{:02X}{:02X}{:02X}\"", colour.0, colour.1, colour.2);
        let dashes: Vec<String> = dashes.iter().map(u32::to_string).collect();
        svg.replace(&stroke, &format!("{stroke} stroke-dasharray=\"{}\"", dashes.join(" ")))
    })
}

fn draw<B: DrawingBackend>(backend: B, rows: &[Row], layout: Layout, scale: u32) -> Result<(), String> {
    let all = rows.iter().flat_map(|row| &row.panels);
    let (begin, end) = extremes(all.flat_map(Panel::points).map(|(time, _)| time)).unwrap_or((0.0, 1.0));
    // A stop at the end of the recording is visible beside the curves.
    let times = begin..(end + 0.01 * (end - begin)).max(begin + 1e-3);
    let columns = rows.iter().map(|row| row.panels.len()).max().unwrap_or(0);
    let area = backend.into_drawing_area();
    area.fill(&WHITE).map_err(text_of)?;
    let panels = rows.iter().flat_map(|row| row.panels.iter().map(|panel| (panel, &row.marks[..])));
    let mut named = None;
    for ((panel, marks), area) in panels.zip(area.split_evenly((rows.len(), columns))) {
        let names = panel.curves.each_ref().map(|curve| curve.name.clone());
        let has_legend = named.as_ref() != Some(&names);
        named = Some(names);
        let style = Style { layout, scale, times: times.clone(), has_legend };
        style.draw_panel(&area, panel, marks)?;
    }
    area.present().map_err(text_of)
}

fn text_of(error: impl ToString) -> String {
    error.to_string()
}

type Area<B> = DrawingArea<B, Shift>;
type Chart<'b, B> = ChartContext<'b, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// The look of a panel.
struct Style {
    layout: Layout,
    scale: u32,
    times: Range<f64>,
    has_legend: bool,
}

impl Style {
    fn font(&self, size: u32) -> (&'static str, u32) {
        ("sans-serif", size * self.scale)
    }

    fn draw_panel<B: DrawingBackend>(
        &self,
        area: &Area<B>,
        panel: &Panel,
        marks: &[Mark],
    ) -> Result<(), String> {
        let (strip, area) = area.split_vertically(self.layout.legend(self.has_legend) * self.scale);
        if self.has_legend {
            self.draw_legend(&strip, panel)?;
        }
        let mut chart = ChartBuilder::on(&area)
            .margin(8 * self.scale)
            .x_label_area_size(28 * self.scale)
            .y_label_area_size(52 * self.scale)
            .caption(&panel.title, self.font(15))
            .build_cartesian_2d(self.times.clone(), panel.values())
            .map_err(text_of)?;
        let mut mesh = chart.configure_mesh();
        let mesh = mesh
            .x_labels(6)
            .y_labels(6)
            .x_desc(self.layout.time)
            .label_style(self.font(11))
            .axis_desc_style(self.font(11));
        mesh.draw().map_err(text_of)?;
        for mark in marks.iter().filter(|mark| self.times.contains(&mark.time)) {
            self.draw_mark(&mut chart, mark, panel.values())?;
        }
        for (curve, (colour, _)) in panel.curves.iter().zip(STYLES) {
            self.draw_curve(&mut chart, curve, colour)?;
        }
        Ok(())
    }

    /// Draws the names of the curves above a panel, where they cover no curve.
    fn draw_legend<B: DrawingBackend>(&self, strip: &Area<B>, panel: &Panel) -> Result<(), String> {
        let scale = self.scale as i32;
        let (mut x, mut middle) = (60 * scale, LEGEND as i32 * scale / 2);
        let styled = panel.curves.iter().zip(STYLES);
        for (curve, (colour, _)) in styled.filter(|(curve, _)| !curve.name.is_empty()) {
            let sample = [(x, middle), (x + 28 * scale, middle)];
            strip.draw(&PathElement::new(sample, colour.stroke_width(2 * self.scale))).map_err(text_of)?;
            let name = Text::new(&*curve.name, (x + 34 * scale, middle - 6 * scale), self.font(11));
            strip.draw(&name).map_err(text_of)?;
            match self.layout.has_tall_legend {
                true => middle += LEGEND as i32 * scale,
                false => x += (54 + 7 * curve.name.len() as i32) * scale,
            }
        }
        Ok(())
    }

    /// Draws the parts of a curve; a part of one value is a point.
    fn draw_curve<B: DrawingBackend>(
        &self,
        chart: &mut Chart<'_, B>,
        curve: &Curve,
        colour: RGBColor,
    ) -> Result<(), String> {
        let width = self.layout.stroke * self.scale;
        for part in curve.parts() {
            match part[..] {
                [point] => chart.draw_series([Circle::new(point, width, colour.filled())]),
                _ => chart.draw_series(LineSeries::new(part, colour.stroke_width(width))),
            }
            .map_err(text_of)?;
        }
        Ok(())
    }

    /// Draws a line over the whole height, and its name along it.
    fn draw_mark<B: DrawingBackend>(
        &self,
        chart: &mut Chart<'_, B>,
        mark: &Mark,
        values: Range<f64>,
    ) -> Result<(), String> {
        let ends = [(mark.time, values.start), (mark.time, values.end)];
        chart.draw_series([PathElement::new(ends, MARK.0.stroke_width(self.scale))]).map_err(text_of)?;
        let style = self.font(10).into_font().transform(FontTransform::Rotate90).color(&MARK.0);
        let beside = (-4 * self.scale as i32, 2 * self.scale as i32);
        let name = EmptyElement::at((mark.time, values.end)) + Text::new(mark.name.clone(), beside, style);
        chart.draw_series([name]).map_err(text_of)?;
        Ok(())
    }
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
    fn missing_value_leaves_a_gap() {
        let mut curve = Curve::new("setpoint");
        for index in 0..3000_u32 {
            let is_missing = (1000..2000).contains(&index);
            curve.take(f64::from(index), Some(1.0).filter(|_| !is_missing));
        }
        let parts: Vec<_> = curve.parts().collect();
        let [(before, _), (after, _)] = [parts[0].last().unwrap(), &parts[1][0]];
        assert_eq!(parts.len(), 2);
        assert!(*before < 1000.0 && *after > 1996.0, "{before} {after}");
    }

    /// The values before a gap were merged with those behind it, and a line led through the gap.
    #[test]
    fn reduced_curve_keeps_its_gaps() {
        for begin in 1001..1009 {
            let mut curve = Curve::new("roll");
            for index in 0..20_000_u32 {
                let is_missing = (begin..2 * begin).contains(&index);
                curve.take(f64::from(index), Some(index as f32).filter(|_| !is_missing));
            }
            let parts: Vec<_> = curve.parts().collect();
            let ends = parts.iter().map(|part| (part[0].1, part.last().unwrap().1)).collect::<Vec<_>>();
            let [begin, end] = [begin - 1, 2 * begin].map(f64::from);
            assert_eq!(ends, [(0.0, begin), (end, 19_999.0)], "{begin}");
        }
        let mut comb = Curve::new("setpoint");
        (0..40_000_u32).for_each(|index| comb.take(f64::from(index), Some(1.0).filter(|_| index % 2 == 0)));
        assert!(comb.steps.len() <= STEPS_MAX, "gaps without number");
    }

    #[test]
    fn curves_and_marks_differ_in_black_and_white() {
        let mut panel =
            Panel { title: String::new(), curves: ["setpoint", "applied", "reported"].map(Curve::new) };
        for curve in &mut panel.curves {
            curve.take(0.0, Some(0.0));
            curve.take(1.0, Some(1.0));
        }
        let marks = vec![Mark { time: 0.5, name: "stop".to_owned() }];
        let svg = svg(&[Row { panels: vec![panel], marks }], Layout::WIDE).unwrap();
        for dashes in ["2 2", "7 3", "1 3"] {
            assert!(svg.contains(&format!("stroke-dasharray=\"{dashes}\"")), "{dashes}");
        }
    }

    #[test]
    fn picture_has_panel_per_quantity_and_curve_names() {
        let mut panel = ["position, rad", "velocity, rad/s", "torque, N·m"].map(|quantity| Panel {
            title: format!("knee <b>: {quantity}"),
            curves: ["setpoint", "applied", "reported"].map(Curve::new),
        });
        for time in [0.5, 0.6, 0.7] {
            panel[0].curves[2].take(time, Some(1.0));
        }
        let marks = vec![Mark { time: 0.6, name: "legs is stopped: motor-lost (knee)".to_owned() }];
        let svg = svg(&[Row { panels: panel.into(), marks }], Layout::WIDE).unwrap();
        for text in [
            "<svg",
            "knee &lt;b&gt;: velocity, rad/s",
            "torque, N·m",
            "setpoint",
            "applied",
            "reported",
            "motor-lost (knee)",
        ] {
            assert!(svg.contains(text), "{text}");
        }
    }
}
