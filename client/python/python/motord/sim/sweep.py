"""Many runs of a controller on the twin: seeds and delays, on all cores or computers."""

import hashlib
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

from ._run import Plan
from ._workers import Row, Task, local, on_ray, processors

RESULTS = ("passed", "stopped", "fell", "failed", "crashed", "hung")
"""How a run ends. stopped: by motord, with a cause. failed: the program. crashed and hung: its process."""

COLORS = {"passed": "#2e8b57", "stopped": "#d62728", "fell": "#ff7f0e", "failed": "#9467bd", "crashed": "#333333", "hung": "#8c8c8c"}


@dataclass(frozen=True)
class Sweep:
    """The rows of a sweep, by delay and seed."""

    controller: str
    seconds: float
    """Virtual time that each run had at most, s."""
    runs: list[Row]

    @property
    def passed(self) -> int:
        """Runs that passed."""
        return sum(row["result"] == "passed" for row in self.runs)

    @property
    def hash(self) -> str:
        """The SHA-256 of the hashes of all runs."""
        text = "\n".join(f"{row['seed']} {row['delay_us']:g} {row['hash']}" for row in self.runs)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def versions(self) -> list[dict[str, str]]:
        """What the runs were made with. Where there is more than one, hashes may differ."""
        found: list[dict[str, str]] = []
        for row in self.runs:
            if row["versions"] not in found:
                found.append(row["versions"])
        return found

    def table(self) -> str:
        """A line for each run, and one for each delay."""
        head = f"{'seed':>6}{'delay µs':>10}  {'result':8}{'after s':>9}  {'worst joint':12}{'mrad RMS':>9}  {'most torque':12}{'of limit':>9}  hash"
        lines = [head, *map(_line, self.runs), ""]
        for delay_us, rows in self._by_delay():
            ends = Counter(_cause(row) for row in rows if row["result"] != "passed")
            causes = "".join(f"; {count} {cause}" for cause, count in ends.most_common())
            passed = sum(row["result"] == "passed" for row in rows)
            lines.append(f"delay {delay_us:g} µs: {passed} of {len(rows)} passed{causes}; worst joint {_worst(rows)}")
        lines.append(f"hash of all: {self.hash}")
        if len(self.versions) > 1:
            lines.append(f"The runs were made with different versions, and their hashes may differ: {self.versions}")
        return "\n".join(lines)

    def summary(self) -> dict[str, Any]:
        """The rows and their counts, for JSON."""
        counts = {result: sum(row["result"] == result for row in self.runs) for result in RESULTS}
        rows = [{key: value for key, value in row.items() if key != "versions"} for row in self.runs]
        common = {"controller": self.controller, "seconds": self.seconds, "counts": counts, "hash": self.hash}
        return {**common, "versions": self.versions, "runs": rows}

    def _by_delay(self) -> Iterator[tuple[float, list[Row]]]:
        for delay_us in sorted({row["delay_us"] for row in self.runs}):
            yield delay_us, [row for row in self.runs if row["delay_us"] == delay_us]

    def picture(self, path: str | PathLike[str]) -> None:
        """Draws for each delay the error of each run's worst joint, and how many runs ended in which way. Needs matplotlib."""
        try:
            from matplotlib.figure import Figure  # pyright: ignore[reportMissingImports, reportUnknownVariableType]
        except ImportError as error:
            raise ImportError("a picture needs the package matplotlib: pip install matplotlib") from error
        groups = list(self._by_delay())
        figure: Any = Figure(figsize=(10.0, 2.2 * len(groups) + 1.0), layout="constrained")
        axes: Any = figure.subplots(len(groups), 2, squeeze=False, sharex="col", width_ratios=(3, 2))
        for (delay_us, rows), (left, right) in zip(groups, axes, strict=True):
            _draw_runs(left, delay_us, rows)
            _draw_causes(right, rows)
        axes[-1][0].set_xlabel("seed")
        axes[-1][1].set_xlabel("runs")
        figure.suptitle(f"{self.controller}: {self.passed} of {len(self.runs)} runs passed")
        figure.savefig(path, dpi=120)


def _draw_runs(axis: Any, delay_us: float, rows: list[Row]) -> None:
    for result in RESULTS:
        chosen = [row for row in rows if row["result"] == result]
        errors = [1e3 * (row["worst_error_rad"] or 0.0) for row in chosen]
        axis.scatter([row["seed"] for row in chosen], errors, s=12, color=COLORS[result], label=result if chosen else None)
    axis.set_ylim(0.0, 1.1e3 * max((row["worst_error_rad"] or 0.0 for row in rows), default=0.0) or 1.0)
    axis.set_ylabel(f"{delay_us:g} µs\nworst joint, mrad")
    axis.legend(loc="best", fontsize="small")


def _draw_causes(axis: Any, rows: list[Row]) -> None:
    found = Counter((row["result"], _cause(row)) for row in rows).most_common()
    for at, ((result, cause), count) in enumerate(found):
        axis.barh(at, count, height=0.4, color=COLORS[result])
        axis.text(count, at, f" {count}", va="center")
        axis.text(0.0, at - 0.24, f" {cause if len(cause) <= 44 else cause[:43] + '…'}", va="bottom", fontsize="small")
    axis.set_yticks([])
    axis.set_ylim(max(len(found), 3) - 0.5, -0.7)
    axis.margins(x=0.15)


def _cause(row: Row) -> str:
    """How a run ended, in the words of the table."""
    if row["cause"] is not None:
        return f"{row['cause']} of {row['joint']}" if row["joint"] else str(row["cause"])
    return str(row["result"]) + (f": {row['reason']}" if row["reason"] else "")


def _line(row: Row) -> str:
    after = "" if row["seconds"] is None else f"{row['seconds']:.2f}"
    error = "" if row["worst_error_rad"] is None else f"{1e3 * row['worst_error_rad']:.1f}"
    share = "" if row["highest_torque_share"] is None else f"{100.0 * row['highest_torque_share']:.0f} %"
    joints = row["worst_joint"] or "", row["highest_torque_joint"] or ""
    end = "" if row["result"] == "passed" else f"  {_cause(row)}"
    return (
        f"{row['seed']:6}{row['delay_us']:10g}  {row['result']:8}{after:>9}  {joints[0]:12}{error:>9}  {joints[1]:12}{share:>9}"
        f"  {(row['hash'] or '-' * 12)[:12]}{end}"
    )


def _worst(rows: list[Row]) -> str:
    """The joint that is the worst of most runs, and its largest error."""
    counts = Counter(row["worst_joint"] for row in rows if row["worst_joint"])
    if not counts:
        return "unknown: no joint followed a position"
    joint, _ = counts.most_common(1)[0]
    errors = [row["errors_rad"].get(joint) for row in rows]
    return f"{joint}, up to {1e3 * max(error for error in errors if error is not None):.1f} mrad RMS"


def sweep(
    plan: Plan,
    seeds: Iterable[int],
    delays_us: Sequence[float] = (300.0,),
    *,
    workers: int | None = None,
    ray: bool | str = False,
    progress: Callable[[int, int, int], None] = lambda done, count, passed: None,
) -> Sweep:
    """Runs the controller of a plan once for each seed and delay, the time that it computes, µs.

    workers run at a time; the default is one for each processor. ray runs them with Ray on this computer, or on those of the
    cluster with this address. progress gets the number of ended runs, of all, and of those that passed. Equal plans and seeds
    have equal hashes. ValueError for a configuration or a model that does not fit.
    """
    shown, plan = plan.controller, plan.absolute()
    files = plan.files()
    chosen = list(seeds)
    tasks: list[Task] = [{"seed": seed, "delay_us": float(delay), "files": files} for delay in delays_us for seed in chosen]
    if not tasks:
        raise ValueError("give at least one seed and one delay")
    if any(not math.isfinite(delay) or delay < 0.0 for delay in delays_us):
        raise ValueError("a delay is a number of µs from 0 on")
    # A plan that fits no robot has one error, not one for each run.
    plan.twin(chosen[0], delays_us[0])
    rows = on_ray(plan, tasks, workers, ray if isinstance(ray, str) else None) if ray else local(plan, tasks, workers or processors())
    runs: list[Row] = []
    for row in rows:
        runs.append(row)
        progress(len(runs), len(tasks), sum(one["result"] == "passed" for one in runs))
    runs.sort(key=lambda row: (row["delay_us"], row["seed"]))
    return Sweep(shown, plan.seconds, runs)
