"""Changed parameters as YAML: what a user tuned, to be kept, sent to a colleague and given to the next run.

window:
  max_iterations: 12  # solver iterations per frame
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .. import params as parameters
from ..errors import CalibrationError, OutputError, ParameterError
from ..params import DECLARATIONS, Params
from .yaml_file import read_yaml


def params_yaml(params: Params, reference: Params | None = None) -> str:
    """The parameters that differ from `reference` (the defaults), with what each means as a comment."""
    lines: list[str] = []
    for key, value in parameters.changed(params, reference).items():
        section, name = key.split(".")
        if f"{section}:" not in lines:
            lines.append(f"{section}:")
        declared = DECLARATIONS[key]
        unit = f" [{declared.unit}]" if declared.unit else ""
        lines.append(f"  {name}: {_scalar(value)}  # {declared.doc}{unit}")
    return "\n".join(lines or ["{}  # every parameter has its default"]) + "\n"


def write_params(path: Path | str, params: Params, reference: Params | None = None) -> None:
    """Raises OutputError, also when the file is already there."""
    try:
        with open(path, "x", encoding="utf-8") as file:
            file.write(params_yaml(params, reference))
    except FileExistsError:
        raise OutputError(f"{path} is already there; choose another name or remove it") from None
    except OSError as problem:
        raise OutputError(f"cannot write {path}: {problem.strerror}") from None


def read_params(path: Path | str) -> dict[str, Any]:
    """`section.name -> value`, checked against the declarations; ParameterError names file and key."""
    try:
        content = read_yaml(Path(path))
    except CalibrationError as problem:
        raise ParameterError(str(problem)) from None
    changes: dict[str, Any] = {}
    for section, names in content.items():
        if not isinstance(names, Mapping):
            raise ParameterError(f"{path}: {section}: {names!r} is not of the form `section: {{name: value}}`")
        for name, value in names.items():
            declared = DECLARATIONS.get(key := f"{section}.{name}")
            changes[key] = str(value) if declared and declared.choices else value  # a choice may look like a number
    try:
        checked = parameters.replace(Params(), changes)
    except ParameterError as problem:
        raise ParameterError(f"{path}: {problem}") from None
    return {key: parameters.get(checked, key) for key in changes}


def _scalar(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value!r}" if isinstance(value, float) else str(value)
