//! When the dead man's switch acts: decisions on given times.

use super::*;

const PATIENCE: Duration = Duration::from_millis(5);

/// A switch and its world.
struct Story {
    switch: Switch,
    now: Instant,
    connected: bool,
    /// Moves by itself every millisecond while this is set.
    beats: bool,
    heartbeat: u64,
}

impl Story {
    /// A daemon that has lived for a while.
    fn begin() -> Self {
        let now = Instant::from_nanos(1_000_000_000);
        let mut story =
            Self { switch: Switch::new(PATIENCE, 1, now), now, connected: true, beats: true, heartbeat: 1 };
        assert_eq!(story.pass(1000), None, "a living daemon is left alone");
        story
    }

    /// After how many ms the switch began to act, and why.
    fn pass(&mut self, millis: u64) -> Option<(u64, Cause)> {
        let mut began = None;
        for at in 0..millis {
            self.heartbeat += u64::from(self.beats);
            let acted = self.switch.acts();
            self.switch.step(self.now, self.connected, self.heartbeat);
            if acted.is_none() {
                began = began.or(self.switch.acts().map(|cause| (at, cause)));
            }
            self.now = self.now + Duration::from_millis(1);
        }
        began
    }

    fn dies(&mut self) {
        (self.connected, self.beats) = (false, false);
    }
}

#[test]
fn dead_daemon_is_acted_on_until_buses_served() {
    let mut story = Story::begin();
    story.dies();
    assert_eq!(story.pass(1000), Some((0, Cause::Died)));
    assert_eq!(story.switch.acts(), Some(Cause::Died), "however long that takes");
    story.switch.served();
    assert_eq!(story.pass(1000), None, "motors are stopped once");
}

#[test]
fn stalled_heartbeat_is_noticed_within_fifth_of_patience() {
    let mut story = Story::begin();
    story.beats = false;
    // The last beat was a millisecond before.
    assert_eq!(story.pass(1000), Some((4, Cause::StoodStill)));
    story.switch.served();
    story.dies();
    assert_eq!(story.pass(1000), None, "motors are stopped once");
}

#[test]
fn heartbeat_is_checked_five_times_per_patience() {
    let mut story = Story::begin();
    let first = story.switch.due();
    story.pass(1);
    assert_eq!(story.switch.due().since(first), PATIENCE / 5);
}

#[test]
fn resumed_daemon_gets_its_motors_back() {
    let mut story = Story::begin();
    story.beats = false;
    assert!(story.pass(30).is_some());
    story.beats = true;
    story.pass(1);
    assert_eq!(story.switch.acts(), None);
    story.beats = false;
    assert_eq!(story.pass(1000), Some((4, Cause::StoodStill)), "and is watched as before");
}

#[test]
fn daemon_that_left_stopped_robot_is_ignored() {
    for millis_until_it_closes in [0, 500] {
        let mut story = Story::begin();
        (story.beats, story.heartbeat) = (false, AT_REST);
        assert_eq!(story.pass(millis_until_it_closes), None);
        story.dies();
        assert_eq!(story.pass(1000), None);
    }
}

#[test]
fn daemon_that_beats_once_and_dies_is_handled() {
    let mut story = Story::begin();
    story.beats = false;
    story.pass(1000);
    story.switch.served();
    story.heartbeat += 1;
    story.dies();
    assert_eq!(story.pass(1000), Some((0, Cause::Died)), "even after its motors were stopped");
    let mut story = Story::begin();
    story.heartbeat += 1;
    story.dies();
    assert_eq!(story.pass(1000), Some((0, Cause::Died)));
}
