"""Values of the joints of a policy, by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray


class JointValues(NDArrayOperatorsMixin, Mapping[str, float]):
    """A number for each joint, by name: a claim takes each for its joint, whatever the order of the claim.

    numpy takes the values as an array in the order of the names, and computes with them. The result is such an array.
    """

    def __init__(self, names: Sequence[str], values: NDArray[np.float64]) -> None:
        self._values: dict[str, float] = dict(zip(names, values.tolist(), strict=True))

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(list(self._values.values()), dtype=dtype)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **others: Any) -> Any:
        arrays = [np.asarray(value) if isinstance(value, JointValues) else value for value in inputs]
        return getattr(ufunc, method)(*arrays, **others)

    def __repr__(self) -> str:
        return f"JointValues({self._values!r})"
