"""python -m motord.sim._serve: runs a controller in a process of its own, as often as its input demands.

The first line of its input is a plan in JSON, each further one a seed, a delay and the hashes of the plan's files. It prints a
line of JSON for each run. It forks for each run: no run changes the interpreter of another, and one that crashes or hangs ends
alone.
"""

import json
import os
import platform
import select
import signal
import sys
import tempfile
import time
import traceback
from typing import Any

from .._untrusted import printable
from ._run import Plan, run, versions

OUTPUT_MAX = 64 << 10
"""Bytes of a program's output that are read for its last line."""


def _without_row(result: str, reason: str) -> dict[str, Any]:
    """The row of a run of which nothing else is known."""
    keys = ("cause", "joint", "seconds", "worst_joint", "worst_error_rad", "highest_torque_joint", "highest_torque_share", "hash")
    return {"result": result, "reason": printable(reason), **dict.fromkeys(keys), "errors_rad": {}}


def _child(plan: Plan, task: dict[str, Any], output: int, rows: int) -> None:
    """Runs a task in the child of a fork, which ends here."""
    status = 1
    try:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        os.dup2(output, 1)
        os.dup2(output, 2)
        row = run(plan, int(task["seed"]), float(task["delay_us"]))
        os.write(rows, json.dumps(row).encode())
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        # Not sys.exit: the controller may have left threads and exit handlers.
        os._exit(status)


class _Forked:
    """The child of a run, and the pipe of its row."""

    def __init__(self, plan: Plan, task: dict[str, Any], output: int) -> None:
        self._rows, written = os.pipe()
        self.process = os.fork()
        if self.process == 0:
            os.close(self._rows)
            _child(plan, task, output, written)
        os.close(written)

    def received(self, timeout: float) -> bytes | None:
        """What the child wrote until it ended; None where it did not end in time, and was killed."""
        end, parts = time.monotonic() + timeout, list[bytes]()
        try:
            while select.select([self._rows], [], [], max(end - time.monotonic(), 0.0))[0]:
                part = os.read(self._rows, 1 << 16)
                if not part:
                    return b"".join(parts)
                parts.append(part)
            os.kill(self.process, signal.SIGKILL)
            return None
        finally:
            os.close(self._rows)


def _last_line(output: Any) -> str:
    size = output.seek(0, os.SEEK_END)
    output.seek(max(size - OUTPUT_MAX, 0))
    written = [line for line in output.read().decode(errors="replace").splitlines() if line.strip()]
    return f": {written[-1].strip()}" if written else ""


def _performed(plan: Plan, task: dict[str, Any]) -> dict[str, Any]:
    """Runs a task in a child, and returns its row, whatever becomes of the child."""
    try:
        differing = [path for path, known in plan.files().items() if task["files"].get(path) != known]
    except ValueError as error:
        return _without_row("failed", f"{platform.node()}: {error}")
    if differing:
        return _without_row("failed", f"{', '.join(differing)} differs on {platform.node()}: copy the files to each computer")
    with tempfile.TemporaryFile() as output:
        child = _Forked(plan, task, output.fileno())
        received = child.received(plan.timeout)
        _, status = os.waitpid(child.process, 0)
        if received is None:
            return _without_row("hung", f"no end within {plan.timeout:g} s")
        try:
            row: dict[str, Any] = json.loads(received)
        except ValueError:
            code = os.waitstatus_to_exitcode(status)
            ended = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"
            return _without_row("crashed", ended + _last_line(output))
    return row


def main() -> int:
    """Serves runs until its input ends."""
    plan = Plan(**json.loads(sys.stdin.readline()))
    if plan.model is not None:
        import mujoco as _  # pyright: ignore[reportMissingTypeStubs, reportMissingImports, reportUnknownVariableType]  # before each fork
    for line in sys.stdin:
        task = json.loads(line)
        row = _performed(plan, task)
        made = {"seed": task["seed"], "delay_us": task["delay_us"], **row, "versions": versions()}
        print(json.dumps(made), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
