"""Objects in a forked process: they belong to the parent, and the child changes nothing."""

import json

import pytest

import motord
from conftest import Daemon

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


def run(daemon: Daemon, child: str) -> tuple[str, str]:
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
    output, errors = run(daemon, child)
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
    output, errors = run(daemon, CALLS)
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
