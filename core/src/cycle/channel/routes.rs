//! Which motor a frame is from.

use motord_bus::{FrameId, IdFilter};

/// The motors of a bus, in the order of the configuration, with the ids of their frames.
pub(super) struct Routes {
    routes: Vec<(IdFilter, usize)>,
    /// The route after the one that was found last: most motors reply in the order of their
    /// commands.
    next: usize,
}

impl Routes {
    /// Allocates; nothing after it does.
    pub(super) fn new(routes: impl Iterator<Item = (IdFilter, usize)>) -> Self {
        Self { routes: routes.collect(), next: 0 }
    }

    pub(super) const fn len(&self) -> usize {
        self.routes.len()
    }

    /// Returns the motors.
    #[inline]
    pub(super) fn motors(&self) -> impl Iterator<Item = usize> {
        self.routes.iter().map(|(_, motor)| *motor)
    }

    /// Returns the motor that sends frames with this id. Bounded by the motors of the bus.
    #[inline(always)]
    pub(super) fn motor(&mut self, id: FrameId) -> Option<usize> {
        match self.routes.get(self.next) {
            Some((filter, motor)) if filter.matches(id) => {
                self.next += 1;
                Some(*motor)
            }
            _ => self.search(id),
        }
    }

    fn search(&mut self, id: FrameId) -> Option<usize> {
        let found = self.routes.iter().position(|(filter, _)| filter.matches(id))?;
        self.next = found + 1;
        Some(self.routes[found].1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replies_in_any_order_find_their_motors() {
        let id = |raw| FrameId::new(raw).unwrap();
        let mut routes =
            Routes::new([0x101, 0x102, 0x103].map(|raw| IdFilter::exact(id(raw))).into_iter().zip(4..));
        let order = [0x101, 0x102, 0x103, 0x101, 0x103, 0x102, 0x102, 0x103, 0x103];
        let found = order.map(|raw| routes.motor(id(raw)));
        assert_eq!(found, [4, 5, 6, 4, 6, 5, 5, 6, 6].map(Some));
        assert_eq!(routes.motor(id(0x104)), None);
        assert_eq!(routes.motor(id(0x101)), Some(4));
    }
}
