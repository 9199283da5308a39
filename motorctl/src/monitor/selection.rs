//! The joint whose details are shown, the joints of the curves, and the time and the scale of the
//! curves.

use crossterm::event::KeyCode;

/// Times that the curves can show, s.
const TIMES: [f64; 4] = [5.0, 15.0, 30.0, 60.0];

/// The choice. Names, not rows: a fault changes the order of the rows.
#[derive(Debug, Clone)]
pub(super) struct Selection {
    /// The joints of the table, in its order.
    rows: Vec<String>,
    /// The joint that the next key chooses.
    cursor: Option<String>,
    chosen: Vec<String>,
    time: usize,
    /// True if the scale always includes the limits; otherwise only where the values come near
    /// them.
    pub(super) has_limits: bool,
}

impl Default for Selection {
    fn default() -> Self {
        Self { rows: Vec::new(), cursor: None, chosen: Vec::new(), time: 1, has_limits: false }
    }
}

impl Selection {
    /// Sets the joints of the table, in its order.
    pub(super) fn know_rows(&mut self, rows: Vec<String>) {
        self.rows = rows;
    }

    /// Returns the joint that the keys act on.
    pub(super) fn cursor(&self) -> Option<&str> {
        self.cursor.as_deref().filter(|cursor| self.rows.iter().any(|row| row == cursor))
    }

    /// Returns the time that the curves show, s.
    pub(super) fn seconds(&self) -> f64 {
        TIMES[self.time]
    }

    /// Returns at most `most` joints: the chosen ones, the last of them if there are more;
    /// otherwise the rows from the cursor on.
    pub(super) fn shown(&self, most: usize) -> Vec<&str> {
        let is_row = |name: &&String| self.rows.contains(*name);
        let chosen: Vec<&str> = self.chosen.iter().filter(is_row).map(String::as_str).collect();
        if !chosen.is_empty() {
            return chosen[chosen.len().saturating_sub(most)..].to_vec();
        }
        let first = self.row().unwrap_or(0).min(self.rows.len().saturating_sub(most));
        self.rows.iter().skip(first).take(most).map(String::as_str).collect()
    }

    fn row(&self) -> Option<usize> {
        self.rows.iter().position(|row| Some(row) == self.cursor.as_ref())
    }

    /// Handles a key. Does nothing without a row.
    pub(super) fn press(&mut self, code: KeyCode) {
        let Some(last) = self.rows.len().checked_sub(1) else { return };
        match code {
            KeyCode::Left => self.move_to(self.row().map_or(last, |row| row.checked_sub(1).unwrap_or(last))),
            KeyCode::Right => self.move_to(self.row().map_or(0, |row| if row < last { row + 1 } else { 0 })),
            KeyCode::Char('c') => self.choose(),
            KeyCode::Char('C') => (self.chosen.clear(), self.cursor = None).0,
            KeyCode::Char('+') => self.time = self.time.saturating_sub(1),
            KeyCode::Char('-') => self.time = (self.time + 1).min(TIMES.len() - 1),
            KeyCode::Char('l') => self.has_limits = !self.has_limits,
            _ => {}
        }
    }

    fn move_to(&mut self, row: usize) {
        self.cursor = self.rows.get(row).cloned();
    }

    /// Chooses the joint at the cursor, or removes it from the choice.
    fn choose(&mut self) {
        let Some(name) = self.rows.get(self.row().unwrap_or(0)).cloned() else { return };
        match self.chosen.iter().position(|chosen| *chosen == name) {
            Some(index) => drop(self.chosen.remove(index)),
            None => self.chosen.push(name.clone()),
        }
        self.cursor = Some(name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn selection() -> Selection {
        let mut selection = Selection::default();
        selection.know_rows(["hip", "thigh", "knee", "toe"].map(str::to_owned).to_vec());
        selection
    }

    #[test]
    fn curves_follow_cursor_until_joints_are_chosen() {
        let mut selection = selection();
        assert_eq!(selection.shown(2), ["hip", "thigh"]);
        selection.press(KeyCode::Right);
        selection.press(KeyCode::Right);
        assert_eq!((selection.cursor(), selection.shown(2)), (Some("thigh"), vec!["thigh", "knee"]));
        selection.press(KeyCode::Left);
        selection.press(KeyCode::Left);
        assert_eq!(selection.shown(2), ["knee", "toe"], "the picture stays full");
        selection.press(KeyCode::Char('c'));
        selection.press(KeyCode::Right);
        selection.press(KeyCode::Char('c'));
        selection.press(KeyCode::Right);
        assert_eq!(selection.shown(2), ["toe", "hip"]);
        assert_eq!(selection.shown(1), ["hip"], "the one chosen last");
        selection.press(KeyCode::Left);
        selection.press(KeyCode::Char('c'));
        assert_eq!(selection.shown(2), ["toe"]);
        selection.press(KeyCode::Char('C'));
        assert_eq!(selection.shown(2), ["hip", "thigh"]);
    }

    #[test]
    fn a_fault_that_reorders_rows_moves_no_choice() {
        let mut selection = selection();
        selection.press(KeyCode::Right);
        selection.press(KeyCode::Char('c'));
        selection.know_rows(["knee", "hip", "thigh", "toe"].map(str::to_owned).to_vec());
        assert_eq!((selection.cursor(), selection.shown(3)), (Some("hip"), vec!["hip"]));
        selection.know_rows(vec!["knee".to_owned()]);
        assert_eq!((selection.cursor(), selection.shown(3)), (None, vec!["knee"]), "a filter hides it");
    }

    #[test]
    fn keys_do_nothing_where_no_curves_fit() {
        let mut selection = Selection::default();
        for code in
            [KeyCode::Left, KeyCode::Right, KeyCode::Char('c'), KeyCode::Char('l'), KeyCode::Char('-')]
        {
            selection.press(code);
        }
        assert!(!selection.has_limits && selection.seconds() == 15.0);
        assert_eq!(selection.shown(3), [""; 0]);
    }
}
