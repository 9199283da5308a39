//! The rules and the board of packaging/monitoring name only metrics and labels that the daemon
//! serves.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

use motord_bus::Duration;
use motord_metrics::{Distributions, Metrics, Names};
use motord_shared::StateMessage;
use std::collections::BTreeSet;
use std::path::Path;

/// The metrics of a robot that has everything.
fn served() -> String {
    let one = |name: &str| vec![name.to_owned()];
    let names = Names { joints: one("knee"), groups: one("legs"), buses: one("front"), imus: one("base") };
    let counts = StateMessage { joint_count: 1, group_count: 1, bus_count: 1, ..Default::default() };
    let mut state = StateMessage { imu_count: 1, ..counts };
    (state.joints[0].supply_voltage, state.joints[0].supply_current) = (24.0, 1.0);
    let distributions = Distributions::new(1, 1, Duration::from_millis(1)).with_imus(1);
    Metrics::new(names).text(&distributions, &state, 0)
}

fn file(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../packaging/monitoring");
    std::fs::read_to_string(folder.join(name)).unwrap()
}

fn is_of_name(letter: char) -> bool {
    letter.is_ascii_alphanumeric() || letter == '_'
}

/// Each metric in a text, with the selector that follows it, if there is one.
fn named(text: &str) -> Vec<(&str, &str)> {
    let starts = text.match_indices("motord_").map(|(at, _)| &text[at..]);
    starts
        .map(|rest| {
            let (name, rest) = rest.split_at(rest.find(|letter| !is_of_name(letter)).unwrap_or(rest.len()));
            let selector = rest.strip_prefix('{').and_then(|inner| inner.split_once('}'));
            (name, selector.map_or("", |(selector, _)| selector))
        })
        .collect()
}

/// The labels of a selector with their values. In JSON the quotes have a backslash.
fn labels(selector: &str) -> Vec<(String, String)> {
    let plain = selector.replace('\\', "");
    let part = |part: &str| {
        let (label, value) = part.split_once('=')?;
        let value = value.trim_start_matches('~').trim_matches('"').to_owned();
        Some((label.trim_end_matches('!').trim().to_owned(), value))
    };
    plain.split(',').filter_map(part).collect()
}

#[test]
fn rules_and_board_name_served_metrics() {
    let served = served();
    let is_served = |name: &str, label: Option<&str>| {
        let mut lines = served.lines().filter(|line| !line.starts_with('#'));
        lines.any(|line| {
            let is_it = line.strip_prefix(name).is_some_and(|rest| rest.starts_with(['{', ' ']));
            is_it && label.is_none_or(|label| line.contains(label))
        })
    };
    let mut found = BTreeSet::new();
    for name in ["motord.rules.yml", "motord-board.json"] {
        let text = file(name);
        for (metric, selector) in named(&text) {
            assert!(is_served(metric, None), "{name} names {metric}, which the daemon does not serve");
            for (label, value) in labels(selector) {
                // Prometheus adds it.
                if label != "instance" {
                    let pair = format!("{label}=\"{value}\"");
                    assert!(is_served(metric, Some(&pair)), "{name} selects {metric} by {pair}");
                }
            }
            found.insert(metric.to_owned());
        }
    }
    assert!(found.len() > 15, "{found:?}");
}

#[test]
fn board_names_rules_that_are_recorded() {
    let (rules, board) = (file("motord.rules.yml"), file("motord-board.json"));
    let recorded: Vec<&str> =
        rules.lines().filter_map(|line| line.trim().strip_prefix("- record: ")).collect();
    let shown = board.match_indices("motord:").map(|(at, _)| &board[at..]);
    let shown: BTreeSet<&str> = shown.filter_map(|rest| rest.split_once('{')).map(|(name, _)| name).collect();
    assert_eq!(shown, recorded.into_iter().collect());
}

#[test]
fn names_and_labels_are_found_in_expressions() {
    let expression = r#"rate(motord_a_total{instance=~"$instance", phase!=\"active\"}[5m]) / motord_b"#;
    assert_eq!(
        named(expression).iter().map(|(name, _)| *name).collect::<Vec<_>>(),
        ["motord_a_total", "motord_b"]
    );
    let (_, selector) = named(expression)[0];
    let labels: Vec<_> = labels(selector);
    assert_eq!(labels[0], ("instance".into(), "$instance".into()));
    assert_eq!(labels[1], ("phase".into(), "active".into()));
}
