"""Writes parameters.md from the declarations in vins_core/params/.

python docs/make_parameters.py
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator
from pathlib import Path

from vins_core.params import DECLARATIONS, Declaration, Params

PAGE = Path(__file__).parent / "parameters.md"
INTRODUCTION = """\
# Parameters

Made from `vins_core/params/` by `python docs/make_parameters.py`; change it there.

A parameter is set on the command line (`--set window.max_iterations=12`), in a file (`--params FILE`, as the What-if
panel saves it), or by a config's own keys (see [configs.md](configs.md)); the first of these wins. In the browser each
is a control in What-if. "px460" is a pixel of a virtual camera with a focal length of 460 px, "parity" the value with
which the original C++ is reproduced. The source in brackets names a checklist of VINS or a founding document.
"""


def page() -> str:
    """The whole page as Markdown."""
    return INTRODUCTION + "".join(_sections())


def _sections() -> Iterator[str]:
    classes = typing.get_type_hints(Params)
    for field in dataclasses.fields(Params):
        rows = (_row(d) for key, d in DECLARATIONS.items() if key.startswith(f"{field.name}."))
        summary = (classes[field.name].__doc__ or "").strip().split("\n\n")[0]
        yield f"\n## {field.name}\n{summary}\n\n| name | default | range | unit | meaning |\n|---|---|---|---|---|\n"
        yield from rows


def _row(declared: Declaration) -> str:
    name = declared.key.split(".")[1]
    cells = (f"`{name}`", f"`{_value(declared.default)}`", _range(declared), declared.unit, declared.doc)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def _range(declared: Declaration) -> str:
    if declared.choices:
        return ", ".join(f"`{choice}`" for choice in declared.choices)
    if declared.low is None:
        return "`on`, `off`"
    return f"{_value(declared.low)} to {_value(declared.high)}"


def _value(value: object) -> str:
    """As it is typed after `--set`."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:.10g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
