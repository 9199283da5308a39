"""Controllers that end, and emergency stops from other threads. Order and counts are judged, no times of this machine."""

import os
import signal
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

import motord
from conftest import Daemon, reset

REPETITIONS = int(os.environ.get("MOTORD_REPETITIONS", "5"))
CONTROLLER = """
import motord, sys, time
with motord.connect('demo').claim('legs') as legs:
    legs.enable()
    print('active', flush=True)
    for state in legs.cycles():
        legs.send(q=state.q, kp=20.0, kd=0.5)
        %s
"""
# The shortest timeouts that a shared machine permits.
SHORT = {"setpoint-timeout-ms = 200.0": "setpoint-timeout-ms = 100.0"}


def end_of_group(robot: motord.Robot) -> tuple[str | None, str | None, float]:
    """Waits until the motors are damped. Returns cause, the phase after it, and when that was."""
    for _ in range(20_000):
        state = robot.wait()
        if np.abs(state.applied["kp"]).max() == 0.0:
            at = time.monotonic()
            with robot.claim("legs") as legs:
                return legs.wait().stop, legs.wait().phase, at
    raise AssertionError("the group is never damped")


@pytest.mark.parametrize(
    ("end", "cause"),
    [
        ("__import__('os').kill(__import__('os').getpid(), 9)", "owner-died"),
        ("time.sleep(60)", "setpoint-timeout"),
        ("__import__('os')._exit(3)", "owner-died"),
    ],
)
def test_dead_process_is_damped(start: Callable[..., Daemon], end: str, cause: str) -> None:
    """Killed: damped in the next cycles. Hanging: damped after setpoint-timeout-ms, not before."""
    daemon = start(SHORT)
    robot = daemon.connect()
    with daemon.python("-c", CONTROLLER % end) as controller:
        assert controller.stdout and controller.stdout.readline() == "active\n"
        begun = time.monotonic()
        found, phase, at = end_of_group(robot)
        controller.kill()
    print(f"{cause}: damped {1e3 * (at - begun):.1f} ms after the controller was active")
    assert found == cause and phase in ("damping", "disarmed")
    if cause == "setpoint-timeout":
        assert at - begun > 0.09, "not before the timeout"
    reset(robot)


def test_exception_disables_and_exits_non_zero(daemon: Daemon, robot: motord.Robot) -> None:
    with daemon.python("-c", CONTROLLER % "raise KeyError('of the controller')") as controller:
        _, errors = controller.communicate(timeout=60.0)
    assert controller.returncode == 1 and "KeyError: 'of the controller'" in errors
    with robot.claim("legs") as legs:
        state = legs.wait()
        assert (state.phase, state.stop) == ("disarmed", None), "disabled by its owner, no stop"


def test_stop_comes_while_other_thread_waits(daemon: Daemon, robot: motord.Robot) -> None:
    """One thread sends and then waits for half a second; the stop of a second one is confirmed before it wakes up."""
    confirmed: list[float] = []
    first = 0
    for _ in range(REPETITIONS):
        with robot.claim("legs") as legs:
            legs.enable()
            sent, woken = threading.Event(), threading.Event()

            def loop(legs: motord.Claim = legs, sent: threading.Event = sent, woken: threading.Event = woken) -> None:
                with pytest.raises(motord.Stopped, match="emergency"):
                    for state in legs.cycles(hz=2.0, timeout=30.0):
                        woken.set()
                        legs.send(q=state.q, kp=20.0, kd=0.5)
                        woken.clear()
                        sent.set()
                woken.set()

            thread = threading.Thread(target=loop)
            thread.start()
            assert sent.wait(30.0)
            begun = time.perf_counter()
            robot.estop()
            confirmed.append(1e3 * (time.perf_counter() - begun))
            first += not woken.is_set()
            thread.join(30.0)
            assert woken.is_set() and not thread.is_alive()
        reset(robot)
    shares = np.percentile(confirmed, [0, 50, 90, 100])
    print("stop from a second thread, ms: min {:.2f}, p50 {:.2f}, p90 {:.2f}, max {:.2f}".format(*shares))
    assert first >= 0.9 * REPETITIONS, (first, confirmed)


def test_waiting_thread_lets_others_run(daemon: Daemon) -> None:
    """A thread that waits for a state of a stopped daemon keeps no lock: the other one counts meanwhile."""
    robot = daemon.connect()
    robot.wait()
    ended: list[str] = []

    def wait() -> None:
        try:
            while True:
                robot.wait(timeout=0.5)
        except motord.Error as error:
            ended.append(type(error).__name__)

    daemon.process.send_signal(signal.SIGSTOP)
    try:
        thread = threading.Thread(target=wait)
        thread.start()
        counted = 0
        while thread.is_alive():
            counted += 1
            time.sleep(0.001)
        thread.join()
    finally:
        daemon.process.send_signal(signal.SIGCONT)
    assert ended and counted > 5, (ended, counted)


WARNED = """
import sys, threading, motord
busy = sys.argv[1] == 'busy'
if len(sys.argv) > 2:
    sys.setswitchinterval(float(sys.argv[2]))
done = threading.Event()
def work():
    total = 0
    while not done.is_set():
        total += sum(range(100)) if busy else 0
        if not busy:
            done.wait(0.01)
thread = threading.Thread(target=work)
thread.start()
robot = motord.connect('demo')
for _ in range(100):
    robot.wait()
done.set()
thread.join()
"""


@pytest.mark.parametrize(("arguments", "is_warned"), [(["busy"], True), (["busy", "0.0005"], False), (["idle"], False)])
def test_warning_names_cure(daemon: Daemon, arguments: list[str], is_warned: bool) -> None:
    with daemon.python("-c", WARNED, *arguments) as program:
        _, errors = program.communicate(timeout=120.0)
    assert program.returncode == 0, errors
    assert errors.count("RuntimeWarning") == int(is_warned), errors
    assert ("call sys.setswitchinterval(0.0005) before motord.connect" in errors) == is_warned
