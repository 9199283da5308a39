"""One run of a controller on a twin."""

import hashlib
import platform
import random
import runpy
import sys
import traceback
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

import motord

from .._untrusted import printable
from ._watched import Fell, Over, WatchedTwin
from .mujoco import Mujoco


@dataclass(frozen=True)
class Plan:
    """A controller and the twin that it runs on.

    The controller is a program that calls motord.connect; arguments are those of its command line. faults are those of Twin.at:
    a time, s, a target and a verb. A run passes when the program ends without an error or seconds of virtual time are over, and no
    group is stopped. With fallen_below, m, a run fails in which the first body of the model is lower while a group is active.
    A program that needs more than timeout, s of the wall clock, hangs.
    """

    controller: str
    config: str = "robot.toml"
    model: str | None = None
    imu: str | None = None
    key: str | None = None
    prefix: str = ""
    motors: Any = None
    arguments: list[str] = field(default_factory=list[str])
    faults: list[tuple[float, str, str]] = field(default_factory=list[tuple[float, str, str]])
    seconds: float = 30.0
    fallen_below: float | None = None
    timeout: float = 600.0

    def absolute(self) -> "Plan":
        """The plan with absolute paths, for workers in other folders."""
        model = None if self.model is None else str(Path(self.model).absolute())
        return replace(self, controller=str(Path(self.controller).absolute()), config=str(Path(self.config).absolute()), model=model)

    def twin(self, seed: int, delay_us: float) -> WatchedTwin:
        """The twin of a run. ValueError for a configuration or a model that does not fit."""
        plant = None
        if self.model is not None:
            plant = Mujoco(self.model, imu=self.imu, key=self.key, prefix=self.prefix, motors=self.motors)
        twin = WatchedTwin(
            self.config, plant, compute_us=delay_us, seed=seed, seconds=self.seconds, fallen_below=self.fallen_below
        )
        for at, target, verb in self.faults:
            twin.at(at, target, verb)
        return twin

    def files(self) -> dict[str, str]:
        """The SHA-256 of each file of the plan. ValueError for one that cannot be read."""
        paths = [path for path in (self.controller, self.config, self.model) if path is not None]
        try:
            return {path: hashlib.sha256(Path(path).read_bytes()).hexdigest() for path in paths}
        except OSError as error:
            raise ValueError(f"{error.filename}: {error.strerror}") from error


def versions() -> dict[str, str]:
    """What a hash depends on besides the plan and the seed: the versions, the kind of processor, and the library of C."""
    found = {"python": platform.python_version(), "machine": platform.machine(), "libc": "-".join(platform.libc_ver())}
    for package in ("motord", "numpy", "mujoco"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def run(plan: Plan, seed: int, delay_us: float) -> dict[str, Any]:
    """Runs the controller in this process, as __main__. Returns its row."""
    twin = plan.twin(seed, delay_us)
    connected: list[str] = []

    def connect(instance: str = "robot", **_: Any) -> WatchedTwin:
        connected.append(instance)
        return twin

    def estop(instance: str = "robot", **_: Any) -> None:
        twin.estop()

    motord.connect = connect  # type: ignore[assignment]
    motord.estop = estop
    # A controller that draws from the generators of the process repeats itself as the twin does.
    random.seed(seed)
    np.random.seed(seed % (1 << 32))
    sys.argv = [plan.controller, *plan.arguments]
    sys.path.insert(0, str(Path(plan.controller).absolute().parent))
    result, reason = _outcome(plan.controller)
    if result == "passed" and not connected:
        result, reason = "failed", "the program never called motord.connect"
    latched = twin.latched()
    cause, joint = latched or (None, None)
    if latched and result in ("passed", "failed"):
        result, reason = "stopped", reason or None
    return _row(twin, (result, cause, joint, reason))


def _outcome(controller: str) -> tuple[str, str | None]:
    """Runs the program. Returns how it ended, and why."""
    try:
        runpy.run_path(controller, run_name="__main__")
    except Fell:
        return "fell", None
    except Over:
        return "passed", None
    except SystemExit as ended:
        if ended.code in (None, 0):
            return "passed", None
        return "failed", str(ended.code) if isinstance(ended.code, str) else f"exit status {ended.code}"
    except BaseException as error:  # A controller may raise anything.
        traceback.print_exc()
        return "failed", f"{type(error).__name__}: {error}"
    return "passed", None


def _row(twin: WatchedTwin, end: tuple[str, str | None, str | None, str | None]) -> dict[str, Any]:
    result, cause, joint, reason = end
    watch = twin.watch
    errors = dict(zip(watch.names, watch.errors().tolist(), strict=True))
    known = {name: error for name, error in errors.items() if error == error}
    worst = max(known, key=known.__getitem__) if known else None
    share = int(np.argmax(watch.torque_share))
    return {
        "result": result,
        "cause": cause,
        "joint": joint,
        "reason": None if reason is None else printable(reason),
        "seconds": twin.time,
        "worst_joint": worst,
        "worst_error_rad": known[worst] if worst else None,
        "highest_torque_joint": watch.names[share],
        "highest_torque_share": float(watch.torque_share[share]),
        "errors_rad": {name: known.get(name) for name in watch.names},
        "hash": watch.hash("\0".join(str(part) for part in (result, cause, joint))),
    }
