//! The choices of the user, and the meaning of the keys.

use super::selection::Selection;
use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use motord_terminal::Palette;

/// The key of the emergency stop, the largest one. It works on every page, also while a filter is
/// typed.
pub(super) const STOP_KEY: KeyCode = KeyCode::Char(' ');
/// Longest filter.
const FILTER_MAX: usize = 32;

/// Returns true if `key` requests the emergency stop.
pub(super) fn is_stop(key: &KeyEvent) -> bool {
    key.kind == KeyEventKind::Press && key.code == STOP_KEY
}

fn is_of_curves(code: KeyCode) -> bool {
    matches!(code, KeyCode::Left | KeyCode::Right | KeyCode::Char('c' | 'C' | '+' | '-' | 'l'))
}

/// A page of the monitor.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Page {
    /// Joints, with buses and latencies in short.
    #[default]
    Joints,
    /// Every counter of the buses.
    Buses,
    /// Percentiles of all latencies.
    Latencies,
    /// The keys, and the meaning of the columns.
    Help,
}

/// The order of the joints.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum SortOrder {
    /// Faulty and offline motors first, then the order of the configuration.
    #[default]
    Trouble,
    /// The order of the configuration.
    Configuration,
    /// By name.
    Name,
    /// The nearest to a limit of its position first.
    Position,
    /// The fastest first.
    Velocity,
    /// The largest part of its torque limit first.
    Torque,
    /// The hottest first.
    Temperature,
    /// The longest without a reply first.
    Age,
}

impl SortOrder {
    const ALL: [Self; 8] = [
        Self::Trouble,
        Self::Configuration,
        Self::Name,
        Self::Position,
        Self::Velocity,
        Self::Torque,
        Self::Temperature,
        Self::Age,
    ];

    /// Its name on the screen.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Trouble => "trouble",
            Self::Configuration => "configuration",
            Self::Name => "name",
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Torque => "torque",
            Self::Temperature => "temperature",
            Self::Age => "age",
        }
    }

    fn next(self, steps: usize) -> Self {
        Self::ALL[(self as usize + steps) % Self::ALL.len()]
    }
}

/// A request to the daemon, or to leave the monitor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Action {
    /// Damp and stop the motors of the chosen groups.
    Disable,
    /// Clear the latched cause of the chosen groups.
    Reset,
    /// Leave the monitor.
    Quit,
}

/// The choices.
#[derive(Debug, Clone, Default)]
pub(super) struct View {
    /// The page that is shown.
    pub(super) page: Page,
    /// The order of the joints.
    pub(super) order: SortOrder,
    /// A part of the names of joints, buses or modes that are shown.
    pub(super) filter: String,
    /// True while the filter is typed.
    pub(super) is_filtering: bool,
    /// First row of the page that is shown.
    pub(super) scroll: usize,
    /// Rows of the page beyond those that fit, in the last picture.
    pub(super) scroll_max: usize,
    /// Rows that fit, in the last picture.
    pub(super) rows: usize,
    /// The group that keys act on, by its index; `None` for all.
    pub(super) group: Option<usize>,
    /// Number of groups.
    pub(super) groups: usize,
    /// The terminal shows no colours.
    pub(super) is_colourless: bool,
    /// The joints whose curves are shown.
    pub(super) selection: Selection,
}

impl View {
    /// Creates the choices at the start, for the terminal of the standard output.
    pub(super) fn of_stdout() -> Self {
        Self { is_colourless: !Palette::of_stdout().is_coloured(), ..Self::default() }
    }

    /// Handles a key. Returns the requested action.
    pub(super) fn press(&mut self, key: &KeyEvent) -> Option<Action> {
        if key.kind == KeyEventKind::Release {
            return None;
        }
        if key.modifiers.contains(KeyModifiers::CONTROL) {
            return (key.code == KeyCode::Char('c')).then_some(Action::Quit);
        }
        if self.is_filtering {
            self.write_filter(key.code);
            return None;
        }
        match key.code {
            KeyCode::Char('q') => return Some(Action::Quit),
            KeyCode::Char('d') => return Some(Action::Disable),
            KeyCode::Char('r') => return Some(Action::Reset),
            code => self.choose(code),
        }
        None
    }

    fn choose(&mut self, code: KeyCode) {
        match code {
            KeyCode::Char('?' | 'h') => {
                self.show(if self.page == Page::Help { Page::Joints } else { Page::Help });
            }
            KeyCode::Char('1') => self.show(Page::Joints),
            KeyCode::Char('2') => self.show(Page::Buses),
            KeyCode::Char('3') => self.show(Page::Latencies),
            KeyCode::Tab => self.show(match self.page {
                Page::Joints => Page::Buses,
                Page::Buses => Page::Latencies,
                Page::Latencies | Page::Help => Page::Joints,
            }),
            KeyCode::Char('s') => self.order = self.order.next(1),
            KeyCode::Char('S') => self.order = self.order.next(SortOrder::ALL.len() - 1),
            KeyCode::Char('g') => self.group = self.next_group(),
            KeyCode::Char('/') => {
                self.show(Page::Joints);
                self.is_filtering = true;
            }
            KeyCode::Esc if self.page == Page::Help => self.show(Page::Joints),
            KeyCode::Esc => self.filter.clear(),
            code if self.page == Page::Joints && is_of_curves(code) => self.selection.press(code),
            code => self.move_by(code),
        }
    }

    fn show(&mut self, page: Page) {
        self.page = page;
        self.scroll = 0;
    }

    fn next_group(&self) -> Option<usize> {
        let next = self.group.map_or(0, |group| group + 1);
        // With one group there is no choice.
        (self.groups > 1 && next < self.groups).then_some(next)
    }

    fn move_by(&mut self, code: KeyCode) {
        let page = self.rows.max(1);
        let row = match code {
            KeyCode::Up | KeyCode::Char('k') => self.scroll.saturating_sub(1),
            KeyCode::Down | KeyCode::Char('j') => self.scroll + 1,
            KeyCode::PageUp => self.scroll.saturating_sub(page),
            KeyCode::PageDown => self.scroll + page,
            KeyCode::Home => 0,
            KeyCode::End => usize::MAX,
            _ => return,
        };
        self.scroll = row.min(self.scroll_max);
    }

    fn write_filter(&mut self, code: KeyCode) {
        match code {
            KeyCode::Enter => self.is_filtering = false,
            KeyCode::Esc => {
                self.filter.clear();
                self.is_filtering = false;
            }
            KeyCode::Backspace => {
                self.filter.pop();
            }
            // A space is the emergency stop in a filter also.
            KeyCode::Char(letter) if KeyCode::Char(letter) != STOP_KEY && self.filter.len() < FILTER_MAX => {
                self.filter.push(letter);
            }
            _ => {}
        }
    }

    /// Records that `rows` of `all` rows fit.
    pub(super) fn fit(&mut self, all: usize, rows: usize) {
        self.rows = rows;
        self.scroll_max = all.saturating_sub(rows);
        self.scroll = self.scroll.min(self.scroll_max);
    }

    /// Sets the number of groups: another daemon may have fewer.
    pub(super) fn know_groups(&mut self, groups: usize) {
        self.groups = groups;
        self.group = self.group.filter(|group| *group < groups);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(code: KeyCode) -> KeyEvent {
        KeyEvent::new(code, KeyModifiers::NONE)
    }

    fn typed(view: &mut View, text: &str) {
        for letter in text.chars() {
            assert_eq!(view.press(&key(KeyCode::Char(letter))), None, "{letter}");
        }
    }

    #[test]
    fn filter_letters_do_nothing_and_space_stops() {
        let mut view = View::default();
        typed(&mut view, "/drq knee");
        assert!(is_stop(&key(STOP_KEY)));
        assert_eq!(view.filter, "drqknee");
        view.press(&key(KeyCode::Enter));
        assert_eq!(view.press(&key(KeyCode::Char('d'))), Some(Action::Disable));
        view.press(&key(KeyCode::Esc));
        assert_eq!(view.filter, "");
    }

    #[test]
    fn control_and_release_keys_request_nothing() {
        let mut view = View::default();
        let control = |letter| KeyEvent::new(KeyCode::Char(letter), KeyModifiers::CONTROL);
        assert_eq!(view.press(&control('d')), None);
        assert_eq!(view.press(&control('c')), Some(Action::Quit));
        let release = KeyEvent { kind: KeyEventKind::Release, ..key(STOP_KEY) };
        assert!(!is_stop(&release));
        assert_eq!(view.press(&KeyEvent { code: KeyCode::Char('d'), ..release }), None);
    }

    #[test]
    fn scrolling_ends_with_rows_and_restarts_per_page() {
        let mut view = View::default();
        view.fit(12, 5);
        view.press(&key(KeyCode::End));
        assert_eq!(view.scroll, 7);
        view.press(&key(KeyCode::PageUp));
        assert_eq!(view.scroll, 2);
        view.fit(3, 5);
        assert_eq!(view.scroll, 0);
        view.fit(12, 5);
        view.press(&key(KeyCode::PageDown));
        view.press(&key(KeyCode::Tab));
        assert_eq!((view.page, view.scroll), (Page::Buses, 0));
    }

    #[test]
    fn removed_group_is_no_longer_selected() {
        let mut view = View::default();
        view.know_groups(2);
        typed(&mut view, "gg");
        assert_eq!(view.group, Some(1));
        view.know_groups(1);
        assert_eq!(view.group, None);
        typed(&mut view, "g");
        assert_eq!(view.group, None, "with one group all is that one");
    }
}
