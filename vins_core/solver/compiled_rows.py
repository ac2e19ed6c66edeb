"""The rows of projections by compiled code: its C source, its call, and the check that it gives NumPy's bits."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..factors.c_source import c_function
from ..factors.factor import Factor
from ..factors.reprojection import KINDS, TIMED, Kind, measurement, motion
from ..factors.robust import Loss
from ..geometry import so3
from .problem import Projections, States
from .visual_rows import NumpyRows, RowIndex, Rows, active_blocks, has_td, numbers_of_blocks

_LOSSES = ("none", "cauchy", "huber")
_INT, _POINTER = ctypes.c_int64, ctypes.c_void_p


class Arguments(ctypes.Structure):
    """`struct arguments` of kernel.c."""

    _fields_ = (
        ("n", _INT),
        ("width", _INT),
        ("loss", _INT),
        ("curved", _INT),
        ("scale", ctypes.c_double),
        *((name, _POINTER) for name in ("anchor", "observer", "landmark", "start", "place", "row", "data")),
        *((name, _POINTER) for name in ("poses", "extrinsics", "td_s", "inv_depths")),
        *((name, _POINTER) for name in ("residuals", "squared", "packed", "W", "h", "g_l")),
    )


@lru_cache(maxsize=1)
def source() -> str:
    """The whole translation unit: kernel.c and one entry for each residual, extrinsics and td held and free."""
    parts = [Path(__file__).with_name("kernel.c").read_text()]
    for factor, blocks in _entries():
        name, (poses, all_blocks) = _entry(factor, blocks), numbers_of_blocks(factor)
        parts.append(c_function(factor.function(active_blocks(factor, blocks)), name))
        sizes = poses, all_blocks - poses, has_td(factor), factor.n_data, blocks
        parts.append(f"PROJECT({name}, {', '.join(map(str, sizes))})")
    return "\n".join(parts) + "\n"


def _entries() -> list[tuple[Factor, int]]:
    """Every residual with every number of poses and extrinsics that are differentiated."""
    factors = (f for kinds in (KINDS, TIMED) for forms in kinds.values() for f in forms.values())
    return [(f, n) for f in factors for n in numbers_of_blocks(f)]


def _entry(factor: Factor, blocks: int) -> str:
    return f"{factor.name}_{blocks}"


class Library:
    """The entries of a compiled library.  Raises OSError when it cannot be loaded."""

    def __init__(self, path: Path):
        loaded = ctypes.CDLL(str(path))
        self._entries = {}
        for name in (_entry(*entry) for entry in _entries()):
            entry = getattr(loaded, f"project_{name}")
            entry.argtypes, entry.restype = (ctypes.POINTER(Arguments),), None
            self._entries[name] = entry

    def rows(self, index: RowIndex) -> CompiledRows:
        return CompiledRows(self._entries[_entry(index.factor, index.camera_blocks)], index)


class CompiledRows:
    """All projections in one call."""

    def __init__(self, entry: ctypes._NamedFuncPointer, index: RowIndex):
        self._entry, self._index = entry, index
        n, table = len(index.table), index.table
        self.packed = np.empty((2 * n, index.camera_columns + 1))
        integers = {"anchor": table.anchor, "observer": table.observer, "landmark": table.landmark}
        integers |= {"start": index.start, "place": index.place, "row": index.row}
        arrays: dict[str, np.ndarray] = {name: np.ascontiguousarray(a, np.int64) for name, a in integers.items()}
        arrays |= {"data": np.ascontiguousarray(index.data), "packed": self.packed}
        self._kept_alive = arrays
        self._arguments = Arguments(
            n=n, width=index.width, loss=_LOSSES.index(index.loss.kind), scale=index.loss.scale, **_addresses(arrays)
        )
        self._n_poses = 1 + max(table.anchor.max(), table.observer.max())
        self._cameras = [table.camera] if table.kind == "mono" else [table.camera, table.seen_by]

    def evaluate(self, states: States, curved: bool = False) -> Rows:
        n, m, width = len(self._index.table), self._index.n_landmarks, self._index.width
        inputs = {
            "poses": np.ascontiguousarray(states.poses, float),
            "extrinsics": np.ascontiguousarray(states.extrinsics[self._cameras], float),
            "td_s": np.ascontiguousarray(states.td_s, float),
            "inv_depths": np.ascontiguousarray(states.inv_depths, float),
        }
        if states.poses.shape[1:] != (7,) or len(states.poses) < self._n_poses or states.extrinsics.shape[1:] != (7,):
            raise ValueError(f"poses {states.poses.shape}, extrinsics {states.extrinsics.shape} are not those indexed")
        if inputs["inv_depths"].shape != (m,):
            raise ValueError(f"{inputs['inv_depths'].shape} inverse depths, {m} indexed")
        rows = Rows(np.empty((2, n)), np.empty(n), np.zeros((m, width)), np.zeros(m), np.zeros(m))
        for name, address in _addresses(inputs | vars(rows)).items():
            setattr(self._arguments, name, address)
        self._arguments.curved = curved
        self._entry(self._arguments)
        return rows


def _addresses(arrays: dict[str, np.ndarray]) -> dict[str, int]:
    return {name: a.ctypes.data for name, a in arrays.items()}


def check(library: Library) -> str:
    """Why `library` must not be used; empty when it gives the bits of NumPy on every residual and loss."""
    for kinds in (KINDS, TIMED):
        for kind, forms in kinds.items():
            for form, factor in forms.items():
                for blocks in numbers_of_blocks(factor):
                    for loss in (Loss("none"), Loss("cauchy", 1.0), Loss("huber", 0.7)):
                        if difference := _compare(library, *_example(kind, form, factor, blocks, loss)):
                            return f"{difference} of {factor.name} with {loss}"
    return ""


def _compare(library: Library, index: RowIndex, states: States) -> str:
    ours, expected = library.rows(index), NumpyRows(index)
    for curved in (False, True):
        a, b = (vars(rows.evaluate(states, curved)) | {"packed": rows.packed} for rows in (ours, expected))
        for name in a:
            if a[name].tobytes() != b[name].tobytes():
                return f"{name} differs from NumPy's by {np.abs(a[name] - b[name]).max():.1e}"
    return ""


def _example(kind: Kind, form: str, factor: Factor, blocks: int, loss: Loss) -> tuple[RowIndex, States]:
    """A window of random numbers, of a size that fills the lanes of the kernel more than once but not exactly."""
    rng = np.random.default_rng(0)
    n, m, frames = 300, 40, 8
    landmark = rng.integers(0, m, n)
    anchor = rng.integers(0, frames - 1, m)[landmark]
    rays = rng.normal(size=(2, n, 3)) * 0.4 + [0, 0, 1]
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    observer = anchor if kind == "same" else rng.integers(anchor + 1, frames)
    cameras = (0, 0) if kind == "mono" else (0, 1)
    table = Projections(anchor, observer, landmark, rays[0], rays[1], *cameras, kind)
    starts = [] if kind == "same" else [6 * table.anchor, 6 * table.observer]
    starts += [np.full(n, 6 * (frames + camera)) for camera in sorted(set(cameras))]
    place, width = rng.permutation(2 * n).reshape(2, n), 6 * (frames + 2) + 1
    data = measurement(form, rays[0], rays[1], 460.0)
    starts = starts[:blocks]
    if has_td(factor):
        velocity = rng.normal(size=(2, n, 2))
        starts.append(np.full(n, width - 1))
        data = np.concatenate([data, motion(form, rays[0], rays[1], velocity[0], velocity[1], 0.01, 460.0)])
    start = np.array(starts, np.int64).reshape(-1, n)
    index = RowIndex(table, factor, data, loss, rng.permutation(n), place, start, m, width)
    T = np.concatenate([rng.normal(size=(frames + 2, 3)), so3.exp(rng.normal(size=(frames + 2, 3)))], 1)
    return index, States(T[:-2], np.zeros((frames, 9)), T[-2:], rng.uniform(-0.1, 1, m), np.array([0.03]))
