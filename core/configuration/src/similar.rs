//! "Did you mean": the known name that looks most like the one that is written.

use super::problem::plain;

/// From here on two names look alike; 1 is equal (Jaro-Winkler).
const ALIKE: f64 = 0.8;

/// For the reader of an unknown name: the known name that is most like it, or all of them. Control characters in the known names
/// are escaped.
#[must_use]
pub fn suggestion<'k>(written: &str, known: impl Iterator<Item = &'k str>) -> String {
    let known: Vec<_> = known.collect();
    let likeness = |name: &str| strsim::jaro_winkler(&written.to_lowercase(), &name.to_lowercase());
    let closest = known.iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
    match closest {
        Some(name) if likeness(name) >= ALIKE => format!("did you mean `{}`?", plain(name)),
        _ => format!("known are {}", plain(&known.join(", "))),
    }
}
