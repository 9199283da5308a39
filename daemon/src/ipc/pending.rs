//! Requests whose answers come from another thread.

/// Requests under their tickets, until their answers come.
///
/// A request that was dropped is still in the queue of the other thread, so its ticket counts until
/// it is answered. A client that sends requests and gives up cannot fill that queue.
pub(super) struct Pending<R> {
    /// `None` where no client waits for the answer.
    requests: Vec<(u32, Option<R>)>,
    most: usize,
    next_ticket: u32,
}

impl<R> Pending<R> {
    /// Keeps at most `most` requests.
    pub(super) fn new(most: usize) -> Self {
        Self { requests: Vec::with_capacity(most), most, next_ticket: 0 }
    }

    /// Keeps `request`, and returns its ticket.
    ///
    /// # Errors
    /// The request, when it would leave fewer than `spare` places.
    pub(super) fn keep(&mut self, request: R, spare: usize) -> Result<u32, R> {
        if self.requests.len() + spare >= self.most {
            return Err(request);
        }
        self.next_ticket = self.next_ticket.wrapping_add(1);
        self.requests.push((self.next_ticket, Some(request)));
        Ok(self.next_ticket)
    }

    /// Removes and returns the request with this ticket; `None` when no client waits for the
    /// answer.
    pub(super) fn take(&mut self, ticket: u32) -> Option<R> {
        let index = self.requests.iter().position(|(pending, _)| *pending == ticket)?;
        self.requests.swap_remove(index).1
    }

    /// Drops the requests whose answers no client waits for. Their tickets stay.
    pub(super) fn drop_unless(&mut self, is_awaited: impl Fn(&R) -> bool) {
        for (_, request) in &mut self.requests {
            drop(request.take_if(|request| !is_awaited(request)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dropped_request_counts_until_it_is_answered() {
        let mut pending = Pending::new(3);
        let first = pending.keep('a', 1).unwrap();
        pending.keep('b', 1).unwrap();
        pending.drop_unless(|request| *request == 'b');
        assert_eq!(pending.keep('c', 1), Err('c'));
        pending.keep('d', 0).unwrap();
        assert_eq!(pending.take(first), None);
        pending.keep('e', 0).unwrap();
        assert_eq!(pending.keep('f', 0), Err('f'));
    }
}
