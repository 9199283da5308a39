//! The histograms of latencies, ns: all of one fixed range.

use hdrhistogram::Histogram;

/// Latencies beyond it are recorded as it: 10 s.
pub(crate) const LATENCY_MAX_NS: u64 = 10_000_000_000;

/// An empty histogram with three significant digits.
pub(crate) fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, LATENCY_MAX_NS, 3).expect("1 and 10 s are bounds of a histogram")
}

/// An empty histogram with two significant digits: about a seventh of the size.
pub(crate) fn coarse_histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, LATENCY_MAX_NS, 2).expect("1 and 10 s are bounds of a histogram")
}
