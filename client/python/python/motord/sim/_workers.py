"""Workers that run the tasks of a sweep: processes of this computer, or actors of Ray on many."""

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import asdict
from queue import Empty, SimpleQueue
from typing import Any

from .._install import command
from ._run import Plan

Task = dict[str, Any]
Row = dict[str, Any]

ENVIRONMENT = {"PYTHONHASHSEED": "0", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""A worker has one core. Sums over threads would also differ between computers with other numbers of cores."""


class Worker:
    """A process that runs tasks, one after the other."""

    def __init__(self, plan: Plan) -> None:
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            [sys.executable, "-m", "motord.sim._serve"],
            stdin=pipe,
            stdout=pipe,
            text=True,
            env={**os.environ, **ENVIRONMENT},
            # Ctrl-C of a terminal is for the sweep, which ends its workers.
            start_new_session=True,
        )
        self._write(asdict(plan))

    def _write(self, value: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(value) + "\n")
        self._process.stdin.flush()

    def run(self, task: Task) -> Row:
        """Runs a task, and returns its row. RuntimeError when the process ends without one."""
        assert self._process.stdout is not None
        try:
            self._write(task)
            line = self._process.stdout.readline()
        except OSError:
            line = ""
        if not line:
            raise RuntimeError(f"a worker ended with status {self._process.wait()}")
        row: Row = json.loads(line)
        return row

    def end(self) -> None:
        """Kills the process and its run."""
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


def local(plan: Plan, tasks: list[Task], count: int) -> Iterator[Row]:
    """Runs tasks on processes of this computer. Yields their rows as they end."""
    waiting: SimpleQueue[Task] = SimpleQueue()
    done: SimpleQueue[Row | Exception] = SimpleQueue()
    for task in tasks:
        waiting.put(task)
    workers = [Worker(plan) for _ in range(min(count, len(tasks)))]

    def serve(worker: Worker) -> None:
        try:
            while True:
                done.put(worker.run(waiting.get_nowait()))
        except Empty:
            return
        except Exception as error:
            done.put(error)

    for worker in workers:
        threading.Thread(target=serve, args=(worker,), daemon=True).start()
    try:
        for _ in tasks:
            row = done.get()
            if isinstance(row, Exception):
                raise row
            yield row
    finally:
        for worker in workers:
            worker.end()


def on_ray(plan: Plan, tasks: list[Task], count: int | None, address: str | None) -> Iterator[Row]:
    """Runs tasks on actors of Ray, one for each processor of its computers. Yields their rows as they end."""
    try:
        import ray as imported  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ImportError(f"a sweep with Ray needs the package ray: {command('sweep')}") from error
    ray: Any = imported
    # Nothing is reported to others, and no port is open to them.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    alone = {"_node_ip_address": "127.0.0.1", "include_dashboard": False, "num_cpus": count or processors()}
    try:
        ray.init(address=address, log_to_driver=False, logging_level="ERROR", **({} if address else alone))
    except Exception as error:  # Ray raises many kinds, also Exception itself.
        raise RuntimeError(f"Ray does not start: {error}") from error
    try:
        most = count or int(ray.cluster_resources().get("CPU", 1))
        yield from _on_actors(ray, plan, tasks, min(most, len(tasks)))
    finally:
        ray.shutdown()


def _on_actors(ray: Any, plan: Plan, tasks: list[Task], count: int) -> Iterator[Row]:
    kind = ray.remote(num_cpus=1)(Worker)
    waiting = list(reversed(tasks))
    # By the reference of a row: its actor and its task.
    running: dict[Any, tuple[Any, Task]] = {}

    def begin(actor: Any) -> None:
        if waiting:
            task = waiting.pop()
            running[actor.run.remote(task)] = (actor, task)

    for _ in range(count):
        begin(kind.remote(plan))
    while running:
        (reference, *_), _ = ray.wait(list(running), num_returns=1)
        actor, task = running.pop(reference)
        try:
            yield ray.get(reference)
        except ray.exceptions.RayActorError:
            # Its computer is lost: another actor runs the task again, with the same result.
            waiting.append(task)
            actor = kind.remote(plan)
        begin(actor)


def processors() -> int:
    """The processors that this process may use."""
    return len(os.sched_getaffinity(0))
