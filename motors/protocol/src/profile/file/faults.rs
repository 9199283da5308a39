//! `[faults]`: the way in which a motor reports its faults.

use super::reply::Layout;
use super::table::{Table, plain, suggestion};
use crate::fault::Faults;
use crate::profile::{FaultReply, FaultReport, Healthy, Status};

/// Bits of a report that a moving state never has all zero: the upper seven of the velocity, and all
/// of the torque. In a state they would mean full negative velocity and torque.
const MOTION: [u8; 8] = [0, 0, 0, 0xFE, 0xFF, 0xFF, 0, 0];

/// The ways of a report.
const REPORTS: [&str; 3] = ["asked", "in-every-reply", "never"];

/// Reads `[faults]`.
pub(super) fn read(faults: &Table<'_>, layout: Option<&mut Layout>) -> Option<FaultReport> {
    let hint = "give \"asked\", \"in-every-reply\" or \"never\"";
    match faults.require("report", faults.text("report"), hint)? {
        "asked" => asked(faults).map(FaultReport::Asked),
        "in-every-reply" => status(faults, layout?).map(FaultReport::InEveryReply),
        "never" => {
            faults.refuse_unknown(&["report"]);
            Some(FaultReport::Never)
        }
        other => {
            let hint = suggestion(other, REPORTS.into_iter());
            faults.problem("report", format!("unknown value `{}`; {hint}", plain(other)));
            None
        }
    }
}

fn asked(faults: &Table<'_>) -> Option<FaultReply> {
    faults.refuse_unknown(&["report", "number-bytes", "bytes", "zeros", "bits"]);
    let hint = "give the number of bytes of the fault number, such as 4";
    let bytes = faults.require("number-bytes", faults.integer("number-bytes", 1, 4), hint);
    let hint = "give fewest and most bytes of a report, such as [8, 8]";
    let lengths = faults.require("bytes", faults.lengths("bytes", 2), hint);
    let zeros = zeros(faults);
    let words = words(&faults.section("bits"), 31);
    let words: Vec<_> = words.into_iter().map(|(bit, faults)| (1_u32 << bit, faults)).collect();
    let (bytes, lengths, zeros) = (bytes? as usize, lengths?, zeros?);
    if lengths[0] <= bytes {
        faults.problem(
            "bytes",
            format!("a report has the id and {bytes} bytes of its number; give at least {}", bytes + 1),
        );
    }
    check_bits(faults, &words, (bytes, &zeros));
    Some(FaultReply { bytes, lengths, zeros, words: words.leak() })
}

/// Reads the bits that are zero in every report, and checks that no moving state has them all zero.
fn zeros(faults: &Table<'_>) -> Option<[u8; 8]> {
    let hint = "list for each of 8 bytes the bits that are zero in every report, such as [0, 0, 0, 0xFE, 0xFF, 0xFF, 0xFF, 0xFF]";
    let listed = faults.require("zeros", faults.integers("zeros", 0, 0xFF), hint)?;
    let Ok(zeros) = <[u8; 8]>::try_from(listed.iter().map(|byte| *byte as u8).collect::<Vec<_>>()) else {
        faults.problem("zeros", format!("lists {} bytes; list 8", listed.len()));
        return None;
    };
    if zeros[0] != 0 {
        faults.problem("zeros", "the first byte of a report is the motor's id; write 0 for it");
    }
    if zeros.iter().zip(MOTION).any(|(zeros, motion)| zeros & motion != motion) {
        faults.problem(
            "zeros",
            "a state of a moving motor can have all these bits zero, and would be read as a fault report; include all bits of \
             the torque and the upper seven of the velocity: 0xFE, 0xFF and 0xFF in the fourth to sixth byte",
        );
    }
    Some(zeros)
}

/// Reports faults that the number cannot hold, or whose bit is zero in every report.
fn check_bits(faults: &Table<'_>, words: &[(u32, Faults)], (bytes, zeros): (usize, &[u8; 8])) {
    let table = faults.section("bits");
    for bit in words.iter().map(|(word, _)| word.trailing_zeros()) {
        let (byte, key) = (1 + bit as usize / 8, bit.to_string());
        if byte > bytes {
            table.problem(
                &key,
                format!("the number has {bytes} bytes, without this bit; remove it, or raise number-bytes"),
            );
        } else if zeros[byte] >> (bit % 8) & 1 == 1 {
            table.problem(&key, "this bit is zero in every report, by zeros; remove it here or there");
        }
    }
}

fn status(faults: &Table<'_>, layout: &mut Layout) -> Option<Status> {
    faults.refuse_unknown(&["report", "byte", "shift", "off", "on", "ok", "codes"]);
    let at =
        faults.require("byte", faults.integer("byte", 0, 7), "give the byte of the code, counted from 0");
    let shift = faults.integer("shift", 0, 7).unwrap_or(0) as u32;
    let most = u8::MAX >> shift;
    let healthy = healthy(faults, most);
    let codes = faults.section("codes");
    let words = words(&codes, most.into());
    let words: Vec<_> = words.into_iter().map(|(code, faults)| (code as u8, faults)).collect();
    let at = at? as usize;
    layout.take((faults, "byte"), at, most << shift, "the fault code");
    let fewest = layout.layout.lengths[0];
    if at >= fewest {
        faults.problem(
            "byte",
            format!("the shortest reply has {fewest} bytes, without byte {at}; raise the fewest reply.bytes"),
        );
    }
    if layout.layout.flags.is_some() {
        faults.problem(
            "report",
            "a reply with flags names its faults on request; remove [reply.flags], or write \"asked\"",
        );
    }
    let healthy = healthy?;
    let known: &[u8] = match &healthy {
        Healthy::Mode { off, on } => &[*off, *on],
        Healthy::Code(code) => &[*code],
    };
    for code in words.iter().map(|(code, _)| *code).filter(|code| known.contains(code)) {
        codes.problem("", format!("{code} is the code of a motor without a fault too; remove one of them"));
    }
    Some(Status { at, shift, healthy, words: words.leak() })
}

/// Reads the codes of a motor without a fault.
fn healthy(faults: &Table<'_>, most: u8) -> Option<Healthy> {
    let code = |key| faults.integer(key, 0, most.into()).map(|code| code as u8);
    if faults.has("ok") {
        if faults.has("off") || faults.has("on") {
            faults.problem("ok", "excludes off and on; remove it, or both of them");
        }
        return code("ok").map(Healthy::Code);
    }
    let hint = "give the codes off and on, or ok where one code means no fault";
    let (off, on) = (faults.require("off", code("off"), hint), faults.require("on", code("on"), hint));
    let (off, on) = (off?, on?);
    if off == on {
        faults.problem("on", format!("{on} is the code of a disabled motor too; give another"));
    }
    Some(Healthy::Mode { off, on })
}

/// Reads a table of numbers and their faults.
fn words(table: &Table<'_>, most: u32) -> Vec<(u32, Faults)> {
    let mut words = Vec::new();
    let mut before = None;
    for (key, number) in table.numbered(most) {
        if before.replace(number) == Some(number) {
            table.problem(key, format!("{number} is there twice; remove one of them"));
        }
        let Some(name) = table.text(key) else { continue };
        match Faults::named().find(|(known, _)| known == name) {
            Some((_, faults)) => words.push((number, faults)),
            None => {
                let known: Vec<_> = Faults::named().map(|(known, _)| known).collect();
                let hint = suggestion(name, known.iter().map(String::as_str));
                table.problem(key, format!("unknown fault `{}`; {hint}", plain(name)));
            }
        }
    }
    words
}
