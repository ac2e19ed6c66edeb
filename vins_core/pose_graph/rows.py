"""Columns that only grow, shared by every state that has seen their beginning.

A state holds `(rows, n)`.  Appending to the newest state writes in place; appending to an earlier one, as a fork does,
copies its first n rows and goes on by itself.  What a state sees never changes.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

_LOCK = threading.Lock()
_FIRST_CAPACITY = 64

Spec = tuple[str, type | str, tuple[int, ...]]


class Rows:
    """`Rows(("t_ns", np.int64, ()), ("T", float, (7,)))`: named columns with the shape of one entry."""

    def __init__(self, *columns: Spec):
        self._specs = columns
        self._columns = {name: np.empty((_FIRST_CAPACITY, *shape), dtype) for name, dtype, shape in columns}
        self._size = 0

    def column(self, name: str, n: int) -> np.ndarray:
        """The first n entries, read-only, (n, ...)."""
        view = self._columns[name][:n]
        view.setflags(write=False)
        return view

    def append(self, n: int, **entries: Any) -> Rows:
        """One row after the first n; returns the rows that hold it, these ones unless row n is taken."""
        return self.extend(n, **{name: np.asarray(value)[None] for name, value in entries.items()})

    def extend(self, n: int, **entries: np.ndarray) -> Rows:
        """Several rows after the first n."""
        if entries.keys() != self._columns.keys():
            raise TypeError(f"rows have the columns {', '.join(self._columns)}, not {', '.join(entries)}")
        count = len(next(iter(entries.values())))
        with _LOCK:
            rows = self if n == self._size else self._copy(n)
            rows._reserve(n + count)
            for name, values in entries.items():
                rows._columns[name][n : n + count] = values
            rows._size = n + count
        return rows

    def _copy(self, n: int) -> Rows:
        rows = Rows(*self._specs)
        rows._reserve(n)
        for name, column in self._columns.items():
            rows._columns[name][:n] = column[:n]
        rows._size = n
        return rows

    def _reserve(self, n: int) -> None:
        for name, column in self._columns.items():
            if n > len(column):
                grown = np.empty((max(n, 2 * len(column)), *column.shape[1:]), column.dtype)
                grown[: self._size] = column[: self._size]
                self._columns[name] = grown
