//! Pieces of text for a screen.

use ratatui::style::{Color, Style, Stylize};
use ratatui::text::{Line, Span};
use std::time::Duration;

const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// The style of an alarm: a bar in the colours of the terminal, exchanged. It has the contrast of
/// the text. Red has 2.8:1 on the black of some terminals.
pub(super) const ALARM: Style = Style::new().bold().reversed();
/// The style of a warning. Magenta is legible on a dark and on a light background. A word, a mark
/// or a number always says the same as the colour.
pub(super) const WARNING: Style = Style::new().fg(Color::Magenta);

/// Returns an alarm.
pub(super) fn alarm(text: impl Into<String>) -> Span<'static> {
    Span::styled(text.into(), ALARM)
}

/// The style of an urgent alarm, and of the key of the emergency stop. It names both colours, so it
/// depends on no background.
pub(super) const BANNER: Style = Style::new().bold().fg(Color::White).bg(Color::Red);

/// Returns an urgent alarm: a red line of `width` characters.
pub(super) fn banner(text: &str, width: usize) -> Line<'static> {
    Span::styled(format!("{text:<width$}"), BANNER).into()
}

/// Returns a warning.
pub(super) fn warning(text: impl Into<String>) -> Span<'static> {
    Span::styled(text.into(), WARNING)
}

/// A heading.
pub(super) fn bold(text: impl Into<String>) -> Span<'static> {
    Span::from(text.into()).bold()
}

/// Returns dim text.
pub(super) fn dim(text: impl Into<String>) -> Span<'static> {
    Span::from(text.into()).dim()
}

/// Aligns `text` left in exactly `width` characters.
pub(super) fn left(text: &str, width: usize, style: Style) -> Span<'static> {
    let short = shortened(text, width);
    Span::styled(format!("{short:<width$}"), style)
}

/// Aligns `text` right in at least `width` characters.
pub(super) fn right(text: &str, width: usize, style: Style) -> Span<'static> {
    Span::styled(format!("{text:>width$}"), style)
}

/// Shortens `text` to `width` characters, with an ellipsis.
pub(super) fn shortened(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let kept: String = text.chars().take(width.saturating_sub(1)).collect();
    if width == 0 { kept } else { format!("{kept}…") }
}

/// Formats a time in s, min or h.
pub(super) fn duration(time: Duration) -> String {
    match time.as_secs() {
        0..100 => format!("{} s", time.as_secs()),
        100..6000 => format!("{} min", time.as_secs() / 60),
        6000.. => format!("{} h", time.as_secs() / 3600),
    }
}

/// Wraps `text` in lines of at most `width` characters. Each line after the first begins with
/// `indent` spaces. Words are never broken.
pub(super) fn wrapped(text: &str, width: usize, indent: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let line = lines.last().map_or("", String::as_str);
        let is_first = line.trim().is_empty();
        if !is_first && line.chars().count() + 1 + word.chars().count() > width {
            lines.push(" ".repeat(indent));
        }
        let line = lines.last_mut().expect("there is a first line");
        if !line.trim().is_empty() {
            line.push(' ');
        }
        line.push_str(word);
    }
    lines
}

/// Fills lines with `entries`. Returns at most `most` lines; `rest` formats the last line from the
/// number of entries left out.
pub(super) fn flowed(
    entries: Vec<Line<'static>>,
    width: usize,
    most: usize,
    rest: impl Fn(usize) -> String,
) -> Vec<Line<'static>> {
    const GAP: &str = "  ";
    let mut lines: Vec<(Line<'static>, usize)> = Vec::new();
    for mut entry in entries {
        match lines.last_mut() {
            Some((line, count)) if line.width() + GAP.len() + entry.width() <= width => {
                line.push_span(GAP);
                line.spans.append(&mut entry.spans);
                *count += 1;
            }
            _ => lines.push((entry, 1)),
        }
    }
    if lines.len() > most {
        let left_out: usize = lines.drain(most.saturating_sub(1)..).map(|(_, count)| count).sum();
        lines.push((dim(rest(left_out)).into(), 0));
        lines.truncate(most);
    }
    lines.into_iter().map(|(line, _)| line).collect()
}

/// Draws the last `width` of `values` as bars. The highest bar is the largest value.
pub(super) fn sparkline(values: impl DoubleEndedIterator<Item = f64>, width: usize) -> String {
    let mut values: Vec<f64> = values.rev().take(width).collect();
    values.reverse();
    let largest = values.iter().copied().fold(0.0, f64::max);
    let bar = |value: f64| {
        let height = (value / largest * (BARS.len() - 1) as f64).round();
        BARS[if height.is_finite() { (height as usize).min(BARS.len() - 1) } else { 0 }]
    };
    values.into_iter().map(bar).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_sentence_is_wrapped_at_its_spaces() {
        assert_eq!(
            wrapped("An emergency stop was requested.", 18, 2),
            ["An emergency stop", "  was requested."]
        );
        assert_eq!(wrapped("motorctl", 3, 2), ["motorctl"]);
        assert_eq!(wrapped("", 3, 2), [""]);
    }

    #[test]
    fn entries_that_do_not_fit_are_counted() {
        let entries = || (0..5).map(|entry| Line::from(format!("bus{entry}"))).collect();
        let text = |most| -> Vec<String> {
            let rest = |count| format!("{count} more");
            flowed(entries(), 10, most, rest).iter().map(ToString::to_string).collect()
        };
        assert_eq!(text(3), ["bus0  bus1", "bus2  bus3", "bus4"]);
        assert_eq!(text(2), ["bus0  bus1", "3 more"]);
        assert_eq!(text(0), [""; 0]);
    }

    #[test]
    fn a_sparkline_shows_the_newest_values() {
        assert_eq!(sparkline([9.0, 0.0, 3.5, 7.0].into_iter(), 3), "▁▅█");
        assert_eq!(sparkline([0.0, f64::NAN].into_iter(), 3), "▁▁");
    }
}
