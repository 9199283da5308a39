//! A run of a daemon: the one that answers now, or a file of an earlier one.

use crate::failure::LatencyFailure;
use crate::hgrm::{self, Point};
use crate::hlog;
use crate::snapshot::{Histograms, percentiles};
use crate::table;
use hdrhistogram::Histogram;
use motord_terminal::Table;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// The largest file that is read: a day of twelve motors, second by second.
const FILE_BYTES_MAX: u64 = 4 << 30;
/// Steps of a curve until the distance to 100 % has halved.
const TICKS_PER_HALF: u32 = 20;

/// The latencies of a run.
pub(crate) struct Run {
    /// How tables and pictures call it.
    pub(crate) name: String,
    latencies: Latencies,
}

enum Latencies {
    Counted(Histograms),
    /// Of a file that does not say of which quantity.
    Percentiles(Vec<Point>),
}

/// A quantity of a run, as a picture shows it.
pub(crate) struct Curve {
    pub(crate) name: String,
    pub(crate) points: Vec<Point>,
}

impl Run {
    pub(crate) fn of(name: &str, histograms: Histograms) -> Self {
        Self { name: name.to_owned(), latencies: Latencies::Counted(histograms) }
    }

    /// Reads a file: percentiles by its end `.hgrm`, else an interval log.
    pub(crate) fn read(path: &Path) -> Result<Self, LatencyFailure> {
        let bytes =
            bytes(path).map_err(|error| LatencyFailure::Unreadable { path: path.to_owned(), error })?;
        let malformed = |kind| move |wrong| LatencyFailure::Malformed { path: path.to_owned(), kind, wrong };
        let latencies = if path.extension().is_some_and(|end| end == "hgrm") {
            let points =
                hgrm::read(&String::from_utf8_lossy(&bytes)).map_err(malformed("percentile file"))?;
            Latencies::Percentiles(points)
        } else {
            Latencies::Counted(hlog::read(&bytes).map_err(malformed("interval log"))?)
        };
        let name = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        Ok(Self { name, latencies })
    }

    /// The values of a quantity.
    pub(crate) fn histogram(&self, quantity: &str) -> Result<&Histogram<u64>, LatencyFailure> {
        let Latencies::Counted(quantities) = &self.latencies else { return Err(LatencyFailure::OneRun) };
        quantities.get(quantity).ok_or_else(|| {
            let known: Vec<&str> = quantities.keys().map(String::as_str).collect();
            let (run, quantity) = (self.name.clone(), quantity.to_owned());
            LatencyFailure::NoQuantity { run, quantity, known: known.join(", ") }
        })
    }

    /// The curve of a quantity; a percentile file has only one.
    pub(crate) fn curve(&self, quantity: &str) -> Result<Curve, LatencyFailure> {
        let points = match &self.latencies {
            Latencies::Percentiles(points) => points.clone(),
            Latencies::Counted(_) => points(self.histogram(quantity)?),
        };
        Ok(Curve { name: self.name.clone(), points })
    }

    /// Its percentiles.
    pub(crate) fn table(&self) -> Table {
        match &self.latencies {
            Latencies::Counted(quantities) => {
                let rows: Vec<_> =
                    quantities.iter().map(|(name, values)| (name.as_str(), percentiles(values))).collect();
                table::percentiles(&rows)
            }
            Latencies::Percentiles(points) => table::points(points),
        }
    }
}

fn bytes(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut file = File::open(path)?.take(FILE_BYTES_MAX + 1);
    file.read_to_end(&mut bytes)?;
    if bytes.len() as u64 > FILE_BYTES_MAX {
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, "it is larger than 4 GiB"));
    }
    Ok(bytes)
}

fn points(values: &Histogram<u64>) -> Vec<Point> {
    hgrm::steps(values, TICKS_PER_HALF).into_iter().map(|(point, _)| point).collect()
}
