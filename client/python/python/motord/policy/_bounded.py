"""Calls of a library that may not return."""

from __future__ import annotations

import os
import weakref
from _thread import start_new_thread
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

CANCEL_S = 2.0
"""Longest time that a cancelled call takes to end."""

T = TypeVar("T")

_Outcomes = SimpleQueue[tuple[Any, BaseException | None]]
_Jobs = SimpleQueue[tuple[Callable[[], Any], _Outcomes] | None]


class Unfinished(Exception):
    """A call has not returned in time."""


class Bounded:
    """Calls functions in a thread, so that a time limit and Ctrl-C end the wait of the caller.

    The thread sleeps between the calls. `threading` does not count it: it never keeps another one from the interpreter.
    """

    def __init__(self) -> None:
        self._process = 0
        self._jobs: _Jobs = SimpleQueue()

    def call(self, function: Callable[[], T], seconds: float, cancel: Callable[[], None] = lambda: None) -> T:
        """Returns the result of a function, or raises its exception. Unfinished after this time.

        A function that has not ended is cancelled, and left to its thread when it does not end within CANCEL_S.
        """
        if self._process != os.getpid():
            self._start()
        outcomes: _Outcomes = SimpleQueue()
        try:
            self._jobs.put((function, outcomes))
            value, error = outcomes.get(timeout=seconds)
        except BaseException as error:
            cancel()
            self._process = 0
            self._jobs.put(None)
            # A thread that returns to the interpreter while that ends would abort the process.
            with suppress(Empty):
                outcomes.get(timeout=CANCEL_S)
            if isinstance(error, Empty):
                raise Unfinished from None
            raise
        if error is not None:
            raise error
        result: T = value
        return result

    def _start(self) -> None:
        # A forked process has no thread, and a call may keep the previous one for ever.
        self._jobs = SimpleQueue()
        weakref.finalize(self, self._jobs.put, None)
        start_new_thread(_work, (self._jobs,))
        self._process = os.getpid()


def _work(jobs: _Jobs) -> None:
    while (job := jobs.get()) is not None:
        function, outcomes = job
        try:
            outcomes.put((function(), None))
        except BaseException as error:
            outcomes.put((None, error))
        # Without this, the thread would keep the last job, and its policy.
        del job, function, outcomes
