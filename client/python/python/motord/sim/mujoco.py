"""MuJoCo as the plant of a twin."""

import atexit
import importlib
import json
import sys
import threading
import warnings
from os import PathLike, fspath
from typing import Any

import numpy as np

from .._install import command
from .._motord import describe
from .._signals import deferred
from ._model import ModelFile, Motors
from .plant import Array

STEP_S = 250e-6
"""The step of a twin's plant."""

PICTURE_S = 1.0 / 30.0
"""From one picture of a window to the next."""

CLOSE_S = 5.0
"""Longest wait for the end of a window's thread."""


class Mujoco:
    """A MuJoCo model whose hinge joints have the names of the configuration, behind prefix.

    The armature, damping and dry friction that the motors add are written into the model in memory, where it has none. motors
    says whose values count where both have one: "model" or "configuration". Without it, ValueError names each joint whose values
    differ by more than 20 %, as it names each other contradiction. imu is the site of the IMU, x forward, z up; without one, the
    IMUs of the configuration get no samples. key is the keyframe of the beginning; without one, the joints begin as the
    configuration has them.
    """

    def __init__(
        self,
        model: str | PathLike[str],
        *,
        imu: str | None = None,
        key: str | None = None,
        prefix: str = "",
        motors: Motors | None = None,
    ) -> None:
        self._path, self._imu, self._key = fspath(model), imu, key
        self._prefix = prefix
        self._motors: Motors | None = motors
        self.model: Any = None
        self.data: Any = None

    def begin(self, description: dict[str, Any], physics: list[dict[str, Any]]) -> Array | None:
        """Loads the model, and returns where its joints begin, rad. ValueError where it contradicts the configuration."""
        mujoco = _mujoco()
        file = ModelFile(mujoco, self._path, self._prefix, self._motors)
        file.fit(description, physics)
        spec = file.spec
        if self._imu is not None:
            _add_imu(mujoco, spec, self._imu)
        spec.option.timestep = STEP_S
        # Without AUTORESET, an unstable model becomes NaN, which is reported. With it, the robot would jump to its beginning.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_ACTUATION
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._step = mujoco.mj_step
        if self._imu is not None:
            self._sensors = [_slice(self.model.sensor(f"motord-{name}")) for name in ("orientation", "gyro", "acceleration")]
        if self._key is not None:
            mujoco.mj_resetDataKeyframe(self.model, self.data, self._keyframe())
        joints = [self.model.joint(self._prefix + joint["name"]) for joint in description["joints"]]
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
        """Moves the joints by a step of the model, 0.00025 s: writes positions, rad, and velocities, rad/s, into q and dq."""
        data = self.data
        data.qfrc_applied[self._dq] = torques
        self._step(self.model, data)
        q[:] = data.qpos[self._q]
        dq[:] = data.qvel[self._dq]

    def imu(self) -> tuple[Array, Array, Array] | None:
        """Orientation, angular velocity, rad/s, and specific force, m/s², at the site of the IMU; None without a site."""
        if self._imu is None:
            return None
        orientation, gyro, acceleration = (self.data.sensordata[values].copy() for values in self._sensors)
        return orientation, gyro, acceleration


class ViewedMujoco(Mujoco):
    """Shows the model in a window while it moves, 30 times a second."""

    def begin(self, description: dict[str, Any], physics: list[dict[str, Any]]) -> Array | None:
        """Loads the model, and opens the window. ValueError without a display."""
        begin = super().begin(description, physics)
        # The package imports its viewer only on demand. Without a display, the viewer ends the process.
        viewer: Any = importlib.import_module("mujoco.viewer")
        if sys.platform != "darwin" and not _has_display(viewer.glfw):
            raise ValueError("a window needs a display: set DISPLAY, or leave out --view")
        others = set(threading.enumerate())
        self._viewer = viewer.launch_passive(self.model, self.data)
        drawing = set(threading.enumerate()) - others
        # Before the exit handler of the viewer, which ends GLFW beneath a thread that draws.
        atexit.register(_close, self._viewer, drawing)
        self._shown = 0.0
        return begin

    def step(self, torques: Array, seconds: float, q: Array, dq: Array) -> None:
        """Moves the joints, and shows them in each thirtieth of a second."""
        super().step(torques, seconds, q, dq)
        if self.data.time - self._shown >= PICTURE_S and self._viewer.is_running():
            self._shown = self.data.time
            # An exception within leaves the viewer locked.
            with deferred():
                self._viewer.sync()


def _close(viewer: Any, drawing: set[threading.Thread]) -> None:
    """Closes a window, and waits until its thread draws no more."""
    viewer.close()
    for thread in drawing:
        thread.join(CLOSE_S)


def _has_display(glfw: Any) -> bool:
    with warnings.catch_warnings():
        # The package warns about what the return value says.
        warnings.simplefilter("ignore")
        return bool(glfw.init())


def fit_mjcf(
    config: str | PathLike[str],
    model: str | PathLike[str],
    output: str | PathLike[str],
    *,
    prefix: str = "",
    motors: Motors | None = None,
) -> None:
    """Writes a copy of a model with the armature, damping and dry friction of the configuration's motors.

    prefix and motors are those of Mujoco. ValueError names each joint that contradicts the configuration.
    """
    description, physics = describe(fspath(config))
    fitted = ModelFile(_mujoco(), fspath(model), prefix, motors)
    fitted.fit(json.loads(description), physics)
    fitted.spec.compile()
    with open(output, "w", encoding="utf-8") as file:
        file.write(fitted.spec.to_xml())


def _mujoco() -> Any:
    try:
        with deferred():
            import mujoco  # pyright: ignore[reportMissingTypeStubs, reportMissingImports]
    except ImportError as error:
        raise ImportError(f"a MuJoCo model needs the package mujoco: {command('sim')}") from error
    return mujoco


def _slice(sensor: Any) -> slice:
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
