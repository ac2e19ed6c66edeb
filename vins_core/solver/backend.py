"""Which code evaluates the projections: NumPy, or the same operations compiled to C.

Both give the same bits: every operation of kernel.c is rounded as NumPy rounds it, sums run in the same order, and a
library that differs from NumPy in a single one is never used.  Therefore "auto" may take whichever is ready.  A
command gives the same results whether the cache is empty or full, with a compiler or without; only its speed depends
on it.  The first run on a machine takes NumPy and has the kernels compiled beside it, at the lowest priority, for
those that follow.

A run's back end is chosen when it starts and recorded; forks and what-ifs use the recorded one.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Literal, get_args

from ..errors import BackendError, RunError
from . import compile
from .compiled_rows import Library
from .visual_rows import NumpyRows, RowEvaluator, RowIndex

Wish = Literal["auto", "numpy", "c"]
VARIABLE = "VINSPECT_BACKEND"
"""Environment variable that decides what "auto" leaves open."""
NUMPY, COMPILED = "numpy-tape", "compiled-c"


@dataclass(frozen=True)
class Backend:
    name: str  # as recorded: "numpy-tape" or "compiled-c <key>"
    library: Library | None = None

    def rows(self, index: RowIndex) -> RowEvaluator:
        return NumpyRows(index) if self.library is None else self.library.rows(index)


_numpy = Backend(NUMPY)
_current: ContextVar[Backend] = ContextVar("backend", default=_numpy)


def current() -> Backend:
    """The back end of this thread: NumPy outside of `using`."""
    return _current.get()


@contextmanager
def using(backend: Backend) -> Iterator[None]:
    token = _current.set(backend)
    try:
        yield
    finally:
        _current.reset(token)


def choose(wish: Wish = "auto") -> Backend:
    """The back end of a new run.

    "auto" never waits: the compiled one when it is ready, else NumPy.  "c" compiles first if need be.
    Raises BackendError when "c" cannot be had.
    """
    wish = _settle(wish)
    if wish == "numpy":
        return _numpy
    if wish == "c":
        return _compiled(compile.build_now())
    compiler = compile.find_compiler()
    found = compiler and compile.lookup(compile.key_of(compiler))
    if compiler and not found:
        compile.build_in_background()
    return _compiled(found) if found and found.library else _numpy


def recorded(name: str, wish: Wish = "auto") -> Backend:
    """The back end that a run was computed by, or, when asked for, another one that gives the same bits.

    Raises RunError when it is not available.
    """
    kind, _, key = name.partition(" ")
    if name and kind not in (NUMPY, COMPILED):
        raise RunError(
            f"the run was computed by the back end {name!r}, which is not available here ({NUMPY!r} is); "
            "replay it where it was made, or run the recording again"
        )
    wish = _settle(wish)
    if wish != "auto":
        return choose(wish)
    if kind != COMPILED:
        return _numpy
    found = compile.lookup(key)
    if found is None and (compiler := compile.find_compiler()) and compile.key_of(compiler) == key:
        found = compile.build_now()
    if found and found.library:
        return _compiled(found)
    why = found.problem if found else f"there is no {key} in {compile.cache_folder()}"
    raise RunError(
        f"the run was computed by the back end {name!r}, which is not available here: {why}; "
        f"`--backend numpy` (or {VARIABLE}=numpy) gives the same bits without it"
    )


def describe() -> tuple[str, str]:
    """The back end that a run started now would use, and why this one."""
    if _settle("auto") == "numpy":
        return NUMPY, f"{VARIABLE} says so"
    compiler = compile.find_compiler()
    if compiler is None:
        return NUMPY, "no C compiler for a faster one"
    found = compile.lookup(compile.key_of(compiler))
    if found is None:
        return NUMPY, f"the first run has {compiler.version} compile a faster one for the next"
    if found.library is None:
        return NUMPY, f"the compiled one cannot be used: {found.problem}"
    return _compiled(found).name, compiler.version


def _compiled(kernels: compile.Kernels) -> Backend:
    return Backend(f"{COMPILED} {kernels.key}", kernels.library)


def _settle(wish: Wish) -> Wish:
    if wish != "auto":
        return wish
    chosen = os.environ.get(VARIABLE) or "auto"
    if chosen not in get_args(Wish):
        raise BackendError(f"{VARIABLE} is {chosen!r}; expected one of {', '.join(get_args(Wish))}")
    return chosen  # type: ignore[return-value]
