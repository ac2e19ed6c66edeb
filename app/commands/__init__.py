"""The commands of `vinspect`, a file each: signatures are the command line, heavy imports wait until one runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from .compare import compare
from .convert import convert
from .eval import evaluate
from .export import export
from .fork import fork
from .info import info
from .loops import loops
from .map import load, save
from .open import open_page
from .run import run
from .simulate import simulate

Command = Callable[..., Any]

COMMANDS: Mapping[str, Command | Mapping[str, Command]] = MappingProxyType(
    {
        "open": open_page,
        "run": run,
        "info": info,
        "eval": evaluate,
        "loops": loops,
        "fork": fork,
        "compare": compare,
        "export": export,
        "convert": convert,
        "simulate": simulate,
        "map": {"save": save, "load": load},
    }
)
