"""A run that is being written is locked, so that one whose process was killed can be told from it."""

from __future__ import annotations

import contextlib

try:
    import fcntl
except ImportError:  # not on this system: a run that was killed looks like one that still grows
    fcntl = None  # type: ignore[assignment]


def hold(fileno: int) -> None:
    """Until the file is closed, however that happens."""
    if fcntl:
        with contextlib.suppress(OSError):  # some network folders cannot lock
            fcntl.flock(fileno, fcntl.LOCK_EX)


def is_held(fileno: int) -> bool:
    """By another process, or another file of this one."""
    if not fcntl:
        return True
    try:
        fcntl.flock(fileno, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    fcntl.flock(fileno, fcntl.LOCK_UN)
    return False
