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

/// Returns the known key that has most words of an unknown one, such as `torque-nm` for
/// `max-torque`. `None` if that is none, or several with as many words.
#[must_use]
pub(super) fn with_words<'k>(written: &str, known: impl Iterator<Item = &'k str>) -> Option<&'k str> {
    /// Words of many keys.
    const COMMON: [&str; 12] =
        ["max", "min", "limit", "per", "s", "ms", "us", "rad", "nm", "hz", "celsius", "name"];
    let written: Vec<_> = written.split(['-', '_']).map(str::to_lowercase).collect();
    let rank = |key: &&'k str| {
        let words: Vec<_> = key.split('-').collect();
        let has = |word: &&&str| written.iter().any(|written| written == **word);
        let is_alike = words.iter().filter(has).any(|word| !COMMON.contains(word));
        is_alike.then(|| (words.iter().filter(has).count(), std::cmp::Reverse(words.len())))
    };
    let mut ranked: Vec<_> = known.filter_map(|key| Some((rank(&key)?, key))).collect();
    ranked.sort_unstable();
    match ranked[..] {
        [.., (before, _), (best, _)] if before == best => None,
        [.., (_, key)] => Some(key),
        [] => None,
    }
}

/// Returns the most similar known name, if one is similar.
#[must_use]
pub(super) fn closest<'k>(written: &str, known: impl Iterator<Item = &'k str>) -> Option<&'k str> {
    let likeness = |name: &str| strsim::jaro_winkler(&written.to_lowercase(), &name.to_lowercase());
    let closest = known.max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
    closest.filter(|name| likeness(name) >= ALIKE)
}
