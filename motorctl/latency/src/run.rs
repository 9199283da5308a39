//! A run of a daemon: the present one, or a file.

use crate::failure::LatencyFailure;
use crate::hgrm::{self, Point};
use crate::hlog;
use crate::snapshot::{Histograms, percentiles};
use crate::table;
use hdrhistogram::Histogram;
use motord_terminal::{FileError, InputFile, Table};
use std::path::Path;

/// Largest file: a day of twelve motors with intervals of 1 s.
const FILE_BYTES_MAX: u64 = 4 << 30;
/// Steps of a curve for each halving of the distance to 100 %.
const TICKS_PER_HALF: u32 = 20;

/// The latencies of a run.
pub(crate) struct Run {
    /// Its name in tables and pictures.
    pub(crate) name: String,
    latencies: Latencies,
}

enum Latencies {
    Counted(Histograms),
    /// Percentiles of an unnamed quantity, from a file.
    Percentiles(Vec<Point>),
}

/// The curve of a quantity in a picture.
pub(crate) struct Curve {
    pub(crate) name: String,
    pub(crate) points: Vec<Point>,
}

impl Run {
    pub(crate) fn of(name: &str, histograms: Histograms) -> Self {
        Self { name: name.to_owned(), latencies: Latencies::Counted(histograms) }
    }

    /// Reads a file: percentiles if its name ends with `.hgrm`, otherwise an interval log.
    pub(crate) fn read(path: &Path) -> Result<Self, LatencyFailure> {
        let bytes = InputFile::open(path).and_then(|file| file.read(FILE_BYTES_MAX));
        let bytes = bytes.map_err(FileError::unreadable(path))?;
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

    /// Returns the histogram of a quantity.
    pub(crate) fn histogram(&self, quantity: &str) -> Result<&Histogram<u64>, LatencyFailure> {
        let Latencies::Counted(quantities) = &self.latencies else { return Err(LatencyFailure::OneRun) };
        quantities.get(quantity).ok_or_else(|| {
            let known: Vec<&str> = quantities.keys().map(String::as_str).collect();
            let (run, quantity) = (self.name.clone(), quantity.to_owned());
            LatencyFailure::NoQuantity { run, quantity, known: known.join(", ") }
        })
    }

    /// Returns the curve of a quantity. A percentile file has only one.
    pub(crate) fn curve(&self, quantity: &str) -> Result<Curve, LatencyFailure> {
        let points = match &self.latencies {
            Latencies::Percentiles(points) => points.clone(),
            Latencies::Counted(_) => points(self.histogram(quantity)?),
        };
        Ok(Curve { name: self.name.clone(), points })
    }

    /// Returns the percentiles as a table.
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

fn points(values: &Histogram<u64>) -> Vec<Point> {
    hgrm::steps(values, TICKS_PER_HALF).into_iter().map(|(point, _)| point).collect()
}
