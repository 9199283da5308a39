//! The measured quantities of `State` in the stub of the Python package, from the table of a joint's
//! state.

use motord_shared::{Field, JointState};

const STUB: &str = include_str!("../../../../client/python/python/motord/_motord.pyi");
/// The lines around the part that comes from the table.
const BEGIN: &str =
    "    # The measured quantities: MOTORD_WRITE_DOCS=1 cargo test -p motord-house generated\n";
const END: &str = "    # End of the measured quantities.\n";

/// Returns the stub with the quantities of the table.
pub(super) fn of_table() -> String {
    let (before, rest) = STUB.split_once(BEGIN).expect("the stub has both lines");
    let (_, after) = rest.split_once(END).expect("the stub has both lines");
    let properties: String = JointState::FIELDS.iter().filter_map(property).collect();
    format!("{before}{BEGIN}{properties}{END}{after}")
}

/// A property with the docstring of `client/python/src/state.rs`.
fn property(field: &Field) -> Option<String> {
    let (name, Field { doc, unit, .. }) = (field.python?, field);
    Some(format!(
        "    @property\n    def {name}(self) -> _Array:\n        \"\"\"{doc}\n\n        \
         A number for each joint, {unit}; NaN until its motor has reported it.\n        \"\"\"\n"
    ))
}
