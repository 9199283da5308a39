"""Notebooks: tables of states and recordings, and a cell that raises ends the repetition of setpoints.

Names and texts of robots and files are escaped.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._untrusted import printable

if TYPE_CHECKING:
    from ._motord import State
    from .recording import Recording

ROWS_MAX = 64
"""Rows of a table. Robots have no more joints."""


def state(state: State) -> str:
    """The table of a state."""
    phase = f", {state.phase}" if state.phase else ""
    stop = f", stopped by {state.stop}" if state.stop else ""
    caption = f"cycle {state.cycle}{phase}{stop}"
    values = zip(state.joints, state.q, state.dq, state.tau, state.temperature, state.mode, state.faults, strict=True)
    rows = [
        (name, _number(q, ".3f"), _number(dq, ".2f"), _number(tau, ".2f"), _number(heat, ".0f"), mode, ", ".join(faults))
        for name, q, dq, tau, heat, mode, faults in values
    ]
    return _table(caption, ("joint", "q, rad", "dq, rad/s", "tau, N·m", "°C", "mode", "faults"), rows)


def recording(recording: Recording) -> str:
    """The table of a recording: its joints and stops."""
    seconds = recording.time[-1] if len(recording) else 0.0
    caption = f"{recording.path}: {len(recording)} cycles, {seconds:.3f} s"
    columns = enumerate(recording.joints)
    rows = [(name, _range(recording.q[:, at], ".3f"), _range(recording.tau[:, at], ".2f")) for at, name in columns]
    joints = _table(caption, ("joint", "q, rad", "tau, N·m"), rows)
    stops = [(f"{stop.time:.3f}", stop.group, stop.cause, stop.joint or "") for stop in recording.stops]
    return joints + (_table("stops", ("s", "group", "cause", "joint"), stops) if stops else "")


def _number(value: float, form: str) -> str:
    return f"{value:{form}}" if np.isfinite(value) else ""


def _range(values: NDArray[np.float64], form: str) -> str:
    known = values[np.isfinite(values)]
    return f"{known.min():{form}} to {known.max():{form}}" if known.size else ""


def _table(caption: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    shown = [header, *rows[:ROWS_MAX]]
    left = [(f"{len(rows) - ROWS_MAX} more",)] if len(rows) > ROWS_MAX else []
    lines = [_row("th" if row is header else "td", row) for row in [*shown, *left]]
    return f"<table><caption>{_text(caption)}</caption>{''.join(lines)}</table>"


def _row(tag: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<{tag}>{_text(cell)}</{tag}>" for cell in cells) + "</tr>"


def _text(text: str) -> str:
    return escape(printable(text))


def end_with_exception(keep: Any) -> None:
    """Ends keep when a cell raises, also one that was interrupted. Does nothing outside of IPython."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    if shell is None:
        return

    def ended(result: Any) -> None:
        error = result.error_before_exec or result.error_in_exec
        if error is not None and keep.end is None:
            keep._fail(f"a cell raised {type(error).__name__}")
        if keep.end is not None:
            shell.events.unregister("post_run_cell", ended)

    shell.events.register("post_run_cell", ended)
