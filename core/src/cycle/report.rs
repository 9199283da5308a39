//! Writes the state after a cycle into the message for clients. No other code writes a
//! [`StateMessage`].

use super::Cycle;
use crate::control::Wake;
use core::sync::atomic::Ordering;
use motord_bus::Instant;
use motord_bus::time::nanos;
use motord_shared::{BusState, Rejection, StateMessage, message};

impl Cycle {
    /// Writes the state of the cycle that began with `wake` and ended at `now`. Does not allocate
    /// or block; bounded by joints, groups, buses and IMUs.
    pub(super) fn report(&mut self, wake: &Wake, now: Instant) {
        let flags = self.flags(wake);
        let Self { link, control, channels, .. } = self;
        let (state, counters) = link.state();
        let StateMessage { joints, groups, buses, indicators, imus, .. } = state;
        state.joint_count = control.report_joints(joints) as u32;
        state.group_count = fill(groups, control.group_states());
        state.indicator_count = fill(indicators, control.joint_indicators());
        state.imu_count = fill(imus, control.imu_states());
        let reports = channels.iter().enumerate().map(|(bus, channel)| BusState {
            condition: control.bus_condition(bus).code(),
            ..channel.base().report()
        });
        state.bus_count = fill(buses, reports);
        for (group, wrong_lease) in used(groups, state.group_count).zip(&counters.wrong_lease) {
            let counter = &mut group.rejected[Rejection::WrongLease.code() as usize];
            *counter = counter.wrapping_add(wrong_lease.load(Ordering::Relaxed));
        }
        for (bus, filtered) in used(buses, state.bus_count).zip(&counters.unexpected_ids) {
            bus.unexpected_id = bus.unexpected_id.wrapping_add(filtered.load(Ordering::Relaxed));
        }
        let config_changed = counters.config_changed.load(Ordering::Relaxed);
        state.flags = flags | if config_changed { message::FLAG_CONFIG_CHANGED } else { 0 };
        state.boot_id = self.boot_id;
        state.cycle = wake.cycle;
        // The tick with the cycle's number: the missed ones were before it.
        let missed = u32::try_from(wake.missed_ticks).unwrap_or(u32::MAX);
        let tick = wake.scheduled + missed * self.timing.period;
        state.tick_ns = tick.as_nanos();
        state.wake_latency_ns = nanos(wake.begun.since(tick));
        state.publish_ns = now.as_nanos();
        state.overruns = self.missed_ticks;
    }

    fn flags(&self, wake: &Wake) -> u32 {
        let flags = [
            (self.control.is_emergency_stopped(), message::FLAG_EMERGENCY_STOP),
            (self.control.is_shutting_down(), message::FLAG_SHUTDOWN),
            (self.realtime, message::FLAG_REALTIME),
            (wake.missed_ticks > 0, message::FLAG_OVERRUN),
        ];
        flags.iter().filter(|(is_set, _)| *is_set).fold(0, |flags, (_, flag)| flags | flag)
    }
}

/// Writes `states` into the first entries, and returns their number.
fn fill<T>(entries: &mut [T], states: impl Iterator<Item = T>) -> u32 {
    entries.iter_mut().zip(states).map(|(entry, state)| *entry = state).count() as u32
}

/// The first `count` entries.
fn used<T>(entries: &mut [T], count: u32) -> impl Iterator<Item = &mut T> {
    entries.iter_mut().take(count as usize)
}
