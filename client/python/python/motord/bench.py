"""Measures a controller in Python beside the same loop in Rust, in one run against a running daemon.

    python -m motord.bench --instance demo --group legs --hz 500 --seconds 30

Holds the group where it is, first from Python, then from the compiled loop of this package. Columns: the time from the
publication of a state until the loop has it (wake-up), the time of a call of send, and the share of setpoints that the
cycle after their state did not use (late).
"""

import argparse
import json
import sys
import time
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

import motord

from ._motord import measure as _rust

_KP, _KD = 40.0, 1.0
_SHARES = (50.0, 99.0, 99.9)


class Row(TypedDict):
    """The result of a loop. Times are in µs, by percentile."""

    loop: str
    hz: float
    cycles: int
    used: int
    late: int
    late_percent: float
    wake_us: dict[str, float]
    send_us: dict[str, float]


_Times = tuple[NDArray[np.float64], NDArray[np.float64], int, int]


def _python(legs: motord.Claim, hz: float, seconds: float) -> _Times:
    wake: list[float] = []
    send: list[float] = []
    used = late = in_use = 0
    goal = legs.wait().q
    end = time.monotonic() + seconds
    for state in legs.cycles(hz=hz):
        woken = state.age
        before = time.perf_counter()
        legs.send(q=goal, kp=_KP, kd=_KD)
        send.append(time.perf_counter() - before)
        wake.append(woken)
        cycles, sequence = state.control_cycles, state.sequence
        if sequence != in_use and cycles is not None:
            used, late = used + 1, late + (cycles > 1)
        in_use = sequence
        if time.monotonic() > end:
            break
    return np.array(wake), np.array(send), used, late


def _row(loop: str, hz: float, times: _Times) -> Row:
    wake, send, used, late = times

    def percentiles(values: NDArray[np.float64]) -> dict[str, float]:
        if not values.size:
            return {f"p{share:g}": float("nan") for share in _SHARES}
        return {f"p{share:g}": round(float(np.percentile(values, share)) * 1e6, 1) for share in _SHARES}

    late_percent = round(100.0 * late / used, 2) if used else float("nan")
    return Row(
        loop=loop,
        hz=hz,
        cycles=len(wake),
        used=used,
        late=late,
        late_percent=late_percent,
        wake_us=percentiles(wake),
        send_us=percentiles(send),
    )


def measure(robot: motord.Robot, group: str, hz: float, seconds: float) -> list[Row]:
    """Runs both loops, each for this time, and returns their rows."""
    every = round(robot.rate_hz / hz)
    with robot.claim(group) as legs:
        legs.cycles(hz=hz)
        legs.enable(hold=(_KP, _KD))
        python = _row("Python", hz, _python(legs, hz, seconds))
        rust = _row("Rust", hz, _rust(legs, every, seconds))
    return [python, rust]


def _print(rows: list[Row]) -> None:
    print(f"{'':8}{'':>7}{'':>9}{'late':>7}   {'wake-up µs':^26}   {'send µs':^26}")
    shares = "".join(f"{f'p{share:g}':>9}" for share in _SHARES)
    print(f"{'loop':8}{'hz':>7}{'cycles':>9}{'%':>7}{shares}  {shares}")
    for row in rows:
        times = ["".join(f"{value:9.1f}" for value in row[key].values()) for key in ("wake_us", "send_us")]
        print(f"{row['loop']:8}{row['hz']:7g}{row['cycles']:9}{row['late_percent']:7.2f}{times[0]}  {times[1]}")


def main(arguments: list[str] | None = None) -> int:
    """Measures by the arguments of the command line."""
    parser = argparse.ArgumentParser(prog="python -m motord.bench", description="Measures a controller in Python beside Rust.")
    parser.add_argument("--instance", default="demo")
    parser.add_argument("--group", default="legs")
    parser.add_argument("--hz", type=float, action="append", help="rate of the loop; may be repeated; 500")
    parser.add_argument("--seconds", type=float, default=30.0, help="length of each loop")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    options = parser.parse_args(arguments)
    robot = motord.connect(options.instance)
    rows: list[Row] = []
    for hz in options.hz or [500.0]:
        rows += measure(robot, options.group, hz, options.seconds)
    if options.json:
        for row in rows:
            print(json.dumps(row))
    else:
        _print(rows)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (motord.Error, ValueError) as error:
        sys.exit(f"motord.bench: {error}")
