//! The histograms of latencies, ns: all of one range, with memory for the values that came.

use hdrhistogram::Histogram;

/// Latencies beyond it are recorded as it: 10 s.
pub(crate) const LATENCY_MAX_NS: u64 = 10_000_000_000;
/// A histogram has memory for values up to this at first: 4 ms. Few are longer.
const FIRST_MAX_NS: u64 = 4_000_000;

/// An empty histogram with three significant digits, with memory for the whole range.
pub(crate) fn histogram() -> Histogram<u64> {
    whole(3)
}

/// An empty histogram with two significant digits: about a seventh of the size.
pub(crate) fn coarse_histogram() -> Histogram<u64> {
    whole(2)
}

/// Returns a copy with memory for the whole range, as clients expect it.
pub(crate) fn spread(histogram: &Histogram<u64>) -> Histogram<u64> {
    let mut all = whole(histogram.sigfig());
    all.add(histogram).expect("its values are in the range");
    all
}

/// An empty histogram with this number of significant digits, whose memory grows with its values.
pub(crate) fn growing_histogram(digits: u8) -> Histogram<u64> {
    let mut histogram = bounded(FIRST_MAX_NS, digits);
    histogram.auto(true);
    histogram
}

/// Records `count` equal latencies.
pub(crate) fn add_n(histogram: &mut Histogram<u64>, latency_ns: u64, count: u64) {
    histogram.record_n(latency_ns.min(LATENCY_MAX_NS), count).expect("it grows to the whole range");
}

/// Records a latency.
pub(crate) fn add(histogram: &mut Histogram<u64>, latency_ns: u64) {
    add_n(histogram, latency_ns, 1);
}

fn whole(digits: u8) -> Histogram<u64> {
    bounded(LATENCY_MAX_NS, digits)
}

fn bounded(most_ns: u64, digits: u8) -> Histogram<u64> {
    Histogram::new_with_bounds(1, most_ns, digits).expect("these are bounds of a histogram")
}
