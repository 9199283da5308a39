"""Claims whose setpoints a thread repeats, and claims of one process, as notebooks have them."""

import time

import numpy as np
import pytest

import motord
from conftest import CONFIG, Daemon
from motord.sim import Twin

LONGER = 1.5
"""Than the setpoint timeout of these daemons, s, and than the silence that ends a claim at rest."""
END_S = 60.0


def ended(keep: motord.Keep) -> str:
    """Waits until the thread has ended."""
    limit = time.monotonic() + END_S
    while keep.end is None and time.monotonic() < limit:
        time.sleep(0.01)
    assert keep.end is not None
    return keep.end


def test_kept_group_outlasts_the_setpoint_timeout(robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        keep = legs.keep()
        time.sleep(LONGER)
        legs.enable(hold=(30.0, 0.8))
        time.sleep(LONGER)
        state = legs.wait()
        assert (state.phase, state.stop, keep.end) == ("active", None, None)
        assert state.applied["kp"][0] == pytest.approx(30.0, rel=0.01)
        keep.stop()
        assert keep.end == "stop was called" and "ended: stop was called" in repr(keep)
        with pytest.raises(motord.Stopped) as stopped:
            for _ in legs.cycles():
                pass
    assert stopped.value.cause == "setpoint-timeout"


def test_keep_ends_without_new_setpoints(robot: motord.Robot, capsys: pytest.CaptureFixture[str]) -> None:
    with robot.claim("legs") as legs:
        legs.enable()
        keep = legs.keep(seconds=0.5)
        pose = legs.wait().q
        begun = time.monotonic()
        while time.monotonic() < begun + 1.0:
            legs.send(q=pose)
            legs.wait()
        assert keep.end is None, "each new setpoint renews it"
        assert ended(keep) == "the program sent no new setpoint for 0.5 s"
        with pytest.raises(motord.Stopped) as stopped:
            for _ in legs.cycles():
                pass
        assert stopped.value.cause == "setpoint-timeout"
    assert "motord: keep of legs ended, and nothing repeats its setpoints any more: the program" in capsys.readouterr().err


def test_stop_of_robot_ends_keep(robot: motord.Robot, capsys: pytest.CaptureFixture[str]) -> None:
    with robot.claim("legs") as legs:
        legs.enable()
        keep = legs.keep()
        robot.estop()
        assert "An emergency stop was requested" in ended(keep)
    assert "keep of legs ended" in capsys.readouterr().err


def test_end_of_claim_ends_keep_silently(robot: motord.Robot, capsys: pytest.CaptureFixture[str]) -> None:
    legs = robot.claim("legs")
    keep = legs.keep()
    another = legs.keep()
    assert ended(keep) == "another keep replaced it"
    legs.release()
    assert ended(another) == "the claim was released"
    again = robot.claim("legs")
    keep = again.keep()
    del again
    assert ended(keep) == "the claim was deleted"
    robot.claim("legs").release()
    assert capsys.readouterr().err == ""


def test_torque_without_stiffness_is_not_repeated(robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        legs.enable()
        keep = legs.keep()
        legs.send(kd=1.0, tau=0.01)
        assert "fl-hip has a torque or a velocity without a stiffness" in ended(keep)


def test_repeated_velocity_is_zero(robot: motord.Robot) -> None:
    with robot.claim("legs") as legs:
        legs.enable()
        legs.keep()
        pose = legs.wait().q
        legs.send(q=pose, dq=0.05)
        for _ in range(20_000):
            if np.abs(legs.wait().applied["dq"]).max() > 0.02:
                break
        for _ in range(20_000):
            if np.abs(legs.wait().applied["dq"]).max() < 0.001:
                break
        else:
            raise AssertionError("the velocity is repeated")
        assert legs.wait().phase == "active"


def test_keep_ends_with_the_interpreter(daemon: Daemon, robot: motord.Robot) -> None:
    code = "import motord\nlegs = motord.connect('demo').claim('legs')\nlegs.enable()\nlegs.keep(seconds=1e4)\n"
    with daemon.python("-c", code) as program:
        _, errors = program.communicate(timeout=END_S)
    assert (program.returncode, errors) == (0, "")
    for _ in range(20_000):
        if np.abs(robot.wait().applied["kp"]).max() == 0.0:
            break
    else:
        raise AssertionError("the group is never damped")


@pytest.mark.parametrize("hz", [1.0, 0.0, -5.0, float("nan"), 1e6])
def test_rates_of_keep_fit_the_timeout(robot: motord.Robot, hz: float) -> None:
    with robot.claim("legs") as legs, pytest.raises(ValueError, match="give 2 to 1000, since setpoint-timeout-ms is 1000"):
        legs.keep(hz)


def test_deleted_claim_frees_its_group(robot: motord.Robot) -> None:
    for _ in range(3):
        legs = robot.claim("legs")
        legs.wait()
        del legs


def test_owner_of_claimed_group_is_named(daemon: Daemon, robot: motord.Robot) -> None:
    legs = robot.claim("legs")
    with pytest.raises(motord.Refused, match="this process owns the group already: release or drop its earlier claim"):
        robot.claim("legs")
    legs.release()
    code = "import motord\nlegs = motord.connect('demo').claim('legs')\nlegs.keep()\nprint(flush=True)\ninput()"
    with daemon.python("-c", code) as other:
        assert other.stdout and other.stdout.readline()
        with pytest.raises(motord.Refused, match=rf"process {other.pid} \(python\S*\) owns the group"):
            robot.claim("legs")


def test_twin_keeps_setpoints_as_the_robot(capsys: pytest.CaptureFixture[str]) -> None:
    robot = Twin(CONFIG)
    legs = robot.claim("legs")
    legs.enable()
    keep = legs.keep(seconds=2.0)
    for _ in range(1900):
        legs.wait()
    assert (legs.wait().phase, keep.end) == ("active", None)
    for _ in range(700):
        legs.wait()
    assert legs.wait().stop == "setpoint-timeout" and keep.end == "the program sent no new setpoint for 2 s"
    assert "keep of legs ended" in capsys.readouterr().err


def test_twin_ends_keep_with_its_claim() -> None:
    robot = Twin(CONFIG)
    legs = robot.claim("legs")
    first, second = legs.keep(), legs.keep()
    legs.release()
    robot.wait()
    assert (first.end, second.end) == ("another keep replaced it", "the claim was released")
    with pytest.raises(ValueError, match="give 10 to 1000, since setpoint-timeout-ms is 200"):
        robot.claim("legs").keep(5.0)
