//! Percentile distributions as HdrHistogram prints them (`outputPercentileDistribution`), values in
//! µs.

use hdrhistogram::Histogram;
use std::io::{self, Write};

/// Steps for each halving of the distance to 100 %.
const TICKS_PER_HALF: u32 = 5;
const NS_PER_US: f64 = 1000.0;

/// A share of the values, from 0 to 1, and its quantile, µs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    pub(crate) share: f64,
    pub(crate) value: f64,
}

/// Returns the steps of a distribution, each with the number of values up to it. They are those of
/// HdrHistogram's `PercentileIterator`: `ticks` steps for each halving of the distance to 100 %,
/// and the last step at 100 %. `values` are in ns. The shares are computed in percent, as in Java,
/// so that ties give the same value. The crate's `iter_quantiles` rounds some of them to the next
/// value.
pub(crate) fn steps(values: &Histogram<u64>, ticks: u32) -> Vec<(Point, u64)> {
    let (mut steps, mut percent, mut count, total) = (Vec::new(), 0.0, 0, values.len());
    for recorded in values.iter_recorded() {
        count += recorded.count_at_value();
        let value = recorded.value_iterated_to() as f64 / NS_PER_US;
        while percent < 100.0 && 100.0 * count as f64 / total as f64 >= percent {
            steps.push((Point { share: percent / 100.0, value }, count));
            let halvings = ((100.0 / (100.0 - percent)).ln() / 2.0_f64.ln()).trunc();
            percent += 100.0 / (f64::from(ticks) * (halvings + 1.0).exp2());
            if count == total {
                break;
            }
        }
        if count == total {
            steps.push((Point { share: 1.0, value }, count));
        }
    }
    steps
}

/// Writes the distribution of `values`, which are in ns.
pub(crate) fn write(out: &mut dyn Write, values: &Histogram<u64>) -> io::Result<()> {
    writeln!(out, "{:>12} {:>14} {:>10} {:>14}\n", "Value", "Percentile", "TotalCount", "1/(1-Percentile)")?;
    for (Point { share, value }, count) in steps(values, TICKS_PER_HALF) {
        write!(out, "{value:12.3} {share:2.12} {count:10}")?;
        if share < 1.0 {
            write!(out, " {:14.2}", 1.0 / (1.0 - share))?;
        }
        writeln!(out)?;
    }
    let (mean, deviation) = (values.mean() / NS_PER_US, values.stdev() / NS_PER_US);
    let max = values.max() as f64 / NS_PER_US;
    let (total, buckets, sub_buckets) = (values.len(), values.buckets(), sub_buckets(values));
    writeln!(out, "#[Mean    = {mean:12.3}, StdDeviation   = {deviation:12.3}]")?;
    writeln!(out, "#[Max     = {max:12.3}, Total count    = {total:12}]")?;
    writeln!(out, "#[Buckets = {buckets:12}, SubBuckets     = {sub_buckets:12}]")
}

/// Returns twice the resolution, as a power of two.
fn sub_buckets(values: &Histogram<u64>) -> u64 {
    (2 * 10_u64.pow(u32::from(values.sigfig()))).next_power_of_two()
}

/// Reads a distribution. The error names the first mistake.
pub(crate) fn read(text: &str) -> Result<Vec<Point>, String> {
    let rows = text.lines().enumerate().filter(|(_, line)| {
        let line = line.trim_start();
        !line.is_empty() && !line.starts_with('#') && !line.starts_with("Value")
    });
    rows.map(|(number, line)| point(line).ok_or_else(|| format!("line {} is not a percentile", number + 1)))
        .collect()
}

fn point(line: &str) -> Option<Point> {
    let mut numbers = line.split_whitespace().map(|text| text.parse::<f64>().ok());
    let (value, share) = (numbers.next()??, numbers.next()??);
    (value.is_finite() && value >= 0.0 && (0.0..=1.0).contains(&share)).then_some(Point { share, value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distribution_round_trips_in_hdrhistogram_format() {
        let mut values = Histogram::new_with_bounds(1, 10_000_000_000, 3).unwrap();
        (1..=10).for_each(|value| values.record(value * 1000).unwrap());
        let mut text = Vec::new();
        write(&mut text, &values).unwrap();
        let text = String::from_utf8(text).unwrap();
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(rows[0], "       Value     Percentile TotalCount 1/(1-Percentile)");
        assert_eq!(rows[2], "       1.000 0.000000000000          1           1.00");
        assert!(text.contains("\n      10.007 1.000000000000         10\n#[Mean    ="), "{text}");
        assert!(text.contains("Total count    =           10]\n"), "{text}");
        let points = read(&text).unwrap();
        assert_eq!(points.first(), Some(&Point { share: 0.0, value: 1.0 }));
        assert_eq!(points.last(), Some(&Point { share: 1.0, value: 10.007 }));
    }

    #[test]
    fn a_line_that_is_none_is_named() {
        for wrong in ["1.0", "1.0 2.0 3", "NaN 0.5 1", "-1 0.5 1", "1 x 2", "inf 0.5 1"] {
            assert_eq!(
                read(&format!("# head\n1.0 0.5 1 2\n{wrong}\n")).unwrap_err(),
                "line 3 is not a percentile"
            );
        }
    }
}
