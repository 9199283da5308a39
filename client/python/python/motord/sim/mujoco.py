"""MuJoCo as the plant of a twin."""

import importlib
import json
import sys
import warnings
from os import PathLike, fspath
from typing import Any

import numpy as np

from .._motord import describe
from .plant import Array

STEP_S = 250e-6
"""The step of a twin's plant."""

PICTURE_S = 1.0 / 30.0
"""From one picture of a window to the next."""

DIFFERENCE = 0.2
"""Largest relative difference of a value in the model from that of the motors."""

TOLERANCE = 1e-3
"""Of limits, rad."""

_INSTALL = "a MuJoCo model needs the package mujoco: pip install 'motord[sim]'"


class Mujoco:
    """A MuJoCo model whose hinge joints have the names of the configuration.

    The armature, damping and dry friction that the motors add are written into the model in memory, where it has none.
    ValueError names each joint whose model contradicts the configuration. imu is the site of the IMU, x forward, z up;
    without one, the IMUs of the configuration get no samples. key is the keyframe of the beginning; without one, the joints begin
    as the configuration has them.
    """

    def __init__(self, model: str | PathLike[str], *, imu: str | None = None, key: str | None = None) -> None:
        self._path, self._imu, self._key = fspath(model), imu, key
        self.model: Any = None
        self.data: Any = None

    def begin(self, description: dict[str, Any], physics: list[dict[str, Any]]) -> Array | None:
        mujoco = _mujoco()
        spec = mujoco.MjSpec.from_file(self._path)
        _fit(mujoco, spec, self._path, description, physics)
        if self._imu is not None:
            _add_imu(mujoco, spec, self._imu)
        spec.option.timestep = STEP_S
        # Without AUTORESET, an unstable model becomes NaN, which is reported. With it, the robot would jump to its beginning.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_ACTUATION
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._step = mujoco.mj_step
        if self._imu is not None:
            self._sensors = [_place(self.model.sensor(f"motord-{name}")) for name in ("orientation", "gyro", "acceleration")]
        if self._key is not None:
            mujoco.mj_resetDataKeyframe(self.model, self.data, self._keyframe())
        joints = [self.model.joint(joint["name"]) for joint in description["joints"]]
        self._q = np.array([joint.qposadr[0] for joint in joints])
        self._dq = np.array([joint.dofadr[0] for joint in joints])
        if self._key is None:
            self.data.qpos[self._q] = [motor["begin"] for motor in physics]
        mujoco.mj_forward(self.model, self.data)
        return np.array(self.data.qpos[self._q])

    def _keyframe(self) -> int:
        known = [self.model.key(index).name for index in range(self.model.nkey)]
        if self._key not in known:
            raise ValueError(f"the model has no keyframe {self._key!r}; it has {', '.join(filter(None, known)) or 'none'}")
        return known.index(self._key)

    def step(self, torques: Array, seconds: float, q: Array, dq: Array) -> None:
        data = self.data
        data.qfrc_applied[self._dq] = torques
        self._step(self.model, data)
        q[:] = data.qpos[self._q]
        dq[:] = data.qvel[self._dq]

    def imu(self) -> tuple[Array, Array, Array] | None:
        if self._imu is None:
            return None
        orientation, gyro, acceleration = (self.data.sensordata[place].copy() for place in self._sensors)
        return orientation, gyro, acceleration


class ViewedMujoco(Mujoco):
    """Shows the model in a window while it moves, 30 times a second."""

    def begin(self, description: dict[str, Any], physics: list[dict[str, Any]]) -> Array | None:
        begin = super().begin(description, physics)
        # The package imports its viewer only on demand. Without a display, the viewer ends the process.
        viewer: Any = importlib.import_module("mujoco.viewer")
        if sys.platform != "darwin" and not _has_display(viewer.glfw):
            raise ValueError("a window needs a display: set DISPLAY, or leave out --view")
        self._viewer = viewer.launch_passive(self.model, self.data)
        self._shown = 0.0
        return begin

    def step(self, torques: Array, seconds: float, q: Array, dq: Array) -> None:
        super().step(torques, seconds, q, dq)
        if self.data.time - self._shown >= PICTURE_S and self._viewer.is_running():
            self._shown = self.data.time
            self._viewer.sync()


def _has_display(glfw: Any) -> bool:
    with warnings.catch_warnings():
        # The package warns about what the return value says.
        warnings.simplefilter("ignore")
        return bool(glfw.init())


def fit_mjcf(config: str | PathLike[str], model: str | PathLike[str], output: str | PathLike[str]) -> None:
    """Writes a copy of a model with the armature, damping and dry friction of the configuration's motors.

    ValueError names each joint that contradicts the configuration.
    """
    description, physics = describe(fspath(config))
    mujoco = _mujoco()
    spec = mujoco.MjSpec.from_file(fspath(model))
    _fit(mujoco, spec, fspath(model), json.loads(description), physics)
    spec.compile()
    with open(output, "w", encoding="utf-8") as file:
        file.write(spec.to_xml())


def _mujoco() -> Any:
    try:
        import mujoco  # pyright: ignore[reportMissingTypeStubs, reportMissingImports]
    except ImportError as error:
        raise ImportError(_INSTALL) from error
    return mujoco


def _fit(mujoco: Any, spec: Any, path: str, description: dict[str, Any], physics: list[dict[str, Any]]) -> None:
    """Writes what the motors add into the model, or says what contradicts."""
    # The compiled model has angles in rad, whatever its text has.
    compiled = spec.copy().compile()
    found = {joint.name: joint for joint in spec.joints}
    problems: list[str] = []
    for joint, motor in zip(description["joints"], physics, strict=True):
        name = joint["name"]
        if name not in found:
            hinges = ", ".join(sorted(other for other in found if other)) or "none"
            problems.append(f"{name}: the model has no joint of this name; it has {hinges}")
            continue
        problems += _of_joint(mujoco, found[name], joint, motor)
        problems += _range(name, compiled.joint(name), joint)
    if problems:
        raise ValueError(f"{path} does not fit the configuration:\n  " + "\n  ".join(problems))


def _of_joint(mujoco: Any, model: Any, joint: dict[str, Any], motor: dict[str, Any]) -> list[str]:
    name: str = joint["name"]
    problems: list[str] = []
    if model.type != mujoco.mjtJoint.mjJNT_HINGE:
        return [f"{name}: it is no hinge in the model"]
    for key, ours in (("armature", motor["armature"]), ("damping", motor["damping"]), ("frictionloss", motor["friction"])):
        theirs = float(np.ravel(getattr(model, key))[0])
        if theirs == 0.0:
            _set(model, key, ours)
        elif abs(theirs - ours) > DIFFERENCE * ours:
            problems.append(f"{name}: {key} is {theirs:g} in the model and {ours:g} by its motor; remove it from the model")
    return problems


def _range(name: str, compiled: Any, joint: dict[str, Any]) -> list[str]:
    """The limits of the configuration must be within the range of the model."""
    low, high = (float(end) for end in compiled.range)
    lower, upper = joint["position"]
    if (low, high) == (0.0, 0.0) or (low - TOLERANCE <= lower and upper <= high + TOLERANCE):
        return []
    text = f"{name}: its limits are {lower:g} to {upper:g} rad"
    if -high - TOLERANCE <= lower and upper <= -low + TOLERANCE:
        return [f"{text}, and the model has {low:g} to {high:g}: its axis is reversed"]
    return [f"{text}, beyond {low:g} to {high:g} of the model"]


def _set(model: Any, key: str, value: float) -> None:
    now = getattr(model, key)
    if np.ndim(now) == 0:
        setattr(model, key, value)
    else:
        changed = np.array(now, dtype=float)
        changed[0] = value
        setattr(model, key, changed)


def _place(sensor: Any) -> slice:
    begin, count = int(sensor.adr[0]), int(sensor.dim[0])
    return slice(begin, begin + count)


def _add_imu(mujoco: Any, spec: Any, site: str) -> None:
    if site not in [known.name for known in spec.sites]:
        known = ", ".join(known.name for known in spec.sites) or "none"
        raise ValueError(f"the model has no site {site!r} for the IMU; it has {known}")
    kinds = {
        "orientation": mujoco.mjtSensor.mjSENS_FRAMEQUAT,
        "gyro": mujoco.mjtSensor.mjSENS_GYRO,
        "acceleration": mujoco.mjtSensor.mjSENS_ACCELEROMETER,
    }
    for name, kind in kinds.items():
        spec.add_sensor(name=f"motord-{name}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)
