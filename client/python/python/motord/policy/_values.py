"""Values of the joints of a policy, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import ArrayLike, NDArray

# Without its types, which do not know these values.
_numpy: Any = np

_ENTRYWISE: frozenset[Callable[..., Any]] = frozenset(
    getattr(_numpy, name)
    for name in "clip where select round around copy nan_to_num isclose zeros_like ones_like full_like".split()
)
"""Functions, other than ufuncs, whose result has the value of a joint where their arguments have it."""


class JointValues(NDArrayOperatorsMixin, Mapping[str, float]):
    """A number for each joint, by name: a claim takes each for its joint, whatever the order of the claim.

    numpy computes with them entry by entry, and the result has the names of the first such operand. A second one, or another
    mapping, is taken by name. An array without names must have the order of the first. Other joints are a ValueError, results
    whose entries are not those of the joints a TypeError. `np.asarray` returns an array without names. Values never change.
    """

    def __init__(self, names: Sequence[str], values: ArrayLike) -> None:
        """Names an array, such as `JointValues(state.joints, state.q)`."""
        self._array: NDArray[Any] = np.array(values)
        self._values: dict[str, float] = dict(zip(names, self._array.tolist(), strict=True))
        if len(self._values) != len(names):
            raise ValueError(f"a joint is named twice: {', '.join(names)}")

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __bool__(self) -> bool:
        if self._array.dtype == np.bool_:
            raise ValueError("each joint has a truth value of its own: use np.all or np.any")
        return bool(self._values)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self._array, dtype=dtype)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **others: Any) -> Any:
        is_entrywise = method == "__call__" and ufunc.signature is None
        result = self._call(getattr(ufunc, method), inputs, others)
        if ufunc.nout > 1:
            return tuple(self._named(ufunc, each, is_entrywise) for each in result)
        return self._named(ufunc, result, is_entrywise)

    def __array_function__(self, function: Any, types: Any, inputs: Sequence[Any], others: Mapping[str, Any]) -> Any:
        return self._named(function, self._call(function, inputs, others), function in _ENTRYWISE)

    def _call(self, function: Callable[..., Any], inputs: Sequence[Any], others: Mapping[str, Any]) -> Any:
        if others.get("out") is not None:
            raise TypeError("values of joints never change, and out= has no names: write a = a + b, not a += b")
        return function(*map(self._plain, inputs), **{key: self._plain(value) for key, value in others.items()})

    def _plain(self, value: Any) -> Any:
        """Returns an argument with each mapping in it as an array in the order of these joints."""
        if hasattr(value, "keys"):
            return self._in_order(value)
        if isinstance(value, (list, tuple)):
            plain = [self._plain(each) for each in cast("Sequence[Any]", value)]
            return tuple(plain) if isinstance(value, tuple) else plain
        return value

    def _in_order(self, values: Mapping[str, float]) -> NDArray[Any]:
        if isinstance(values, JointValues) and list(values) == list(self):
            return values._array
        others = self._values.keys() ^ set(values.keys())
        if others:
            raise ValueError(f"the operands have different joints: only one has {', '.join(sorted(map(str, others)))}")
        return np.array([values[name] for name in self])

    def _named(self, function: Any, result: Any, is_entrywise: bool) -> Any:
        """Names a result. One number for all joints has no name."""
        shape = getattr(result, "shape", None)
        if shape == () or isinstance(result, (int, float)) or function is _numpy.shape:
            return result
        if is_entrywise and shape == (len(self),):
            return JointValues(list(self), result)
        raise TypeError(f"the entries of this {function.__name__} are not those of the joints: give it np.asarray(values)")

    def clip(self, min: Any = None, max: Any = None) -> JointValues:
        """Limits each value. The limits are numbers, or values by name."""
        limited: JointValues = _numpy.clip(self, min, max)
        return limited

    def copy(self) -> JointValues:
        """Returns equal values."""
        return JointValues(list(self), self._array)

    def astype(self, dtype: Any) -> JointValues:
        """Returns the values in another type of numpy."""
        return JointValues(list(self), self._array.astype(dtype))

    def __repr__(self) -> str:
        return f"JointValues({self._values!r})"
