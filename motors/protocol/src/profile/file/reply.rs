//! `[reply]`: the layout of a state, and the bits that its fields have.

use super::table::{Table, keep};
use crate::profile::{Flags, Ids, ReplyLayout, Temperature};

/// The codes of position, velocity and torque end before this byte.
const CODES_END: usize = 6;
/// Temperatures of a state.
const TEMPERATURES_MAX: usize = 2;

/// A layout, with the bits that are taken.
pub(super) struct Layout {
    pub(super) layout: ReplyLayout,
    /// Byte, bits and field.
    taken: Vec<(usize, u8, String)>,
}

impl Layout {
    /// Takes `bits` of a byte for `field`. Reports bits that are another field's, and a byte that no
    /// reply has.
    pub(super) fn take(&mut self, (table, key): (&Table<'_>, &str), byte: usize, bits: u8, field: &str) {
        let other = self.taken.iter().find(|(at, taken, _)| *at == byte && taken & bits != 0);
        let most = self.layout.lengths[1];
        if let Some((_, _, other)) = other {
            table.problem(
                key,
                format!("{field} overlaps {other} in byte {byte} of the reply; give another byte"),
            );
        } else if byte >= most {
            table.problem(key, format!("{field} is in byte {byte}, counted from 0, and a reply has at most {most} bytes; give another byte"));
        }
        self.taken.push((byte, bits, field.to_owned()));
    }
}

/// Reads `[reply]`.
pub(super) fn read(reply: &Table<'_>, ids: Option<&Ids>) -> Option<Layout> {
    reply.refuse_unknown(&["bytes", "id-bits", "temperature", "flags"]);
    let hint = "give fewest and most bytes of a state, such as [8, 8]";
    let lengths = reply.require("bytes", reply.lengths("bytes", CODES_END as i64), hint);
    let mask = reply.integer("id-bits", 1, 0xFF).unwrap_or(0xFF) as u8;
    check_mask(reply, mask, ids);
    let layout = ReplyLayout { lengths: lengths?, id_mask: mask, temperatures: &[], flags: None };
    let mut layout = Layout { layout, taken: vec![(0, mask, "the id".to_owned())] };
    let codes = (1..CODES_END).map(|byte| (byte, 0xFF, "position, velocity and torque".to_owned()));
    layout.taken.extend(codes);
    let items = reply.list("temperature");
    if items.len() > TEMPERATURES_MAX {
        reply.problem("temperature", "there are more than 2; remove some");
    }
    let temperatures: Vec<_> = items.iter().filter_map(|item| temperature(item, &mut layout)).collect();
    layout.layout.temperatures = temperatures.leak();
    if reply.has("flags") {
        layout.layout.flags = flags(&reply.section("flags"), &mut layout);
    }
    Some(layout)
}

/// Reports bits of the first byte that cannot hold every id.
fn check_mask(reply: &Table<'_>, mask: u8, ids: Option<&Ids>) {
    if mask.wrapping_add(1) & mask != 0 {
        reply.problem(
            "id-bits",
            format!("{mask:#x} has a gap; give the lowest bits of the byte, such as 0xf"),
        );
    } else if let Some(largest) = ids.map(|ids| ids.largest).filter(|largest| *largest > mask) {
        reply.problem(
            "id-bits",
            format!("{mask:#x} cannot hold the largest id {largest:#x}; add bits, or lower ids.largest"),
        );
    }
}

fn temperature(table: &Table<'_>, layout: &mut Layout) -> Option<Temperature> {
    table.refuse_unknown(&["of", "byte", "bits", "codes-per-celsius", "negative-from"]);
    let of = table.require("of", table.text("of"), "name the measured part, such as \"motor\"");
    let at = table.require("byte", table.integer("byte", 0, 7), "give its first byte, counted from 0");
    let bits = table.integer("bits", 8, 16).unwrap_or(8) as u32;
    let per_celsius = table.single("codes-per-celsius", 1000.0).unwrap_or(1.0);
    let codes = 1_i64 << bits;
    let negative_from = table.integer("negative-from", 1, codes - 1).unwrap_or(codes / 2) as u16;
    let (of, at) = (of?, at? as usize);
    let field = format!("the temperature of {of}");
    let first = u8::MAX >> (8 * bits.div_ceil(8) - bits);
    layout.take((table, "byte"), at, first, &field);
    if bits > 8 {
        layout.take((table, "byte"), at + 1, u8::MAX, &field);
    }
    Some(Temperature { of: keep(of), at, bits, per_celsius, negative_from })
}

fn flags(table: &Table<'_>, layout: &mut Layout) -> Option<Flags> {
    table.refuse_unknown(&["byte", "mode", "on", "no-mode", "fault"]);
    let at = table.require("byte", table.integer("byte", 0, 7), "give the byte, counted from 0")? as usize;
    let bits = |key| table.require(key, table.integer(key, 0, 0xF), "give it of the upper four bits");
    let [mode, on, no_mode, fault] = [bits("mode"), bits("on"), bits("no-mode"), bits("fault")];
    let [mode, on, no_mode, fault] = [mode? as u8, on? as u8, no_mode? as u8, fault? as u8];
    layout.take((table, "byte"), at, 0xF0, "the status");
    for (key, value) in [("on", on), ("no-mode", no_mode)] {
        if value & !mode != 0 {
            table.problem(
                key,
                format!(
                    "{value:#06b} is not within the bits of mode, {mode:#06b}; give a value of these bits"
                ),
            );
        }
    }
    if on == no_mode {
        table.problem("no-mode", "is the mode of an enabled motor too; give another");
    }
    if fault & mode != 0 {
        table.problem("fault", "is a bit of the mode too; give another");
    }
    Some(Flags { at, mode, on, no_mode, fault })
}
