//! Suggests the known name that is most similar to an unknown one.

use super::problem::plain;

/// Least similarity (Jaro-Winkler) of a suggestion; 1 is equal.
const ALIKE: f64 = 0.8;

/// Returns a hint for an unknown name: the most similar known name, or all of them. Escapes control
/// characters in the known names.
#[must_use]
pub fn suggestion<'k>(written: &str, known: impl Iterator<Item = &'k str>) -> String {
    let known: Vec<_> = known.collect();
    match closest(written, known.iter().copied()) {
        Some(name) => format!("did you mean `{}`?", plain(name)),
        None if known.is_empty() => "there is none".to_owned(),
        None => format!("known are {}", plain(&known.join(", "))),
    }
}

/// Returns the most similar known name, if one is similar.
#[must_use]
pub(super) fn closest<'k>(written: &str, known: impl Iterator<Item = &'k str>) -> Option<&'k str> {
    let likeness = |name: &str| strsim::jaro_winkler(&written.to_lowercase(), &name.to_lowercase());
    let closest = known.max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
    closest.filter(|name| likeness(name) >= ALIKE)
}
