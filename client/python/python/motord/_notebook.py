"""Notebooks: a cell that raises ends the repetition of setpoints."""

import sys
from typing import Any


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
