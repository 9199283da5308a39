"""Signals that arrive while compiled modules are imported."""

import signal
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def deferred() -> Generator[None, None, None]:
    """Delays signals with a handler in Python, such as Ctrl-C, to the end of the block.

    Compiled modules replace the exception of such a handler by their own, such as ImportError, or lose it. The signals stay
    pending for this thread; one that another thread receives is handled inside the block. Threads that the block starts
    receive none of these signals.
    """
    handled = [number for number in signal.valid_signals() if callable(signal.getsignal(number))]
    before = signal.pthread_sigmask(signal.SIG_BLOCK, handled)
    try:
        yield
    finally:
        # Calls the handlers of pending signals.
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
