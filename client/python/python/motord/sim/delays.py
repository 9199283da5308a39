"""The measured delay from observation to action, for a simulator that trains policies."""

import json
import math
from typing import Any

from .._untrusted import FileError, open_regular, printable

BYTES_MAX = 16 << 20
"""Largest file of latencies."""

PERCENTILES = ("p50", "p99", "p99_9", "max")


def profile(text: str, step_ms: float) -> dict[str, Any]:
    """The delays of each group, ms, from the text of motorctl latency --json, and their lags in steps of step_ms.

    observation_age is the time from the command of a cycle to the publication of its states, within which each motor measures.
    control is the time from there to the cycle that uses the answer, command the time within which the motor has it. ValueError
    for another text, and for one without a setpoint that answered a state.
    """
    if not (math.isfinite(step_ms) and step_ms > 0.0):
        raise ValueError("the step of the simulator is a positive number of ms")
    try:
        latencies = json.loads(text)
        age, command = _ms(latencies["cycle_us"]), _ms(latencies["reply_latency_us"])
        found = [(str(group["name"]), group["control_latency_us"], list(map(int, group["cycles"]))) for group in latencies["control"]]
        groups = [_group(name, _ms(control), int(control["count"]), cycles) for name, control, cycles in found if control["count"]]
        instance = str(latencies["instance"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"give one object of motorctl latency --json ({printable(f'{type(error).__name__}: {error}')})") from error
    if not groups:
        raise ValueError("no setpoint answered a state: let the controller run, then motorctl latency --json")
    for group in groups:
        group |= {"observation_age_ms": age, "command_ms": command, "lag_steps": _lag(age, group["control_ms"], command, step_ms)}
    return {"instance": instance, "step_ms": step_ms, "groups": groups}


def _ms(percentiles: dict[str, float]) -> dict[str, float]:
    return {name: round(1e-3 * float(percentiles[name]), 6) for name in PERCENTILES}


def _group(name: str, control: dict[str, float], count: int, cycles: list[int]) -> dict[str, Any]:
    return {"name": name, "setpoints": count, "control_ms": control, "cycles": cycles}


def _lag(age: dict[str, float], control: dict[str, float], command: dict[str, float], step_ms: float) -> dict[str, int]:
    """The lag of at least half of the actions, without what may be 0, and one that at least 97 of 100 keep."""
    most = age["p99"] + control["p99"] + command["p99"]
    return {"min": math.floor(control["p50"] / step_ms), "max": math.ceil(most / step_ms)}


def read(path: str) -> str:
    """The text of a file. ValueError for one that cannot be read."""
    try:
        with open_regular(path, BYTES_MAX) as file:
            return file.read().decode()
    except (FileError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: {error}") from error
