"""The robot on virtual time, with a plant in Python and with MuJoCo."""

import hashlib
import re
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import motord
from motord.sim import Ideal, Mujoco, Twin, fit_mjcf
from motord.sim.plant import Array

CONFIG = Path(__file__).parents[3] / "config" / "quadruped-simulated.toml"
LEGS = ("fl", "fr", "rl", "rr")
NAMES = [f"{leg}-{joint}" for leg in LEGS for joint in ("hip", "thigh", "knee")]
REACH = np.tile([0.05, 0.2, -0.4], 4)
PHASE = np.repeat([0.0, np.pi, np.pi, 0.0], 3)


class Alone:
    """Each joint alone: inertia, dry and viscous friction, as the motors of the configuration have without a plant."""

    def begin(self, description: dict[str, Any], physics: list[dict[str, Any]]) -> None:
        load = 0.01
        self.inertia = np.array([motor["armature"] + load for motor in physics])
        self.damping = np.array([motor["damping"] for motor in physics])
        self.friction = np.array([motor["friction"] for motor in physics])

    def step(self, torques: Array, seconds: float, q: Array, dq: Array) -> None:
        momentum = self.inertia * dq + torques * seconds
        kept = np.copysign(np.maximum(np.abs(momentum) - self.friction * seconds, 0.0), momentum)
        dq[:] = kept / (self.inertia + self.damping * seconds)
        q += dq * seconds

    def imu(self) -> None:
        return None


class Level(Alone):
    """With an IMU on a body that is level and at rest."""

    def imu(self) -> tuple[Array, Array, Array]:  # type: ignore[override]
        return np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.0, 0.0, 9.81])


class Clocked(Alone):
    """A plant that asks its twin for the time, and once for more than it may."""

    twin: Twin
    times: list[float] = []
    greedy = False

    def step(self, torques: Array, seconds: float, q: Array, dq: Array) -> None:
        super().step(torques, seconds, q, dq)
        self.times.append(self.twin.time)
        if self.greedy:
            self.twin.at(1.0, "fl-hip", "off")


def test_plant_reads_time_of_its_twin() -> None:
    plant = Clocked()
    plant.twin = Twin(CONFIG, plant)
    for _ in range(10):
        plant.twin.wait()
    assert plant.times == sorted(plant.times) and plant.times[-1] > 5e-3
    plant.greedy = True
    with pytest.raises(RuntimeError, match="can read its time only"):
        plant.twin.wait()


def test_other_thread_reads_time_of_a_twin() -> None:
    twin = Twin(CONFIG, Alone())
    seen = [0.0]
    end = threading.Event()

    def watch() -> None:
        while not end.is_set():
            seen.append(twin.time)

    other = threading.Thread(target=watch)
    other.start()
    while seen[-1] == 0.0 and twin.time < 60.0:
        twin.wait()
    end.set()
    other.join()
    assert seen == sorted(seen) and seen[-1] > 0.0


def mjcf(edit: Callable[[str], str] = str) -> str:
    """Twelve hinges beside each other, with the inertia of the configuration's loads."""
    body = """<body><joint name="{name}" type="hinge" axis="0 1 0" range="-180 180"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body>"""
    bodies = "".join(body.format(name=name) for name in NAMES)
    return edit(f"""<mujoco><option gravity="0 0 0" integrator="implicitfast"/>
      <worldbody><site name="imu"/>{bodies}</worldbody></mujoco>""")


def positions(state: motord.State) -> Array:
    return state.q


def everything(state: motord.State) -> Array:
    """Each number that a controller can read."""
    imu = state.imu["base"]
    joints = [state.q, state.dq, state.tau, state.temperature, state.joint_age, *state.applied.values()]
    sensor = [imu.orientation, imu.angular_velocity, imu.acceleration, [imu.age if imu.age is not None else np.nan]]
    return np.concatenate([*joints, *sensor, [state.time, state.age, float(state.cycle), float(state.sequence)]])


def trot(twin: Twin, seconds: float, of: Callable[[motord.State], Array] = positions) -> Array:
    """What of returns for each cycle of a trot: the positions by default."""
    track, begin = [], None
    with twin.claim("legs") as legs:
        legs.enable(hold=(60.0, 1.5))
        for state in legs.cycles():
            track.append(of(state))
            begin = state if begin is None else begin
            now = state.time - begin.time
            if now >= seconds:
                break
            angle, soft = 4.0 * np.pi * now + PHASE, min(now / 0.5, 1.0)
            legs.send(
                q=begin.q + soft * REACH * np.sin(angle), dq=soft * REACH * 4.0 * np.pi * np.cos(angle), kp=60.0, kd=1.5
            )
    return np.array(track)


@pytest.mark.parametrize("make", [lambda: Twin(CONFIG), lambda: Ideal(CONFIG, Alone())])
def test_mapping_moves_joints_by_name(make: Callable[[], Twin]) -> None:
    for names in (NAMES, NAMES[::-1]):
        with make().claim("legs", names=names) as legs:
            legs.enable()
            begin = dict(zip(names, legs.wait().q, strict=True))
            goal = {name: begin[name] + 0.001 * at for at, name in enumerate(NAMES)}
            gains = {name: 10.0 + at for at, name in enumerate(NAMES)}
            state = legs.wait()
            for state, _ in zip(legs.cycles(), range(600)):
                legs.send(q=goal, dq=dict.fromkeys(NAMES, 0.1), kp=gains, kd=dict.fromkeys(NAMES, 1.0), tau=dict.fromkeys(NAMES, 0.5))
        applied = state.applied
        assert dict(zip(names, applied["q"], strict=True)) == pytest.approx(goal, abs=2e-3)
        assert dict(zip(names, applied["kp"], strict=True)) == pytest.approx(gains, rel=0.02)
        assert applied["dq"] == pytest.approx(0.1, abs=0.05) and state.phase == "active"


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        ({"q": {"fl-hip": 0.0}}, "q lacks fl-thigh"),
        ({"q": {**dict.fromkeys(NAMES, 0.0), "tail": 0.0}}, 'q has "tail"; there are fl-hip'),
        ({"q": np.zeros(3)}, "q has 3 values; the group has 12 joints"),
        ({"q": float("nan")}, "finite"),
        ({"kp": 1.0}, "kp without q"),
    ],
)
@pytest.mark.parametrize("make", [lambda: Twin(CONFIG), lambda: Ideal(CONFIG, Alone())])
def test_bad_setpoints_are_explained(make: Callable[[], Twin], arguments: dict[str, Any], part: str) -> None:
    with make().claim("legs") as legs, pytest.raises(ValueError, match=part):
        legs.send(**arguments)


def rms(difference: Array) -> float:
    return float(np.sqrt(np.mean(difference**2)))


def test_plant_reproduces_builtin_mechanics() -> None:
    inside, outside = (trot(Twin(CONFIG, plant, seed=3), 3.0) for plant in (None, Alone()))
    assert inside.shape == outside.shape and rms(inside - inside[0]) > 0.05
    assert rms(inside - outside) < 1e-3


def test_mujoco_reproduces_builtin_mechanics(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    model = tmp_path / "robot.xml"
    model.write_text(mjcf())
    inside, outside = (trot(Twin(CONFIG, plant, seed=3), 10.0) for plant in (None, Mujoco(model)))
    difference = rms(inside - outside)
    print(f"built-in mechanics and MuJoCo differ by {1e3 * difference:.3f} mrad RMS over 10 s")
    assert difference < 1e-3


RUN = """
import hashlib, sys
sys.path.insert(0, sys.argv[1])
from test_twin import CONFIG, Level, Twin, everything, trot
twin = Twin(CONFIG, Level(), compute_us=300, seed=int(sys.argv[2]))
print(hashlib.sha256(trot(twin, 1.0, everything).tobytes()).hexdigest())
"""


def test_processes_with_equal_seeds_agree() -> None:
    folder = str(Path(__file__).parent)
    command = [sys.executable, "-c", RUN, folder, "5"]
    first, again = (subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(2))
    assert first == again and len(first.strip()) == hashlib.sha256().digest_size * 2


def test_ages_are_on_virtual_time() -> None:
    twin = Twin(CONFIG, Level())
    state = [twin.wait() for _ in range(20)][-1]
    imu = state.imu["base"]
    assert 0.0 <= state.age < 1e-3
    assert ((state.joint_age >= 0.0) & (state.joint_age < 2e-3)).all(), state.joint_age
    assert imu.age is not None and 0.0 <= imu.age < 5e-3
    before = np.array([state.age, *state.joint_age, imu.age])
    for _ in range(50):
        twin.wait()
    after = np.array([state.age, *state.joint_age, imu.age])
    assert after - before == pytest.approx(50 / twin.rate_hz, abs=1e-4)


class Tensor:
    """An array of another library, such as torch: with one value it is a number to float()."""

    def __init__(self, values: Any) -> None:
        self._values = np.asarray(values)
        self.shape = self._values.shape

    def __len__(self) -> int:
        return len(self._values)

    def __getitem__(self, at: int) -> "Tensor":
        return Tensor(self._values[at])

    def __float__(self) -> float:
        return float(self._values.item())


@pytest.mark.parametrize(
    ("value", "part"),
    [
        (np.array([0.3]), "q has 1 values; the group has 12 joints"),
        ([0.3], "q has 1 values; the group has 12 joints"),
        (Tensor([0.3]), "q has 1 values; the group has 12 joints"),
        (np.full((1, 12), 0.3), r"q has the shape \(1, 12\): give a number, or an array of 12, such as q\[0\]"),
        (np.full((12, 1), 0.3), r"q has the shape \(12, 1\): give a number, or an array of 12$"),
        (Tensor(np.full((1, 12), 0.3)), r"q has the shape \(1, 12\)"),
        (np.full((1, 1), 0.3), r"q has the shape \(1, 1\)"),
        ([[0.3]] * 12, "one-dimensional array of 12"),
        (np.ma.masked_array(np.full(12, 0.3), mask=True), "q is <class 'numpy.ma.MaskedArray'> of float64: give a number"),
        (np.full(12, 0.3 + 1j), "q is <class 'numpy.ndarray'> of complex128: give a number"),
        (np.complex64(0.3 + 1j), "q is <class 'numpy.complex64'>"),
        (np.array(["a"] * 12), "q is <class 'numpy.ndarray'> of <U1: give a number"),
        (b"\0" * 12, "q is <class 'bytes'>: give a number"),
        (bytearray(12), "q is <class 'bytearray'>: give a number"),
    ],
)
def test_setpoints_of_other_shapes_are_refused(value: Any, part: str) -> None:
    for kind in (Twin, Ideal):
        with kind(CONFIG, Alone()).claim("legs") as legs, pytest.raises(ValueError, match=part):
            legs.enable()
            legs.send(q=value, kp=20.0, kd=0.5)


@pytest.mark.parametrize("value", [np.array(0.3), np.float32(0.3), Tensor(0.3), Tensor(np.full(12, 0.3)), [Tensor(0.3)] * 12])
def test_numbers_and_arrays_of_other_libraries_are_sent(value: Any) -> None:
    for kind in (Twin, Ideal):
        with kind(CONFIG, Alone()).claim("legs") as legs:
            legs.enable()
            legs.send(dq=value, kd=0.5)
            assert legs.wait().applied["dq"][11] > 0.0


def test_lost_motor_stops_as_on_the_robot() -> None:
    twin = Twin(CONFIG, Alone())
    with twin.claim("legs") as legs:
        legs.enable()
        twin.at(twin.time + 0.1, "fl-knee", "off")
        with pytest.raises(motord.Stopped) as stopped:
            for state in legs.cycles(hz=500):
                legs.send(q=state.q, kp=20.0, kd=0.5)
    assert (stopped.value.cause, stopped.value.joint) == ("motor-lost", "fl-knee")
    # The words of a claim on the robot.
    assert re.match(r"group legs was stopped: .* \(joint fl-knee\)\. .*, then reset the group$", str(stopped.value))
    with pytest.raises(ValueError, match="nobody off"):
        twin.at(1.0, "nobody", "off")


def test_silent_controller_is_stopped_and_reset_frees_group() -> None:
    twin = Twin(CONFIG)
    legs = twin.claim("legs")
    legs.enable()
    for _ in range(3000):
        twin.wait()
    with twin.claim("legs") as legs:
        assert legs.wait().stop == "setpoint-timeout"
        with pytest.raises(motord.Refused) as refused:
            legs.enable()
        assert refused.value.reason == "latched"
        twin.reset("legs")
        legs.enable()
        goal = legs.wait().q + 0.1
        legs.move_to(goal, 0.5)
        for _ in range(100):
            legs.send(q=goal, kp=20.0, kd=0.5)
            legs.wait()
        assert abs(legs.wait().q - goal).max() < 0.05


ROBOT = CONFIG.with_name("quadruped.toml")
"""With the default setpoint timeout, 20 ms."""


@pytest.mark.parametrize("before", ["enable", "move", "send", "wait"])
def test_slow_loop_begins_at_each_phase(before: str) -> None:
    for phase in range(20):
        twin = Twin(ROBOT, seed=phase)
        for _ in range(40 + phase):
            twin.wait()
        with twin.claim("legs") as legs:
            legs.enable(hold=(40.0, 1.0))
            goal = legs.state().q
            if before == "move":
                goal = goal - 0.05
                legs.move_to(goal, 0.2)
            if before == "send":
                for _ in range(30):
                    legs.send(q=goal)
                    legs.wait()
            if before == "wait":
                for _ in range(10):
                    legs.wait()
            cycles = []
            for state in legs.cycles(hz=50):
                cycles.append(state.cycle)
                legs.send(q=goal, kp=40.0, kd=1.0, horizon=0.025)
                if len(cycles) == 10:
                    break
        assert all(cycle % 20 == 0 for cycle in cycles) and np.diff(cycles).tolist() == [20] * 9


def test_late_loop_gets_stop_with_gap_and_cure() -> None:
    twin = Twin(ROBOT, seed=3)
    with twin.claim("legs") as legs:
        legs.enable()
        for state in legs.cycles():
            legs.send(q=state.q, kp=20.0, kd=0.5)
            if state.cycle % 100 == 0:
                break
        for _ in range(35):
            legs.wait()
        for _ in range(3):
            with pytest.raises(motord.Stopped, match="none for 3[0-9].[0-9] ms, and setpoint-timeout-ms is 20. .* claim") as late:
                legs.send(q=0.0, kp=20.0, kd=0.5)
            assert late.value.cause == "setpoint-timeout" and late.value.timeout == 0.02
            assert late.value.gap == pytest.approx(0.035, abs=2e-3)
        with pytest.raises(motord.Stopped, match="sent none for"):
            next(legs.cycles())
        with pytest.raises(motord.Stopped):
            legs.move_to(0.0, 1.0)
        while legs.wait().phase != "disarmed":
            pass
        twin.reset("legs")
        with pytest.raises(motord.ClaimLost, match="claim it again"):
            legs.send(kd=1.0)
    with twin.claim("legs") as legs:
        legs.enable()
        assert legs.wait().phase == "active"


def test_setpoints_after_a_stop_fail_until_reset() -> None:
    twin = Twin(CONFIG)
    with twin.claim("legs") as legs:
        legs.enable()
        first = legs.wait()
        twin.estop()
        for _ in range(3):
            with pytest.raises(motord.Stopped, match="An emergency stop was requested") as stopped:
                legs.send(q=first.q, kp=20.0, kd=0.5)
            legs.wait()
            assert (stopped.value.cause, stopped.value.gap) == ("emergency-stop", None)


def test_position_without_gains_keeps_those_of_enable() -> None:
    twin = Twin(CONFIG)
    with twin.claim("legs") as legs:
        legs.enable(hold=(30.0, 0.8))
        first = legs.wait()

        def applied(**setpoint: Any) -> list[float]:
            state = first
            # Longer than the gains take to rise.
            for _ in range(300):
                legs.send(**setpoint)
                state = legs.wait()
            return [float(state.applied[gain][0]) for gain in ("kp", "kd")]

        assert applied(q=first.q) == pytest.approx([30.0, 0.8], rel=0.01)
        assert applied(q=first.q, kp=20.0) == pytest.approx([20.0, 0.8], rel=0.01)
        assert applied(q=first.q, kp=20.0, kd=0.5) == pytest.approx([20.0, 0.5], rel=0.01)
        assert applied(dq=0.0) == pytest.approx([0.0, 0.8], rel=0.01, abs=0.05)
        assert applied(tau=0.0) == pytest.approx([0.0, 0.0], abs=0.01)


def test_emergency_stop_latches() -> None:
    twin = Twin(CONFIG)
    with twin.claim("legs") as legs:
        legs.enable()
        twin.estop()
        with pytest.raises(motord.Stopped) as stopped:
            next(iter(legs.cycles()))
    assert stopped.value.cause == "emergency-stop"


def test_emergency_stop_names_silent_motors() -> None:
    twin = Twin(CONFIG)
    twin.at(0.1, "fl-knee", "off")
    for _ in range(500):
        twin.wait()
    with pytest.raises(motord.MotorsOffline, match="cut the power: fl-knee$") as stopped:
        twin.estop()
    assert stopped.value.joints == ["fl-knee"] and twin.wait().estopped


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        (lambda text: text.replace('"fl-knee"', '"fl-kne"'), "fl-knee: the model has no joint of this name; it has .*fl-kne"),
        (lambda text: text.replace('name="fr-hip" type="hinge"', 'name="fr-hip" type="slide"'), "fr-hip: it is no hinge"),
        (
            lambda text: text.replace('name="rl-knee"', 'name="rl-knee" armature="0.1"'),
            "rl-knee: armature is 0.1 in the model and 0.00384 by its motor",
        ),
        (
            lambda text: text.replace('name="rr-hip" type="hinge" axis="0 1 0" range="-180 180"', 'name="rr-hip" range="-5 5"'),
            "rr-hip: its limits are .* beyond",
        ),
        (
            lambda text: text.replace('name="rr-knee" type="hinge" axis="0 1 0" range="-180 180"', 'name="rr-knee" range="20 160"'),
            "rr-knee: its limits are .* its axis is reversed",
        ),
    ],
)
def test_contradicting_model_is_refused_by_joint(tmp_path: Path, edit: Callable[[str], str], expected: str) -> None:
    pytest.importorskip("mujoco")
    model = tmp_path / "robot.xml"
    model.write_text(mjcf(edit))
    with pytest.raises(ValueError, match=expected):
        Twin(CONFIG, Mujoco(model))


def heavier(folder: Path) -> Path:
    """A model whose joints have an armature and a damping of their own."""
    model = folder / "robot.xml"
    model.write_text(mjcf(lambda text: text.replace('type="hinge"', 'type="hinge" armature="0.01" damping="0.4"')))
    return model


def test_chosen_values_of_joints_count(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    model = heavier(tmp_path)
    (motor, *_) = Twin(CONFIG).physics
    mechanics = {"model": (0.01, 0.4), "configuration": (motor["armature"], motor["damping"])}
    for motors, expected in mechanics.items():
        plant = Mujoco(model, motors=motors)  # type: ignore[arg-type]
        Twin(CONFIG, plant).wait()
        joint = plant.model.joint("fl-hip")
        assert (joint.armature[0], np.ravel(joint.damping)[0]) == pytest.approx(expected)
        assert joint.frictionloss[0] == pytest.approx(motor["friction"]), "the model has none"
        fit_mjcf(CONFIG, model, tmp_path / "fitted.xml", motors=motors)  # type: ignore[arg-type]
        Twin(CONFIG, Mujoco(tmp_path / "fitted.xml", motors="model")).wait()
    with pytest.raises(ValueError, match='give "model" or "configuration"'):
        Twin(CONFIG, Mujoco(model, motors="both"))  # type: ignore[arg-type]


def test_advised_lines_make_model_fit(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    model, config = heavier(tmp_path), tmp_path / "robot.toml"
    with pytest.raises(ValueError) as refused:
        Twin(CONFIG, Mujoco(model))
    _, *advice = str(refused.value).split("[motor.simulation] # of ")
    assert len(advice) == len(NAMES) and "motors=" in str(refused.value)
    text = CONFIG.read_text()
    for part in advice:
        name, *lines = part.strip().splitlines()
        assert len(lines) == 2, lines
        before, motor = text.split(f'name = "{name}"')
        text = f'{before}name = "{name}"' + motor.replace("simulation = { ", "simulation = { " + ", ".join(lines) + ", ", 1)
    config.write_text(text)
    plant = Mujoco(model)
    Twin(config, plant).wait()
    assert plant.model.joint("rr-knee").armature[0] == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ('range="-180 180"', "fl-hip: the model has the range -180 to 180 rad, which looks like degrees"),
        ('range="-4.5 4.5"', None),
    ],
)
def test_ranges_in_degrees_are_named(tmp_path: Path, written: str, expected: str | None) -> None:
    pytest.importorskip("mujoco")
    model = tmp_path / "robot.xml"
    text = mjcf(lambda text: text.replace('range="-180 180"', written))
    model.write_text(text.replace("<mujoco>", '<mujoco><compiler angle="radian"/>'))
    if expected is None:
        Twin(CONFIG, Mujoco(model)).wait()
        model.write_text(text)
        expected = "fl-hip: its limits are .*its -4.5 to 4.5 degrees look like rad: write <compiler angle"
    with pytest.raises(ValueError, match=expected):
        Twin(CONFIG, Mujoco(model))


def test_wide_limits_of_joint_allow_wide_range(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    model, config = tmp_path / "robot.xml", tmp_path / "robot.toml"
    text = mjcf(lambda text: text.replace('range="-180 180"', 'range="-100 100"'))
    model.write_text(text.replace("<mujoco>", '<mujoco><compiler angle="radian"/>'))
    first, motor, rest = CONFIG.read_text().partition("[[motor]]")
    assert "position-rad = [" in rest
    low, _, high = rest.partition("position-rad = [")
    wide = f'{low}position-rad = [-50.0, 50.0]{high.partition("]")[2]}'
    config.write_text(first + motor + '\nbeyond-range = "wrap"' + wide)
    with pytest.raises(ValueError) as refused:
        Twin(config, Mujoco(model))
    assert "fl-hip" not in str(refused.value) and "fr-hip: the model has the range -100 to 100 rad" in str(refused.value)


def test_prefix_of_joints_is_mapped(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    model = tmp_path / "robot.xml"
    sides = [mjcf(lambda text: text.replace('joint name="', f'joint name="{side}_')) for side in ("left", "right")]
    bodies = [side.partition('<site name="imu"/>')[2].partition("</worldbody>")[0] for side in sides]
    model.write_text(mjcf(lambda text: text.partition('<site name="imu"/>')[0] + "".join(bodies) + "</worldbody></mujoco>"))
    with pytest.raises(ValueError, match="give the prefix 'left_' or 'right_'"):
        Twin(CONFIG, Mujoco(model))
    with pytest.raises(ValueError, match="no joint of this name behind the prefix 'middle_'"):
        Twin(CONFIG, Mujoco(model, prefix="middle_"))
    plant = Mujoco(model, prefix="right_")
    with Twin(CONFIG, plant).claim("legs") as legs:
        legs.enable()
        legs.move_to(legs.wait().q + 0.1, 0.5)
        assert abs(plant.data.joint("right_fl-hip").qpos[0] - legs.wait().q[0]) < 0.01
    assert plant.data.joint("left_fl-hip").qpos[0] == 0.0


def urdf(folder: Path) -> Path:
    """A joint whose link has a mesh of the package arm."""
    folder.mkdir(parents=True)
    inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    (folder / "arm.urdf").write_text(
        f"""<robot name="arm"><link name="base"/><link name="link"><inertial><mass value="1"/>{inertia}</inertial>
        <collision><geometry><mesh filename="package://arm/meshes/link.stl"/></geometry></collision></link>
        <joint name="arm" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 1 0"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    )
    return folder / "arm.urdf"


ONE = """
bus = [{ name = "desk", type = "simulated" }]
motor = [{ name = "arm", bus = "desk", id = 1, protocol = "mit", model = "GIM8108-8", limits.position-rad = [-0.9, 0.9] }]
"""


def test_meshes_of_a_package_are_found(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    config, model = tmp_path / "robot.toml", urdf(tmp_path / "arm" / "urdf")
    config.write_text(ONE)
    with pytest.raises(ValueError, match="package://arm/meshes/link.stl is not found: .*Copy the package arm"):
        Twin(config, Mujoco(model))
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], "<f4")
    triangles = [np.concatenate([np.zeros(3, "<f4"), corners[list(at)].ravel()]) for at in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))]
    mesh = bytes(80) + np.uint32(4).tobytes() + b"".join(triangle.tobytes() + bytes(2) for triangle in triangles)
    (tmp_path / "arm" / "meshes").mkdir()
    (tmp_path / "arm" / "meshes" / "link.stl").write_bytes(mesh)
    assert np.isfinite([Twin(config, Mujoco(model)).wait() for _ in range(2)][-1].time)


def test_fitted_model_has_motors_and_fits(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    model, fitted = tmp_path / "robot.xml", tmp_path / "fitted.xml"
    model.write_text(mjcf())
    fit_mjcf(CONFIG, model, fitted)
    joint = mujoco.MjModel.from_xml_path(str(fitted)).joint("fl-hip")
    assert joint.armature[0] == pytest.approx(3.84e-3) and joint.frictionloss[0] > 0.0 and joint.damping[0] > 0.0
    Twin(CONFIG, Mujoco(fitted)).wait()


def test_imu_of_mujoco_is_in_the_state(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    model = tmp_path / "robot.xml"
    model.write_text(mjcf(lambda text: text.replace('gravity="0 0 0"', "")))
    twin = Twin(CONFIG, Mujoco(model, imu="imu"))
    for _ in range(100):
        twin.wait()
    imu = twin.wait().imu[twin.imus[0]]
    assert imu.fresh or imu.sequence > 10
    assert imu.acceleration == pytest.approx([0.0, 0.0, 9.81], abs=0.5)
    assert imu.projected_gravity == pytest.approx([0.0, 0.0, -1.0], abs=0.01)
    with pytest.raises(ValueError, match="no site 'head'"):
        Twin(CONFIG, Mujoco(model, imu="head"))


def test_missing_imu_is_named_where_it_is_read() -> None:
    with pytest.warns(UserWarning, match="Give Mujoco imu=, the site of the IMU"):
        imu = Twin(CONFIG, Alone()).wait().imu["base"]
    assert imu.lost and np.isnan(imu.projected_gravity).all()
    with pytest.raises(KeyError, match="give Mujoco imu="):
        Ideal(CONFIG, Alone()).wait().imu["base"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Twin(CONFIG, Alone()).wait()
        Twin(CONFIG, Level()).wait().imu["base"]


@pytest.mark.parametrize("kind", [Twin, Ideal])
def test_plant_moves_its_newest_robot_only(kind: type[Twin]) -> None:
    plant = Alone()
    first = kind(CONFIG, plant)
    first.wait()
    second = kind(CONFIG, plant)
    with pytest.raises(RuntimeError, match="give each Twin a plant of its own"):
        first.wait()
    second.wait()
    # A name that is used again, as in a notebook.
    second = kind(CONFIG, plant)
    second.wait()


def test_refused_robot_leaves_plant_to_the_first() -> None:
    class Choosy(Alone):
        def begin(self, description: dict[str, Any], physics: list[dict[str, Any]]) -> Any:
            if self.is_taken:
                raise ValueError("one robot only")
            self.is_taken = True
            return super().begin(description, physics)

        is_taken = False

    plant = Choosy()
    first = Twin(CONFIG, plant)
    with pytest.raises(ValueError, match="one robot only"):
        Twin(CONFIG, plant)
    first.wait()


@pytest.mark.parametrize(
    ("begin", "part"),
    [
        (np.zeros(11), r"positions of the shape \(11,\): give one for each of fl-hip"),
        (np.zeros((1, 12)), r"positions of the shape \(1, 12\)"),
        ([0.0] * 11 + [np.nan], "begins with rr-knee at nan: give a finite position"),
    ],
)
def test_plant_begins_with_each_joint(begin: Any, part: str) -> None:
    class Elsewhere(Alone):
        def begin(self, description: dict[str, Any], physics: list[dict[str, Any]]) -> Any:
            super().begin(description, physics)
            return begin

    for kind in (Twin, Ideal):
        with pytest.raises(ValueError, match=part):
            kind(CONFIG, Elsewhere())


def test_refusal_names_joint_as_on_the_robot() -> None:
    class Straight(Alone):
        def begin(self, description: dict[str, Any], physics: list[dict[str, Any]]) -> Any:
            super().begin(description, physics)
            return np.zeros(12)

    text = r"motord refused to enable: .*\(fl-knee is at .* rad, outside -2\.[0-9]+ to -0\.[0-9]+\)"
    with Twin(CONFIG, Straight()).claim("legs") as legs, pytest.raises(motord.Refused, match=text) as refused:
        legs.enable()
    assert refused.value.reason == "outside-limits"


def test_group_that_is_not_enabled_says_so() -> None:
    with Twin(CONFIG).claim("legs") as legs, pytest.raises(motord.Stopped, match="does not follow setpoints: enable it"):
        next(iter(legs.cycles()))


def test_exception_of_plant_comes_out_of_the_twin() -> None:
    class Broken(Alone):
        def step(self, torques: Array, seconds: float, q: Array, dq: Array) -> None:
            raise RuntimeError("the physics broke")

    with pytest.raises(RuntimeError, match="the physics broke"):
        Twin(CONFIG, Broken()).wait()

    class Unstable(Alone):
        def step(self, torques: Array, seconds: float, q: Array, dq: Array) -> None:
            q[3] = np.nan

    with pytest.raises(ValueError, match="joint 3"):
        Twin(CONFIG, Unstable()).wait()


def test_speed_with_mujoco(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    model = tmp_path / "robot.xml"
    model.write_text(mjcf())
    twin, begun = Twin(CONFIG, Mujoco(model)), time.process_time()
    trot(twin, 3.0)
    print(f"{twin.time / (time.process_time() - begun):.1f} times real time")


def test_motions_keep_the_limits_of_the_robot() -> None:
    twin = Twin(CONFIG)
    with twin.claim("legs") as legs:
        legs.enable()
        refused: list[tuple[Any, float, str]] = [
            ({"fl-hip": 0.1}, 1.0, "fl-thigh"),
            (99.0, 1.0, "outside its limits"),
            (legs.wait().q + 0.05, 0.001, "give at least"),
            ([0.0, 1.0], 1.0, "12"),
        ]
        for pose, seconds, words in refused:
            with pytest.raises(ValueError, match=words):
                legs.move_to(pose, seconds)
