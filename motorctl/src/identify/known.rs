//! `--known-load`: the inertia of what was added, and the identification without it.

use crate::identify::failure::IdentifyFailure;
use motord_identify::{KnownLoad, Value, torque_scale};
use motord_terminal::{InputFile, within};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::path::Path;

/// Largest identification, bytes: a thousand times that of one joint.
const BYTES_MAX: u64 = 1 << 20;

/// Parses `KG@M` into the inertia of a point mass, kg·m².
pub(crate) fn parse_load(text: &str) -> Result<f64, String> {
    let (mass, distance) = text.split_once('@').ok_or("give mass and distance, such as 0.5@0.2")?;
    Ok(within(mass, 0.001, 1000.0)? * within(distance, 0.001, 10.0)?.powi(2))
}

/// A known load, and the inertia that was identified without it.
#[derive(Debug)]
pub(crate) struct Known {
    load: KnownLoad,
    without: Value,
}

#[derive(Deserialize)]
struct File {
    joint: String,
    inertia_kg_m2: Entry,
}

#[derive(Deserialize)]
struct Entry {
    value: Option<f64>,
    lower: Option<f64>,
    upper: Option<f64>,
    is_identified: bool,
}

/// Reads the output of `motorctl identify --json` of `joint`, which `name` returns.
///
/// # Errors
///
/// The reason why it cannot be used, as a sentence about it.
pub(crate) fn read_identified<T: DeserializeOwned>(
    path: &Path,
    joint: &str,
    name: impl Fn(&T) -> &str,
) -> Result<T, String> {
    let text = InputFile::open(path).and_then(|file| file.read_text(BYTES_MAX));
    let text = text.map_err(|error| error.to_string())?;
    let identified: T = serde_json::from_str(&text).map_err(|error| error.to_string())?;
    match name(&identified) {
        found if found == joint => Ok(identified),
        other => Err(format!("it is that of {other}")),
    }
}

impl Known {
    /// Reads the identification without load, if there is a load.
    pub(crate) fn read(
        load: Option<f64>,
        path: Option<&Path>,
        joint: &str,
    ) -> Result<Option<Self>, IdentifyFailure> {
        let (Some(inertia), Some(path)) = (load, path) else { return Ok(None) };
        let refused = |reason: String| IdentifyFailure::Without {
            path: path.display().to_string(),
            joint: joint.to_owned(),
            reason,
        };
        let file: File = read_identified(path, joint, |file: &File| &file.joint).map_err(refused)?;
        let Entry { value: Some(value), lower: Some(lower), upper: Some(upper), is_identified: true } =
            file.inertia_kg_m2
        else {
            return Err(refused("its inertia was not identifiable".into()));
        };
        let without = Value { value, lower, upper, why: None };
        Ok(Some(Self { load: KnownLoad { inertia }, without }))
    }

    /// True torque by reported torque.
    pub(crate) fn scale(&self, with: &Value) -> Value {
        torque_scale(&self.without, with, self.load)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endless_identification_is_refused() {
        for path in ["/dev/zero", "/proc/self/fd"] {
            let refused = Known::read(Some(0.02), Some(Path::new(path)), "knee").unwrap_err();
            assert!(refused.to_string().contains("name a regular file"), "{path}: {refused}");
        }
    }

    #[test]
    fn load_is_mass_at_distance() {
        assert!((parse_load("0.5@0.2").unwrap() - 0.02).abs() < 1e-12);
        for wrong in ["0.5", "0.5@", "-1@0.2", "1@20"] {
            assert!(parse_load(wrong).is_err(), "{wrong}");
        }
    }
}
