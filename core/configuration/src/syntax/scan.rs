//! Finds brackets without an end, and earlier keys, in text that is no TOML.

/// Returns the offset of the `{` or `[` that has no end, if that is what the error at `offset`
/// comes from: the next line begins a table or a key, or there is none.
pub(super) fn unclosed(text: &str, offset: usize) -> Option<usize> {
    let begin = text[..offset].rfind('\n').map_or(0, |end| end + 1);
    let end = text[offset..].find('\n').map_or(text.len(), |end| offset + end);
    let open = open_at(text, begin).or_else(|| open_at(text, end))?;
    let line_end = text[open..].find('\n').map_or(text.len(), |end| open + end);
    open_at(text, line_end).filter(|still| *still == open)?;
    let mut rest = text[line_end..].lines().map(str::trim);
    let next = rest.find(|line| !line.is_empty() && !line.starts_with('#')).unwrap_or_default();
    let is_list = text[open..].starts_with('[');
    (next.is_empty() || is_header(next) || (is_list && is_assignment(next))).then_some(open)
}

/// Returns the offset of the innermost bracket of a value that is open at `end`.
pub(super) fn open_at(text: &str, end: usize) -> Option<usize> {
    let mut open = Vec::new();
    let mut offset = 0;
    for line in text[..end].split_inclusive('\n') {
        if !(open.is_empty() && line.trim_start().starts_with('[')) {
            brackets(line, offset, &mut open);
        }
        offset += line.len();
    }
    open.pop()
}

/// Adds the brackets that this line opens to `open`, and removes those that it closes.
fn brackets(line: &str, offset: usize, open: &mut Vec<usize>) {
    let mut quote = None;
    let mut is_escaped = false;
    for (at, letter) in line.char_indices() {
        match (quote, letter) {
            (Some('"'), '\\') => is_escaped = !is_escaped,
            (Some(begun), letter) if letter == begun && !is_escaped => quote = None,
            (Some(_), _) => is_escaped = false,
            (None, '"' | '\'') => quote = Some(letter),
            (None, '#') => return,
            (None, '{' | '[') => open.push(offset + at),
            (None, '}' | ']') => drop(open.pop()),
            (None, _) => {}
        }
    }
}

/// `[cycle]` or `[[bus]]`.
fn is_header(line: &str) -> bool {
    let name = line.trim_start_matches('[');
    line.starts_with('[') && name.split(']').next().is_some_and(is_key)
}

/// `rate-hz = …`.
fn is_assignment(line: &str) -> bool {
    line.split_once('=').is_some_and(|(key, _)| is_key(key.trim()))
}

/// Letters that a key without quotes may have, and the points between keys.
pub(super) fn is_key(text: &str) -> bool {
    !text.is_empty() && text.chars().all(|letter| letter.is_ascii_alphanumeric() || "-_.".contains(letter))
}

/// Returns the line, from 1, where the key or table `name` of the line with `offset` was before.
pub(super) fn earlier(text: &str, offset: usize, name: &str) -> Option<usize> {
    let lines: Vec<_> = text[..offset].split('\n').collect();
    let (own, before) = lines.split_last()?;
    if own.contains(&format!("{name} =")) {
        return Some(lines.len());
    }
    let is_key_of = |line: &str| {
        let is_part = |key: &str| key.split('.').any(|part| part.trim() == name);
        line.split_once('=').is_some_and(|(key, _)| is_part(key))
    };
    let is_table = |line: &str| {
        let table = line.trim_start_matches('[').split(']').next().unwrap_or_default();
        line.starts_with('[') && table.rsplit('.').next() == Some(name)
    };
    let own = own.trim_start();
    // `[a.b]` and a key `b` in `[a]` have the same name; `[a]` and a key do not.
    let (of_key, of_table) = (!own.starts_with('[') || own.contains('.'), own.starts_with('['));
    let found = |line: &&str| (of_key && is_key_of(line)) || (of_table && is_table(line.trim_start()));
    // A key is unique in its table, and `[a.b]` in its `[[a]]`.
    let list =
        own.strip_prefix('[').and_then(|own| own.split_once('.')).map(|(list, _)| format!("[[{list}]]"));
    let begins = |line: &&str| match &list {
        Some(list) => line.trim_start().starts_with(list.as_str()),
        None => !own.starts_with('[') && is_header(line.trim_start()),
    };
    let first = before.iter().rposition(begins).map_or(0, |index| index + 1);
    let at = before[first..].iter().rposition(|line| found(&line.trim_start()));
    at.map(|index| first + index + 1)
}

/// Returns the offset of the `\"\"\"` or `'''` that has no end.
pub(super) fn unclosed_text(text: &str) -> Option<usize> {
    let mut open: Option<(usize, &str)> = None;
    let mut offset = 0;
    for line in text.split_inclusive('\n') {
        let mut at = 0;
        while let Some(letter) = line[at..].chars().next() {
            let rest = &line[at..];
            let long = ["\"\"\"", "'''"].into_iter().find(|marks| rest.starts_with(marks));
            match (open, long) {
                (Some((_, marks)), Some(found)) if marks == found => (open, at) = (None, at + 3),
                (None, Some(marks)) => (open, at) = (Some((offset + at, marks)), at + 3),
                (None, None) if letter == '#' => break,
                (None, None) if letter == '"' || letter == '\'' => {
                    let end = rest[1..].find(letter).map_or(rest.len(), |end| end + 2);
                    at += end;
                }
                _ => at += letter.len_utf8(),
            }
        }
        offset += line.len();
    }
    open.map(|(at, _)| at)
}
