//! Writes the tables of `docs/configuration.md` from the table of keys and the known models.

use motord_protocol::profile::{ReplyId, shipped};

use super::entry::Row;
use super::keys;

/// Returns `document` with every generated table replaced between its marks:
///
/// ```text
/// <!-- keys of motor.limits -->
/// …
/// <!-- end of keys of motor.limits -->
/// ```
///
/// Adds a table without marks at the end, so that every key is in the document.
#[must_use]
pub fn reference(document: &str) -> String {
    let keys = keys::reference().into_iter().map(|(path, rows)| {
        (format!("keys of {path}"), table(Row::HEAD, rows.into_iter().map(Row::into_cells)))
    });
    keys.chain([("models".to_owned(), models())]).fold(document.to_owned(), |document, (name, table)| {
        let (begin, end) = (format!("<!-- {name} -->"), format!("<!-- end of {name} -->"));
        let (before, rest) = document.split_once(&begin).unwrap_or((&document, ""));
        let (_, after) = rest.split_once(&end).unwrap_or(("", "\n"));
        format!("{before}{begin}\n{table}{end}{after}")
    })
}

/// Returns the table of models and the defaults that they give.
fn models() -> String {
    let head = [
        "model",
        "vendor",
        "`host-id`",
        "gear ratio",
        "rated torque, N·m",
        "peak torque, N·m",
        "max velocity, rad/s",
        "ends: rad, rad/s, N·m, kp, kd",
    ];
    let models = shipped()
        .into_iter()
        .flat_map(|(profile, _)| profile.models.iter().map(move |model| (profile, model)));
    let rows = models.map(|(profile, model)| {
        let numbers = [model.gear_ratio, model.rated_torque, model.peak_torque, model.max_velocity];
        let [gear_ratio, rated, peak, velocity] = numbers.map(|number| number.to_string());
        let host_id = match profile.ids.reply {
            ReplyId::Offset(offset) => format!("{offset:#x} + `id`"),
            ReplyId::Shared(shared) => format!("{shared:#x}"),
        };
        let ends = model.ends.map_or_else(
            || "by constants".to_owned(),
            |ends| format!("{}, {}, {}, {}, {}", ends.position, ends.velocity, ends.torque, ends.kp, ends.kd),
        );
        let name = format!("`{}`", model.name);
        [name, profile.name.to_owned(), host_id, gear_ratio, rated, peak, velocity, ends]
    });
    table(head, rows)
}

fn table<const COLUMNS: usize>(
    head: [&str; COLUMNS],
    rows: impl Iterator<Item = [String; COLUMNS]>,
) -> String {
    let line = |cells: &[&str]| format!("| {} |\n", cells.join(" | "));
    let rows = rows.map(|cells| line(&cells.each_ref().map(String::as_str)));
    [line(&head), line(&["---"; COLUMNS])].into_iter().chain(rows).collect()
}
