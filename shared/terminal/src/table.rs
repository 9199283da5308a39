//! Tables, colours and numbers on a terminal.

use motord_untrusted::printable_line;
use std::io::{self, IsTerminal, Write};

/// Colour of a piece of text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colour {
    /// The default colour of the terminal.
    Plain,
    /// Information. Legible on a dark and on a light background, which yellow is not.
    Magenta,
    /// Action needed.
    Red,
    /// A heading.
    Bold,
}

impl Colour {
    fn code(self) -> &'static str {
        match self {
            Self::Plain => "0",
            Self::Magenta => "35",
            Self::Red => "31",
            Self::Bold => "1",
        }
    }
}

/// The choice between coloured and plain text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Palette {
    coloured: bool,
}

impl Palette {
    /// Colours text on a terminal, unless `NO_COLOR` is set (<https://no-color.org>) or the
    /// terminal is dumb.
    pub fn of_stdout() -> Self {
        let refused = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
        let dumb = std::env::var_os("TERM").is_some_and(|value| value == "dumb");
        Self { coloured: io::stdout().is_terminal() && !refused && !dumb }
    }

    /// Returns whether text is coloured.
    pub fn is_coloured(self) -> bool {
        self.coloured
    }

    /// Returns the text of `cell` in its colour.
    pub fn paint(self, cell: &Cell) -> String {
        let Cell { text, colour } = cell;
        if self.coloured && *colour != Colour::Plain && !text.is_empty() {
            format!("\x1b[{}m{text}\x1b[0m", colour.code())
        } else {
            text.clone()
        }
    }
}

/// One entry of a [`Table`].
#[derive(Debug, Clone)]
pub struct Cell {
    text: String,
    colour: Colour,
}

impl Cell {
    /// Creates a cell with a colour. Control characters in the text are spelled out.
    pub fn new(text: impl ToString, colour: Colour) -> Self {
        Self { text: printable_line(&text.to_string()).into_owned(), colour }
    }

    /// Creates a cell without colour.
    pub fn plain(text: impl ToString) -> Self {
        Self::new(text, Colour::Plain)
    }

    /// Creates a cell with `digits` decimals, or a dash for an unknown number.
    pub fn number(value: Option<f64>, digits: usize) -> Self {
        Self::plain(number(value, digits))
    }

    /// Creates a cell for a counter that should be 0.
    pub fn counter(count: u32) -> Self {
        Self::new(count, if count == 0 { Colour::Plain } else { Colour::Magenta })
    }
}

/// Rows of cells under headings. The first column is aligned left, the others right.
#[derive(Debug, Clone)]
pub struct Table {
    headings: Vec<&'static str>,
    rows: Vec<Vec<Cell>>,
}

impl Table {
    /// Creates a table without rows.
    pub fn new(headings: &[&'static str]) -> Self {
        Self { headings: headings.to_vec(), rows: Vec::new() }
    }

    /// Adds a row, one cell per heading.
    pub fn row(&mut self, cells: Vec<Cell>) {
        debug_assert_eq!(cells.len(), self.headings.len(), "one cell per heading");
        self.rows.push(cells);
    }

    /// Removes the column with this heading.
    pub fn remove(&mut self, heading: &str) {
        if let Some(column) = self.headings.iter().position(|other| *other == heading) {
            self.headings.remove(column);
            for row in &mut self.rows {
                row.remove(column);
            }
        }
    }

    /// Writes the table, or nothing when it has no rows.
    ///
    /// # Errors
    ///
    /// When `out` cannot be written.
    pub fn write(&self, out: &mut dyn Write, palette: Palette) -> io::Result<()> {
        if self.rows.is_empty() {
            return Ok(());
        }
        let widths = self.widths();
        let headings = self.headings.iter().map(|heading| Cell::new(heading, Colour::Bold)).collect();
        for row in std::iter::once(&headings).chain(&self.rows) {
            writeln!(out, "{}", line(row, &widths, palette))?;
        }
        Ok(())
    }

    fn widths(&self) -> Vec<usize> {
        let width = |column: usize, heading: &str| {
            let cells = self.rows.iter().filter_map(|row| row.get(column));
            cells.map(|cell| cell.text.chars().count()).fold(heading.chars().count(), usize::max)
        };
        self.headings.iter().enumerate().map(|(column, heading)| width(column, heading)).collect()
    }
}

fn line(row: &[Cell], widths: &[usize], palette: Palette) -> String {
    let mut line = String::new();
    for (column, (cell, &width)) in row.iter().zip(widths).enumerate() {
        // Colour codes have no width on the screen, so padding stays outside of them.
        let padding = " ".repeat(width.saturating_sub(cell.text.chars().count()));
        let text = palette.paint(cell);
        if column == 0 {
            line.push_str(&text);
            line.push_str(&padding);
        } else {
            line.push_str("  ");
            line.push_str(&padding);
            line.push_str(&text);
        }
    }
    line.truncate(line.trim_end().len());
    line
}

/// Formats `value` with `digits` decimals, an unknown one as a dash, and a zero without a minus
/// sign.
pub fn number(value: Option<f64>, digits: usize) -> String {
    let Some(value) = value.filter(|value| value.is_finite()) else { return "-".to_owned() };
    let text = format!("{value:.digits$}");
    let is_zero = text.chars().all(|letter| matches!(letter, '-' | '0' | '.'));
    if is_zero { text.trim_start_matches('-').to_owned() } else { text }
}

/// Parses a number from `least` to `most`.
///
/// # Errors
///
/// The expected range, as text for clap.
pub fn within(text: &str, least: f64, most: f64) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (least..=most).contains(number));
    number.ok_or_else(|| format!("expected {least} to {most}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(palette: Palette) -> String {
        let mut table = Table::new(&["joint", "rad"]);
        table.row(vec![Cell::plain("fl-hip"), Cell::number(Some(-1.5), 2)]);
        table.row(vec![Cell::new("knee", Colour::Red), Cell::number(Some(f64::NAN), 2)]);
        let mut out = Vec::new();
        table.write(&mut out, palette).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn columns_line_up() {
        assert_eq!(written(Palette { coloured: false }), "joint     rad\nfl-hip  -1.50\nknee        -\n");
    }

    #[test]
    fn colour_does_not_move_the_columns() {
        let plain = written(Palette { coloured: true })
            .replace("\x1b[1m", "")
            .replace("\x1b[31m", "")
            .replace("\x1b[0m", "");
        assert_eq!(plain, written(Palette { coloured: false }));
    }

    #[test]
    fn half_a_code_below_zero_is_zero() {
        assert_eq!(number(Some(-0.0004), 3), "0.000");
        assert_eq!(number(Some(-0.0006), 3), "-0.001");
        assert_eq!(number(Some(f64::NAN), 3), "-");
        assert_eq!(number(None, 3), "-");
    }

    #[test]
    fn out_of_range_and_nonnumbers_are_refused() {
        assert_eq!(within("0.5", 0.5, 2.0), Ok(0.5));
        for wrong in ["0.4", "2.1", "nan", "inf", "", "1s"] {
            assert_eq!(within(wrong, 0.5, 2.0), Err("expected 0.5 to 2".to_owned()));
        }
    }
}
