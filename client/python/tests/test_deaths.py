"""Controllers that end, emergency stops from other threads, and forked processes.

Order and counts are judged, no times of this machine. The objects of a forked process belong to its parent: the child changes
nothing.
"""

import json
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


PARENT = """
import gc, json, multiprocessing, os, sys, time
import motord
robot = motord.connect('demo')
def outcome(call):
    try:
        call()
    except BaseException as error:
        return type(error).__name__
    return 'nothing'
with robot.claim('legs') as legs:
    legs.enable()
    first = legs.wait()
    pid = os.fork()
    if pid == 0:
%s
    for state in legs.cycles():
        legs.send(q=first.q, kp=20.0, kd=0.5)
        if state.time - first.time > 0.5 and os.waitpid(pid, os.WNOHANG)[0] == pid:
            break
    print('held', legs.wait().phase, flush=True)
"""


def run_child(daemon: Daemon, child: str) -> tuple[str, str]:
    """Runs a controller that forks a child with this code. Returns what it prints to standard output and to standard error."""
    code = PARENT % "\n".join(f"        {line}" for line in child.strip().splitlines())
    with daemon.python("-c", code) as controller:
        output, errors = controller.communicate(timeout=60.0)
    assert controller.returncode == 0, errors
    return output, errors


@pytest.mark.parametrize(
    "child",
    [
        "sys.exit(0)",
        "raise KeyError('of the child')",
        "legs.__exit__(None, None, None); os._exit(0)",
        "del legs, robot; gc.collect(); os._exit(0)",
        "multiprocessing.get_context('fork').Pool(2).map(abs, [-1, -2]); os._exit(0)",
        "assert motord.connect('demo').wait().cycle > 0; os._exit(0)",
    ],
)
def test_end_of_child_keeps_group_active(daemon: Daemon, robot: motord.Robot, child: str) -> None:
    output, errors = run_child(daemon, child)
    assert output == "held active\n" and "panicked" not in errors, (output, errors)
    with robot.claim("legs") as legs:
        assert legs.wait().stop is None


CALLS = """
calls = {
    'robot.wait': robot.wait, 'newest': robot.newest, 'fileno': robot.fileno, 'claim': lambda: robot.claim('legs'),
    'robot.disable': lambda: robot.disable('legs'), 'robot.reset': lambda: robot.reset('legs'),
    'telemetry': robot.telemetry, 'publish_imu': lambda: robot.publish_imu('base'), 'wait': legs.wait,
    'send': lambda: legs.send(kd=0.5), 'move_to': lambda: legs.move_to(0.0, 1.0), 'cycles': lambda: next(legs.cycles()),
    'enable': legs.enable, 'disable': legs.disable, 'reset': legs.reset, 'release': legs.release,
}
found = {name: outcome(call) for name, call in calls.items()}
print(json.dumps([found, robot.joints == first.joints, bool((first.q == first.q).all())]), flush=True)
os._exit(0)
"""


def test_calls_of_child_raise_forked(daemon: Daemon, robot: motord.Robot) -> None:
    output, errors = run_child(daemon, CALLS)
    outcomes, held = output.splitlines()
    found, has_names, has_state = json.loads(outcomes)
    assert set(found.values()) == {"Forked"}, found
    assert has_names and has_state and held == "held active" and errors == ""
    assert issubclass(motord.Forked, motord.Error)


def test_child_stops_robot_of_parent(daemon: Daemon, robot: motord.Robot) -> None:
    stops = "print(outcome(robot.estop), flush=True); os._exit(0)"
    code = PARENT % f"        {stops}"
    with daemon.python("-c", code) as controller:
        output, errors = controller.communicate(timeout=60.0)
    assert output == "nothing\n" and controller.returncode == 1 and "motord.Stopped" in errors, (output, errors)
    with robot.claim("legs") as legs:
        assert legs.wait().stop == "emergency-stop"
