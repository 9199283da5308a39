//! Histograms as text for clients, in pages that fit into one answer.

use crate::histogram::{coarse_histogram, spread};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hdrhistogram::Histogram;
use hdrhistogram::serialization::{Serializer, V2DeflateSerializer};
use motord_shared::description::{EncodedHistogram, Histograms};
use motord_shared::limits::ANSWER_BYTES_MAX;
use std::borrow::Cow;

/// Bytes of a page without its histograms.
const PAGE_OVERHEAD: usize = 256;
/// Bytes of a histogram in a page without its name and values.
const HISTOGRAM_OVERHEAD: usize = 64;
/// Longest text of a histogram: what the longest name leaves.
const ENCODED_MAX: usize = ANSWER_BYTES_MAX - 1024;

/// Returns the histograms from number `from` on, as many as fit, and at least one if there is one.
/// `all` are at most `HISTOGRAMS_MAX`.
pub(crate) fn page<'a>(
    from: usize,
    resets: u64,
    all: impl Iterator<Item = (String, Cow<'a, Histogram<u64>>)>,
) -> Histograms {
    let mut page = Histograms { resets, ..Histograms::default() };
    let mut length = PAGE_OVERHEAD;
    for (number, (name, histogram)) in all.enumerate().skip(from) {
        let encoded = encode(&histogram);
        length += HISTOGRAM_OVERHEAD + name.len() + encoded.len();
        if length > ANSWER_BYTES_MAX && number > from {
            page.next = u32::try_from(number).ok();
            break;
        }
        page.histograms.push(EncodedHistogram { name, encoded });
    }
    page
}

/// A histogram whose text is too long for an answer has two significant digits in it: 3 600 counts
/// of at most nine bytes.
fn encode(histogram: &Histogram<u64>) -> String {
    let fine = text(&spread(histogram));
    if fine.len() <= ENCODED_MAX {
        return fine;
    }
    let mut coarse = coarse_histogram();
    coarse.add(histogram).expect("their bounds are the same");
    text(&coarse)
}

fn text(histogram: &Histogram<u64>) -> String {
    let mut bytes = Vec::new();
    let mut serializer = V2DeflateSerializer::new();
    serializer.serialize(histogram, &mut bytes).expect("counts fit their format, and memory can be written");
    STANDARD.encode(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::histogram::histogram;
    use hdrhistogram::serialization::Deserializer;

    fn decoded(encoded: &EncodedHistogram) -> Histogram<u64> {
        Deserializer::new().deserialize(&mut &STANDARD.decode(&encoded.encoded).unwrap()[..]).unwrap()
    }

    /// Every count differs, so that nothing can be compressed much.
    fn full(high: u64) -> Histogram<u64> {
        let (mut full, mut value, mut random) = (histogram(), 0, 0x9e37_79b9_u64);
        while value < high {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            full.record_n(value, random >> 40).unwrap();
            value = full.next_non_equivalent(value);
        }
        full
    }

    #[test]
    fn pages_list_each_histogram_once_and_fit_answer() {
        let histograms = [full(0), full(20_000), full(50_000), full(40_000), full(100)];
        let (mut from, mut names) = (0, Vec::new());
        loop {
            let all =
                histograms.iter().enumerate().map(|(n, histogram)| (n.to_string(), Cow::Borrowed(histogram)));
            let page = page(from, 3, all);
            assert!(serde_json::to_string(&page).unwrap().len() <= ANSWER_BYTES_MAX);
            for encoded in &page.histograms {
                assert_eq!(decoded(encoded), histograms[encoded.name.parse::<usize>().unwrap()]);
                names.push(encoded.name.clone());
            }
            let Some(next) = page.next else { break };
            assert_eq!((page.resets, next as usize), (3, from + page.histograms.len()));
            from = next as usize;
        }
        assert_eq!(names, ["0", "1", "2", "3", "4"]);
        assert!(from > 0, "they are too many for one page");
    }

    #[test]
    fn oversized_histogram_is_sent_with_two_digits() {
        let full = full(10_000_000_000);
        let page = page(0, 0, [("wake_latency".to_owned(), Cow::Borrowed(&full))].into_iter());
        assert!(serde_json::to_string(&page).unwrap().len() <= ANSWER_BYTES_MAX);
        let coarse = decoded(&page.histograms[0]);
        assert_eq!((coarse.sigfig(), coarse.len()), (2, full.len()));
        let (exact, sent) = (full.value_at_quantile(0.99) as f64, coarse.value_at_quantile(0.99) as f64);
        assert!((sent / exact - 1.0).abs() < 0.01, "{sent} for {exact}");
    }
}
