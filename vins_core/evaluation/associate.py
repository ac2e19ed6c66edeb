"""Which pose belongs to which: nearest stamps."""

from __future__ import annotations

import numpy as np


def associate(a_t_ns: np.ndarray, b_t_ns: np.ndarray, max_dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows (i, j) of two increasing stamp lists that belong together, as evo pairs them.

    Every stamp of the shorter list (of b when equally long) takes the nearest of the longer one, the earlier when two
    are equally near, unless it is more than `max_dt_s` away.  A pose of the longer list may be taken twice.
    """
    if len(b_t_ns) > len(a_t_ns):
        short, long = nearest(a_t_ns, b_t_ns, max_dt_s)
        return short, long
    short, long = nearest(b_t_ns, a_t_ns, max_dt_s)
    return long, short


def nearest(query_ns: np.ndarray, among_ns: np.ndarray, max_dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows of `query_ns` that have a stamp within `max_dt_s` in the increasing `among_ns`, and that stamp's rows."""
    if len(query_ns) == 0 or len(among_ns) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    after = np.searchsorted(among_ns, query_ns).clip(0, len(among_ns) - 1)
    before = (after - 1).clip(0)
    best = np.where(np.abs(among_ns[before] - query_ns) <= np.abs(among_ns[after] - query_ns), before, after)
    near = np.abs(among_ns[best] - query_ns) * 1e-9 <= max_dt_s
    return np.flatnonzero(near), best[near]
