//! Emergency stops on their way past every queue.

use super::*;

#[test]
fn a_request_is_taken_once_and_done_when_its_cycle_is_over() {
    let stops = Arc::new(EmergencyStops::default());
    let mut asked = AskedStops::new(Arc::clone(&stops));
    assert_eq!(asked.take(), None);
    let request = stops.ask(7);
    assert_eq!((asked.take(), asked.take()), (Some(7), None));
    assert!(!stops.is_done(request), "its cycle is not over");
    asked.confirm();
    assert!(stops.is_done(request));
    let again = stops.ask(7);
    assert!(!stops.is_done(again) && asked.take() == Some(7));
}

#[test]
fn the_number_of_a_request_is_never_that_of_none() {
    let stops = EmergencyStops { asked: AtomicU64::new(u64::MAX), done: AtomicU64::new(0) };
    assert!(!stops.is_done(stops.ask(0)));
}
