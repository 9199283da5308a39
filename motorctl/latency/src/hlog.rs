//! Interval logs of HdrHistogram, as its HistogramLogProcessor and its ports read them.

use crate::failure::LatencyFailure;
use crate::snapshot::{Histograms, Interval, histogram};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hdrhistogram::serialization::V2DeflateSerializer;
use hdrhistogram::serialization::interval_log::{
    IntervalLogHistogram, IntervalLogIterator, IntervalLogWriterBuilder, IntervalLogWriterError, LogEntry,
    Tag,
};
use motord_client::RobotDescription;
use motord_terminal::FileError;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// The header of a log, which names its format.
const VERSION: &str = "[Histogram log format version 1.3]";
const LEGEND: &[u8] =
    b"\"StartTimestamp\",\"Interval_Length\",\"Interval_Max\",\"Interval_Compressed_Histogram\"\n";

/// A log that grows by whole intervals.
pub(crate) struct Hlog {
    path: PathBuf,
    file: File,
    begun: SystemTime,
}

impl Hlog {
    /// Creates a log of the latencies of `robot`. It begins now.
    pub(crate) fn create(path: &Path, robot: &RobotDescription) -> Result<Self, LatencyFailure> {
        let begun = SystemTime::now();
        let about = format!("[motord {}, instance {}; latencies in ns]", robot.version, robot.instance);
        let mut head = Vec::new();
        IntervalLogWriterBuilder::new()
            .add_comment(&about)
            .add_comment(VERSION)
            .with_start_time(begun)
            .with_base_time(begun)
            .begin_log_with(&mut head, &mut V2DeflateSerializer::new())
            .expect("memory can be written");
        head.extend_from_slice(LEGEND);
        let mut file = File::create(path).map_err(FileError::unwritable(path))?;
        file.write_all(&head).map_err(FileError::unwritable(path))?;
        Ok(Self { path: path.to_owned(), file, begun })
    }

    /// Appends a line for each quantity with samples, in one write.
    pub(crate) fn append(&mut self, interval: &Interval) -> Result<(), LatencyFailure> {
        let written = lines(interval, self.begun).and_then(|lines| self.file.write_all(&lines));
        Ok(written.map_err(FileError::unwritable(&self.path))?)
    }
}

fn lines(interval: &Interval, begun: SystemTime) -> io::Result<Vec<u8>> {
    let (mut lines, mut serializer) = (Vec::new(), V2DeflateSerializer::new());
    let mut writer = IntervalLogWriterBuilder::new().begin_log_with(&mut lines, &mut serializer)?;
    let since = interval.begun.duration_since(begun).unwrap_or_default();
    for (name, values) in interval.histograms.iter().filter(|(_, values)| !values.is_empty()) {
        writer.write_histogram(values, since, interval.length, Tag::new(name)).map_err(
            |error| match error {
                IntervalLogWriterError::IoError(error) => error,
                IntervalLogWriterError::SerializeError(error) => io::Error::other(error),
            },
        )?;
    }
    drop(writer);
    Ok(lines)
}

/// Returns the sums of all intervals of a log by tag. Lines without a tag have the empty tag. The
/// error names the first mistake.
pub(crate) fn read(log: &[u8]) -> Result<Histograms, String> {
    let mut quantities = Histograms::new();
    for (number, entry) in IntervalLogIterator::new(log).enumerate() {
        let entry = entry.map_err(|_| "a line is not an interval".to_owned())?;
        if let LogEntry::Interval(interval) = entry {
            let values =
                decode(&interval).ok_or_else(|| format!("its entry {} is not a histogram", number + 1))?;
            let name = interval.tag().map_or("", |tag| tag.as_str());
            if let Some(sum) = quantities.get_mut(name) {
                sum.add(values).map_err(|error| format!("its intervals do not fit together: {error}"))?;
            } else {
                quantities.insert(name.to_owned(), growing(values));
            }
        }
    }
    Ok(quantities)
}

fn decode(interval: &IntervalLogHistogram<'_>) -> Option<hdrhistogram::Histogram<u64>> {
    histogram(&STANDARD.decode(interval.encoded_histogram()).ok()?)
}

/// Lets a histogram grow: other programs write each interval with the range that it needs.
fn growing(mut values: hdrhistogram::Histogram<u64>) -> hdrhistogram::Histogram<u64> {
    values.auto(true);
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::snapshot::percentiles;
    use motord_client::Percentiles;
    use std::time::Duration;

    fn interval(begun: SystemTime, values: &[u64]) -> Interval {
        let mut wake = hdrhistogram::Histogram::new_with_bounds(1, 10_000_000_000, 3).unwrap();
        let empty = wake.clone();
        values.iter().for_each(|value| wake.record(*value).unwrap());
        let names = ["wake_latency", "reply_latency/fl-hip", "polled"].map(str::to_owned);
        let histograms = names.into_iter().zip([wake.clone(), wake, empty]).collect();
        Interval::new(begun, Duration::from_secs(1), histograms)
    }

    #[test]
    fn log_is_complete_after_each_interval() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("run.hlog");
        let mut log = Hlog::create(&path, &RobotDescription::default()).unwrap();
        for (second, values) in [(0, &[11_000, 12_000][..]), (1, &[13_000, 2_000_000])] {
            log.append(&interval(log.begun + Duration::from_secs(second), values)).unwrap();
            let written = read(&std::fs::read(&path).unwrap()).unwrap();
            assert_eq!(written["wake_latency"].len(), 2 * (second + 1));
        }
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("#[Histogram log format version 1.3]\n#[StartTime: "), "{text}");
        assert!(text.contains("\nTag=wake_latency,0.000,1.000,12007.000,HIST"), "{text}");
        assert!(text.contains("\nTag=reply_latency/fl-hip,1.000,1.000,2000"), "{text}");
        assert!(!text.contains("polled"), "a quantity without a sample has no line: {text}");
        let read = read(text.as_bytes()).unwrap();
        let Percentiles { count, p50, max, .. } = percentiles(&read["reply_latency/fl-hip"]);
        assert!(count == 4 && (p50 - 12.0).abs() < 0.02 && (max - 2000.0).abs() < 2.0, "{count} {p50} {max}");
    }

    #[test]
    fn invalid_line_is_refused_and_empty_log_accepted() {
        for wrong in [
            "Tag=a,0.0,1.0,2.0,!!!!\n",
            "Tag=a,0.0,1.0,2.0,SERSAAAA\n",
            "0.0;1.0\n",
            "Tag=a,0,1,2,\n",
            "\0\u{ff}\n",
        ] {
            assert!(read(wrong.as_bytes()).is_err(), "{wrong:?}");
        }
        assert!(read(b"").unwrap().is_empty());
        assert!(read(b"#[StartTime: 1.000 (seconds since epoch)]\n").unwrap().is_empty());
    }
}
