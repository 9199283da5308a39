"""Exceptions of signal handlers and of the caller's code while an argument is read: none is lost."""

import random
import signal
import subprocess
import sys
import time
from collections import UserDict
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from conftest import interruptible

import motord
from motord._motord import Motion

NAMES = [f"joint-{at}" for at in range(12)]
LIMITS = [(name, (-3.0, 3.0), 25.0) for name in NAMES]
SIGNALS = 3000
HANDLED_S = 20.0


class Interrupt(BaseException):
    """The exception of a handler."""


def raises(*_: object) -> Any:
    raise Interrupt


def of(base: type, **members: Any) -> Any:
    return type("Raises", (base,), members)


def move(pose: Any) -> None:
    Motion(LIMITS, [0.0] * 12, pose, 1.0)


@pytest.fixture
def unraisable(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Exceptions that were printed and ignored."""
    found: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", found.append)
    return found


@pytest.mark.parametrize(
    "made",
    [
        lambda: of(object, keys=property(raises))(),
        lambda: of(object, __float__=raises)(),
        lambda: of(object, __len__=raises)(),
        lambda: of(object, __len__=lambda _: 12, __iter__=raises)(),
        lambda: of(object, __len__=lambda _: 12, __iter__=lambda _: iter([of(object, __float__=raises)()]))(),
        lambda: of(UserDict, keys=raises)(),
        lambda: of(UserDict, __getitem__=raises)({name: 0.0 for name in NAMES}),
        lambda: of(dict, keys=lambda _: [of(object, __str__=raises)()])(),
        lambda: {name: of(object, __float__=raises)() for name in NAMES},
    ],
)
def test_exception_inside_cast_passes_on(made: Callable[[], Any], unraisable: list[Any]) -> None:
    pose = made()
    with pytest.raises(Interrupt):
        move(pose)
    assert unraisable == []


@pytest.fixture
def alarms() -> Iterator[list[int]]:
    """Raises Interrupt on SIGALRM. Counts the signals."""
    delivered: list[int] = []

    def handle(*_: object) -> None:
        delivered.append(1)
        raise Interrupt

    before = signal.signal(signal.SIGALRM, handle)
    yield delivered
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


def until(alarms: list[int], turn: int, call: Callable[[], None]) -> None:
    """Repeats a call until the handler has run in this turn."""
    end = time.monotonic() + HANDLED_S
    while len(alarms) == turn:
        assert time.monotonic() < end, f"signal {turn} has no handler; pending: {signal.sigpending()}"
        call()


@pytest.mark.parametrize("pose", [[0.1] * 12, UserDict({name: 0.1 for name in NAMES}), np.full(12, 0.1), 0.1])
def test_each_signal_ends_move(pose: Any, alarms: list[int], unraisable: list[Any]) -> None:
    """Signals at random moments, most of them inside a call."""
    numbers, caught = random.Random(1), 0
    for turn in range(SIGNALS):
        try:
            signal.setitimer(signal.ITIMER_REAL, numbers.uniform(1e-6, 3e-4))
            until(alarms, turn, lambda: move(pose))
        except Interrupt:
            caught += 1
    assert (caught, len(alarms), unraisable) == (SIGNALS, SIGNALS, [])


def test_each_signal_ends_move_of_claim(robot: motord.Robot, alarms: list[int]) -> None:
    with robot.claim("legs") as legs:
        legs.enable()
        here, numbers, caught = legs.wait().q.tolist(), random.Random(2), 0
        for turn in range(40):
            try:
                signal.setitimer(signal.ITIMER_REAL, numbers.uniform(1e-4, 0.1))
                until(alarms, turn, lambda: legs.move_to(here, 0.02))
            except Interrupt:
                caught += 1
    assert caught == len(alarms) == 40


def test_exception_of_names_passes_on(robot: motord.Robot) -> None:
    with pytest.raises(Interrupt):
        robot.wait(names=of(list, __len__=raises)(["fl-hip"]))
    with pytest.raises(Interrupt):
        robot.claim("legs", names=of(list, __getitem__=raises)(["fl-hip"]))
    with pytest.raises(TypeError):
        robot.wait(names="fl-hip")


# Imports motord, and gets SIGINT when a module is imported, or when a function is called.
IMPORT = """
import os, signal, sys
kind, name = sys.argv[1:]

def interrupt(found):
    if found == name:
        sys.setprofile(None)
        os.kill(os.getpid(), signal.SIGINT)

if kind == "import":
    sys.addaudithook(lambda event, arguments: event == "import" and interrupt(arguments[0]))
else:
    def call(frame, event, _):
        if event == "call":
            interrupt(os.path.basename(frame.f_code.co_filename) + ":" + frame.f_code.co_name)

    sys.setprofile(call)
import motord
print("imported")
"""


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        # numpy loads this one from C, and would raise ImportError.
        ("import", "datetime"),
        ("import", "numpy"),
        ("import", "motord.recording"),
        # The compiled part reads the version of numpy while it is initialised, and would panic.
        ("call", "_version.py:__init__"),
    ],
)
def test_interrupted_import_raises_keyboard_interrupt(kind: str, name: str) -> None:
    command = [sys.executable, "-c", IMPORT, kind, name]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60.0, preexec_fn=interruptible)
    assert ended.returncode == -signal.SIGINT and ended.stdout == "", ended.stderr
    assert ended.stderr.startswith("Traceback") and ended.stderr.endswith("\nKeyboardInterrupt\n"), ended.stderr


def test_import_leaves_no_signal_blocked() -> None:
    program = "import signal, motord; print(signal.pthread_sigmask(signal.SIG_BLOCK, ()))"
    assert subprocess.check_output([sys.executable, "-c", program], text=True) == "set()\n"
