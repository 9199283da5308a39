//! `[ids]`: the ids on the bus.

use super::table::Table;
use crate::profile::{Ids, ReplyId};

/// The largest id of 11 bits.
const LARGEST: i64 = 0x7FF;

/// Reads `[ids]`.
pub(super) fn read(ids: &Table<'_>) -> Option<Ids> {
    ids.refuse_unknown(&["largest", "largest-reply", "reply-offset", "shared-reply", "also-receives"]);
    let hint = "give the largest id of a motor, such as 15";
    let largest = ids.require("largest", ids.integer("largest", 1, 0xFF), hint);
    let largest_reply = ids.integer("largest-reply", 0, LARGEST);
    let reply = reply(ids);
    let also_receives = ids.integers("also-receives", 1, LARGEST).unwrap_or_default();
    let read = Ids {
        largest: largest? as u8,
        largest_reply: largest_reply.unwrap_or(LARGEST) as u16,
        reply: reply?,
        also_receives: also_receives.into_iter().map(|offset| offset as u16).collect::<Vec<_>>().leak(),
    };
    check(ids, &read);
    Some(read)
}

fn reply(ids: &Table<'_>) -> Option<ReplyId> {
    let offset = ids.integer("reply-offset", 1, LARGEST).map(|offset| ReplyId::Offset(offset as u16));
    let shared = ids.integer("shared-reply", 0, LARGEST).map(|shared| ReplyId::Shared(shared as u16));
    if ids.has("reply-offset") && ids.has("shared-reply") {
        ids.problem("shared-reply", "excludes reply-offset; remove one of them");
    }
    let hint = "give the reply id of a motor minus its id, or shared-reply where all motors have one";
    match ids.has("shared-reply") {
        true => shared,
        false => ids.require("reply-offset", offset, hint),
    }
}

/// Reports ids beyond 11 bits, and replies that a motor takes for a command.
fn check(table: &Table<'_>, ids: &Ids) {
    let key = if table.has("shared-reply") { "shared-reply" } else { "reply-offset" };
    let reply = |id: u8| match ids.reply {
        ReplyId::Offset(offset) => u32::from(offset) + u32::from(id),
        ReplyId::Shared(shared) => shared.into(),
    };
    let replies = || (1..=ids.largest).map(reply);
    let most = replies().max().unwrap_or_default();
    if most > u32::from(ids.largest_reply) {
        let largest = ids.largest_reply;
        table.problem(
            key,
            format!("gives a reply the id {most:#x}, beyond largest-reply = {largest:#x}; lower one of them"),
        );
    }
    for &also in ids.also_receives {
        let commands = u32::from(also) + 1..=u32::from(also) + u32::from(ids.largest);
        if *commands.end() > LARGEST as u32 {
            let end = *commands.end();
            table.problem("also-receives", format!("{also:#x} gives a command the id {end:#x}, and 0x7ff is the largest; lower it, or largest"));
        }
        if let Some(id) = replies().find(|id| commands.contains(id)) {
            let message = format!(
                "a reply with the id {id:#x} is a command of {also:#x} + id (also-receives); give another {key}"
            );
            table.problem(key, message);
        }
    }
}
