"""Limits on calls of a library that may not return."""

from __future__ import annotations

import os
import time
import weakref
from _thread import get_ident, start_new_thread
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from threading import Event
from typing import Any, TypeVar

CANCEL_S = 2.0
"""Longest time that a cancelled call takes to end."""

WATCH_S = 0.25
"""Time between two checks of a watchdog."""

T = TypeVar("T")


class Unfinished(Exception):
    """A call has not returned in time."""


@dataclass
class _Job:
    function: Callable[[], Any]
    value: Any = None
    error: BaseException | None = None
    ended: Event = field(default_factory=Event)

    def run(self) -> None:
        try:
            self.value = self.function()
        except BaseException as error:
            self.error = error
        self.ended.set()


_Jobs = SimpleQueue[_Job | None]


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
        job = _Job(function)
        try:
            self._jobs.put(job)
            if not job.ended.wait(seconds):
                raise Unfinished
        except BaseException:
            cancel()
            self._process = 0
            self._jobs.put(None)
            # A thread that returns to the interpreter while that ends would abort the process.
            job.ended.wait(CANCEL_S)
            raise
        if job.error is not None:
            raise job.error
        result: T = job.value
        return result

    def _start(self) -> None:
        # A forked process has no thread, and a call may keep the previous one for ever.
        self._jobs = SimpleQueue()
        weakref.finalize(self, self._jobs.put, None)
        start_new_thread(_work, (self._jobs,))
        self._process = os.getpid()


def _work(jobs: _Jobs) -> None:
    while (job := jobs.get()) is not None:
        job.run()
        # Without this, the thread would keep the last job, and its policy.
        del job


@dataclass(eq=False)
class _Run:
    """A call in the thread of its caller."""

    clock: int
    """The clock of this thread."""
    end_s: float
    cancel: Callable[[], None]
    is_cancelled: bool = False

    def check(self) -> None:
        if time.clock_gettime(self.clock) >= self.end_s:
            self.is_cancelled = True
            self.cancel()


class Watchdog:
    """Calls functions in the thread of the caller, with its priority and processors, and cancels those that compute for too long.

    Its thread checks every WATCH_S, so that a call wakes no other thread. The limit is processor time of the caller's thread: a
    machine that stops for a while ends no call.
    """

    def __init__(self) -> None:
        self._start()

    def call(self, function: Callable[[], T], seconds: float, cancel: Callable[[], None]) -> T:
        """Returns the result of a function, or raises its exception. Unfinished if the function raises because it is cancelled.

        It is cancelled after `seconds` of processor time, or up to WATCH_S later. Ctrl-C waits for its end.
        """
        if self._process != os.getpid():
            self._start()
        run = _Run(time.pthread_getcpuclockid(get_ident()), time.thread_time() + seconds, cancel)
        try:
            self._runs.add(run)
            return function()
        except Exception:
            if run.is_cancelled:
                raise Unfinished from None
            raise
        finally:
            self._runs.discard(run)

    def _start(self) -> None:
        # A forked process has no thread, and no other runs.
        self._runs: set[_Run] = set()
        ended: SimpleQueue[None] = SimpleQueue()
        weakref.finalize(self, ended.put, None)
        start_new_thread(_watch, (self._runs, ended))
        self._process = os.getpid()


def _watch(runs: set[_Run], ended: SimpleQueue[None]) -> None:
    while True:
        with suppress(Empty):
            ended.get(timeout=WATCH_S)
            return
        _check(runs)


def _check(runs: set[_Run]) -> None:
    for run in tuple(runs):
        run.check()
