//! Screens as pictures for the documents.

use super::super::view::View;
use super::robot::{picture, stopped};
use super::{buffer, check_file};
use ratatui::buffer::{Buffer, Cell};
use ratatui::style::{Color, Modifier};
use std::fmt::Write;

/// The colours of a terminal: background, default, red, magenta and white.
struct Theme([&'static str; 5]);

const DARK: Theme = Theme(["#1d2021", "#ebdbb2", "#fb4934", "#d3869b", "#ffffff"]);
const LIGHT: Theme = Theme(["#ffffff", "#202020", "#cd0000", "#a000a0", "#ffffff"]);

/// Size of a character in the picture of the README, pixels.
const CHARACTER: (usize, usize) = (8, 17);

/// A screen as SVG: a text for each run of cells that look alike, and a square for each Braille
/// dot. Fonts draw Braille with another width than letters.
fn svg(buffer: &Buffer, theme: &Theme) -> String {
    let (width, height) = (usize::from(buffer.area.width), usize::from(buffer.area.height));
    let (right, bottom) = ((width + 2) * CHARACTER.0, (height + 1) * CHARACTER.1);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {right} {bottom}\" font-family=\"monospace\" \
         font-size=\"13\">\n<rect width=\"{right}\" height=\"{bottom}\" rx=\"6\" fill=\"{}\"/>\n",
        theme.0[0]
    );
    for (y, line) in buffer.content.chunks(width).enumerate() {
        let mut x = 0;
        for run in line.chunk_by(|a, b| (a.fg, a.bg, a.modifier) == (b.fg, b.bg, b.modifier)) {
            draw_run(&mut svg, (x, y), run, theme);
            x += run.len();
        }
    }
    svg + "</svg>\n"
}

fn draw_run(svg: &mut String, (x, y): (usize, usize), run: &[Cell], theme: &Theme) {
    let first = &run[0];
    let text: String = run.iter().map(Cell::symbol).collect();
    let (left, top) = ((x + 1) * CHARACTER.0, y * CHARACTER.1 + CHARACTER.1 / 2);
    let width = run.len() * CHARACTER.0;
    let is_reversed = first.modifier.contains(Modifier::REVERSED);
    if is_reversed || first.bg != Color::Reset {
        let fill = theme.colour(if is_reversed { first.fg } else { first.bg });
        writeln!(
            svg,
            "<rect x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{}\" fill=\"{fill}\"/>",
            CHARACTER.1
        )
        .unwrap();
    }
    if text.trim().is_empty() {
        return;
    }
    let fill = if is_reversed { theme.0[0] } else { theme.colour(first.fg) };
    let weight = if first.modifier.contains(Modifier::BOLD) { " font-weight=\"bold\"" } else { "" };
    let opacity = if first.modifier.contains(Modifier::DIM) { " opacity=\"0.6\"" } else { "" };
    let squares: String =
        run.iter().enumerate().map(|(index, cell)| dots(left + index * CHARACTER.0, top, cell)).collect();
    if !squares.is_empty() {
        writeln!(svg, "<path d=\"{squares}\" fill=\"{fill}\"{opacity}/>").unwrap();
    }
    let text = text.replace(is_braille, " ").replace('&', "&amp;").replace('<', "&lt;");
    if text.trim().is_empty() {
        return;
    }
    let base = top + CHARACTER.1 - 4;
    writeln!(
        svg,
        "<text x=\"{left}\" y=\"{base}\" textLength=\"{width}\" xml:space=\"preserve\" fill=\"{fill}\"{weight}{opacity}>{text}</text>"
    )
    .unwrap();
}

fn is_braille(character: char) -> bool {
    ('\u{2800}'..='\u{28FF}').contains(&character)
}

/// Returns the dots of a Braille cell as squares of a path.
fn dots(left: usize, top: usize, cell: &Cell) -> String {
    /// Column and row of each bit.
    const BITS: [(usize, usize); 8] = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3)];
    let Some(character) = cell.symbol().chars().next().filter(|&character| is_braille(character)) else {
        return String::new();
    };
    let set = BITS.iter().enumerate().filter(|(bit, _)| (u32::from(character) >> bit) & 1 == 1);
    set.map(|(_, (column, row))| format!("M{} {}h2v2h-2z", left + 1 + 4 * column, top + 1 + 4 * row))
        .collect()
}

impl Theme {
    fn colour(&self, colour: Color) -> &'static str {
        match colour {
            Color::Red => self.0[2],
            Color::Magenta => self.0[3],
            Color::White => self.0[4],
            _ => self.0[1],
        }
    }
}

#[test]
fn pictures_of_documents_are_the_current_monitor() {
    let stopped = picture(stopped());
    check_file("../docs/monitor.svg", &svg(&buffer(80, 24, &stopped, &mut View::default()), &DARK));
    check_file("../docs/monitor-large.svg", &svg(&buffer(160, 50, &stopped, &mut View::default()), &LIGHT));
}
