//! Percentiles as a picture: the share of the values on the axis of HdrHistogram, where each decade
//! comes ten times closer to 100 %, and the latency on a logarithmic axis.

use crate::failure::LatencyFailure;
use crate::hgrm::Point;
use crate::run::Curve;
use plotters::coord::combinators::IntoLogRange;
use plotters::prelude::{
    BLACK, ChartBuilder, IntoDrawingArea, LineSeries, PathElement, RGBColor, SVGBackend, SeriesLabelPosition,
    WHITE,
};
use plotters::style::Color;
use std::ops::Range;

const SIZE: (u32, u32) = (960, 540);
/// The palette of Okabe and Ito, for people with a colour vision deficiency.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];
/// End of the axis, which begins at 0 %: a count of 10¹².
const DECADES_MAX: f64 = 12.0;

/// Draws the curves as an SVG.
pub(crate) fn draw(quantity: &str, curves: &[Curve]) -> Result<String, LatencyFailure> {
    let (shares, latencies) = axes(curves).ok_or_else(|| LatencyFailure::Empty(quantity.to_owned()))?;
    let mut svg = String::new();
    plot(&mut svg, quantity, curves, shares, latencies)
        .map_err(|error| LatencyFailure::Picture(error.to_string()))?;
    Ok(svg)
}

/// Returns the distance of a share to 100 % in decades: 0.9 is 1, 0.99 is 2.
fn decades(share: f64) -> f64 {
    -(1.0 - share).max(10.0_f64.powf(-DECADES_MAX)).log10()
}

/// Returns the points of a curve. The last share is 1, infinitely far: it is drawn at the share
/// before it.
fn positions(points: &[Point]) -> impl Iterator<Item = (f64, f64)> + '_ {
    let last = points.iter().map(|point| point.share).filter(|share| *share < 1.0).fold(0.0, f64::max);
    points.iter().map(move |point| (decades(point.share.min(last)), point.value.max(f64::MIN_POSITIVE)))
}

/// Returns the ranges of both axes; `None` without a point. Latencies, µs, are above 0 on a
/// logarithmic axis.
fn axes(curves: &[Curve]) -> Option<(Range<f64>, Range<f64>)> {
    let points = || curves.iter().flat_map(|curve| positions(&curve.points));
    let above_zero = || points().map(|(_, value)| value).filter(|value| *value >= 1e-3);
    let least = above_zero().min_by(f64::total_cmp)?;
    let most = above_zero().max_by(f64::total_cmp)?;
    let furthest = points().map(|(decades, _)| decades).fold(1.0, f64::max);
    let decade = |value: f64, round: fn(f64) -> f64| 10.0_f64.powf(round(value.log10()));
    Some((0.0..furthest, decade(least, f64::floor)..decade(most * 1.000_1, f64::ceil)))
}

fn plot(
    svg: &mut String,
    quantity: &str,
    curves: &[Curve],
    shares: Range<f64>,
    latencies: Range<f64>,
) -> Result<(), Box<dyn std::error::Error>> {
    let least = latencies.start;
    let area = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .margin(16)
        .x_label_area_size(44)
        .y_label_area_size(72)
        .caption(quantity, ("sans-serif", 20))
        .build_cartesian_2d(shares, latencies.log_scale())?;
    chart
        .configure_mesh()
        .x_labels(DECADES_MAX as usize)
        .x_label_formatter(&|decades| percent(*decades))
        .y_label_formatter(&|value| format!("{value}"))
        .x_desc("percentile")
        .y_desc("latency, µs")
        .draw()?;
    for (curve, colour) in curves.iter().zip(COLOURS.iter().cycle()) {
        let points = positions(&curve.points).map(|(decades, value)| (decades, value.max(least)));
        chart
            .draw_series(LineSeries::new(points, colour.stroke_width(2)))?
            .label(&curve.name)
            .legend(|(x, y)| PathElement::new([(x, y), (x + 20, y)], colour.stroke_width(2)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE)
        .border_style(BLACK)
        .draw()?;
    area.present()?;
    Ok(())
}

/// Formats the share at `decades` as a percentage. Returns an empty text between whole decades.
fn percent(decades: f64) -> String {
    if (decades - decades.round()).abs() > 1e-6 {
        return String::new();
    }
    let digits = (decades.round() as usize).saturating_sub(2);
    format!("{:.digits$} %", 100.0 * (1.0 - 10.0_f64.powf(-decades)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(name: &str, points: &[(f64, f64)]) -> Curve {
        let points = points.iter().map(|&(share, value)| Point { share, value }).collect();
        Curve { name: name.to_owned(), points }
    }

    #[test]
    fn each_decade_is_ten_times_closer_to_all() {
        assert_eq!([0.0, 1.0, 2.0, 3.0, 5.0].map(percent), ["0 %", "90 %", "99 %", "99.9 %", "99.999 %"]);
        assert_eq!(percent(0.5), "");
        assert!((decades(0.999) - 3.0).abs() < 1e-9);
        assert!((decades(1.0) - DECADES_MAX).abs() < 1e-9, "no infinity");
    }

    #[test]
    fn picture_names_runs_and_axes_hold_values() {
        let curves = [
            curve("before", &[(0.0, 3.0), (0.5, 14.0), (0.999, 90.0), (1.0, 210.0)]),
            curve("after <b>", &[(0.0, 2.0), (0.99, 40.0), (1.0, 41.0)]),
        ];
        assert_eq!(axes(&curves).unwrap().1, 1.0..1000.0);
        let svg = draw("wake_latency", &curves).unwrap();
        for text in ["<svg", "before", "after &lt;b&gt;", "wake_latency", "99 %", "latency, µs"] {
            assert!(svg.contains(text), "{text} in {svg}");
        }
    }

    #[test]
    fn nothing_is_drawn_of_nothing() {
        for points in [&[][..], &[(0.0, 0.0), (1.0, 0.0)]] {
            let failure = draw("polled", &[curve("run", points)]).unwrap_err();
            assert!(matches!(failure, LatencyFailure::Empty(_)), "{failure}");
        }
    }
}
