//! The limit on connections. One that has not sent its request yet makes room for a newer one, so
//! that silent connections do not prevent a stop.

use std::cell::Cell;
use std::collections::VecDeque;
use std::rc::Rc;

/// How far a connection is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stage {
    /// Its request is not complete.
    Reading,
    Answering,
    /// It receives events until it ends.
    Streaming,
    Ended,
}

/// The stage of a connection, which ends with its last owner.
#[derive(Debug)]
pub(crate) struct Progress(Rc<Cell<Stage>>);

impl Progress {
    pub(crate) fn stage(&self) -> Stage {
        self.0.get()
    }

    pub(crate) fn set(&self, stage: Stage) {
        self.0.set(stage);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.0.set(Stage::Ended);
    }
}

/// The open connections, oldest first, each with what ends it.
#[derive(Debug)]
pub(crate) struct Connections<E> {
    open: VecDeque<(Rc<Cell<Stage>>, E)>,
    most: usize,
}

impl<E> Connections<E> {
    pub(crate) fn new(most: usize) -> Self {
        Self { open: VecDeque::with_capacity(most), most }
    }

    /// Makes room for a connection, with `end` for the oldest one without a request. Returns
    /// `false` if there is none.
    pub(crate) fn make_space(&mut self, end: impl FnOnce(E)) -> bool {
        self.open.retain(|(stage, _)| stage.get() != Stage::Ended);
        if self.open.len() < self.most {
            return true;
        }
        let oldest = self.open.iter().position(|(stage, _)| stage.get() == Stage::Reading);
        let oldest = oldest.and_then(|index| self.open.remove(index));
        oldest.map(|(_, connection)| end(connection)).is_some()
    }

    /// Adds a connection, which `start` starts.
    pub(crate) fn add(&mut self, start: impl FnOnce(Progress) -> E) {
        let stage = Rc::new(Cell::new(Stage::Reading));
        let connection = start(Progress(Rc::clone(&stage)));
        self.open.push_back((stage, connection));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silent_connection_is_replaced_and_busy_one_stays() {
        let mut connections = Connections::new(3);
        let mut all = Vec::new();
        for number in 0..3 {
            assert!(connections.make_space(|_| unreachable!()));
            connections.add(|progress| {
                all.push(progress);
                number
            });
        }
        all[0].set(Stage::Streaming);
        let mut ended = None;
        assert!(connections.make_space(|number| ended = Some(number)));
        assert_eq!(ended, Some(1), "the oldest that is silent");
        connections.add(|progress| {
            all.push(progress);
            3
        });
        all[2].set(Stage::Answering);
        all[3].set(Stage::Answering);
        assert!(!connections.make_space(|_| unreachable!()));
        assert_eq!(all[2].stage(), Stage::Answering);
        drop(all.pop());
        assert!(connections.make_space(|_| unreachable!()), "an ended one leaves its room");
    }
}
