"""What commands say: results on stdout, everything else on stderr, so that output can be piped."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import msgspec


class Report(Protocol):
    def __call__(self, share: float, text: str = "") -> None:
        """`share` 0..1 of the work is done."""


@contextmanager
def progress_bar(title: str) -> Iterator[Report]:
    """A bar on stderr when someone watches it; `report(share, text)` moves it."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn(), TextColumn("{task.fields[text]}"))
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task(title, total=1.0, text="")
        yield lambda share, text="": bars.update(task, completed=min(share, 1.0), text=text)


def print_json(value: Any) -> None:
    """A value of dataclasses and plain data as JSON; a number that does not exist is null."""
    print(msgspec.json.format(msgspec.json.encode(value), indent=2).decode())


def note(text: str) -> None:
    """A remark on stderr."""
    print(text, file=sys.stderr)
