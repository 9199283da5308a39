//! Which motor a frame is from.

use motord_bus::{FrameId, IdFilter, IdSet};

/// The motors of a bus, in the order of the configuration, with the ids of their frames.
pub(super) struct Routes {
    motors: Vec<usize>,
    /// The first filter of each motor, then the others.
    routes: Vec<(IdFilter, usize)>,
    /// The route after the one that was found last: most motors reply in the order of their
    /// commands.
    next: usize,
}

impl Routes {
    /// Allocates; nothing after it does.
    pub(super) fn new(motors: impl Iterator<Item = (IdSet, usize)>) -> Self {
        let sets: Vec<_> = motors.collect();
        let of = |from: usize, count: usize| {
            let filters = move |set: &IdSet| set.filters().skip(from).take(count);
            sets.iter().flat_map(move |(set, motor)| filters(set).map(move |ids| (ids, *motor)))
        };
        let routes = of(0, 1).chain(of(1, usize::MAX)).collect();
        Self { motors: sets.iter().map(|(_, motor)| *motor).collect(), routes, next: 0 }
    }

    pub(super) const fn len(&self) -> usize {
        self.motors.len()
    }

    /// Returns the motors.
    #[inline]
    pub(super) fn motors(&self) -> impl Iterator<Item = usize> {
        self.motors.iter().copied()
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
        let set = |raw| IdSet::from(IdFilter::exact(id(raw)));
        let mut routes = Routes::new([0x101, 0x102, 0x103].map(set).into_iter().zip(4..));
        let order = [0x101, 0x102, 0x103, 0x101, 0x103, 0x102, 0x102, 0x103, 0x103];
        let found = order.map(|raw| routes.motor(id(raw)));
        assert_eq!(found, [4, 5, 6, 4, 6, 5, 5, 6, 6].map(Some));
        assert_eq!(routes.motor(id(0x104)), None);
        assert_eq!(routes.motor(id(0x101)), Some(4));
    }

    #[test]
    fn motor_with_two_reply_ids_is_one_motor() {
        let exact = |raw| IdFilter::exact(FrameId::new(raw).unwrap());
        let sets = [(0x501, 0x241), (0x502, 0x242)].map(|(one, two)| IdSet::of_two(exact(one), exact(two)));
        let mut routes = Routes::new(sets.into_iter().zip(4..));
        assert_eq!((routes.len(), routes.motors().collect::<Vec<_>>()), (2, vec![4, 5]));
        let found = [0x501, 0x502, 0x242, 0x241, 0x502].map(|raw| routes.motor(FrameId::new(raw).unwrap()));
        assert_eq!(found, [4, 5, 5, 4, 5].map(Some));
    }
}
