"""Parameters by their keys: declarations, values, changes, text."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

from ..errors import ParameterError
from .all import Params
from .declaration import Doc, Range


@dataclass(frozen=True)
class Declaration:
    """One parameter as declared: what a slider, a command line flag or a table row needs."""

    key: str  # "section.name"
    type: type
    default: Any
    choices: tuple[str, ...]  # for Literal types
    low: float | None
    high: float | None
    unit: str
    doc: str


def declarations() -> Iterator[Declaration]:
    """Every parameter, in the order of this file."""
    for section in dataclasses.fields(Params):
        cls = typing.get_type_hints(Params)[section.name]
        hints = typing.get_type_hints(cls, include_extras=True)
        for f in dataclasses.fields(cls):
            base, *notes = get_args(hints[f.name])
            choices = get_args(base) if get_origin(base) is Literal else ()
            span = next((n for n in notes if isinstance(n, Range)), None)
            doc = next(n for n in notes if isinstance(n, Doc))
            yield Declaration(
                f"{section.name}.{f.name}",
                str if choices else base,
                f.default,
                choices,
                span.low if span else None,
                span.high if span else None,
                doc.unit,
                doc.text,
            )


DECLARATIONS: Mapping[str, Declaration] = types.MappingProxyType({d.key: d for d in declarations()})


def get(params: Params, key: str) -> Any:
    section, name = _declaration(key).key.split(".")
    return getattr(getattr(params, section), name)


def replace(params: Params, changes: Mapping[str, Any]) -> Params:
    """`params` with `section.name -> value` changed; values may be text.  Raises ParameterError."""
    for key, value in changes.items():
        declared = _declaration(key)
        section, name = declared.key.split(".")
        stage = dataclasses.replace(getattr(params, section), **{name: _coerce(declared, value)})
        params = dataclasses.replace(params, **{section: stage})
    return params


def changed(params: Params, reference: Params | None = None) -> dict[str, Any]:
    """The parameters that differ from `reference` (the defaults), `section.name -> value`."""
    reference = reference or Params()
    sections = ((f.name, getattr(params, f.name), getattr(reference, f.name)) for f in dataclasses.fields(Params))
    return {
        f"{section}.{f.name}": getattr(mine, f.name)
        for section, mine, theirs in sections
        if mine is not theirs
        for f in dataclasses.fields(mine)
        if getattr(mine, f.name) != getattr(theirs, f.name)
    }


def parse_assignment(text: str) -> tuple[str, str]:
    """`section.name=value` -> (key, value)."""
    key, sep, value = text.partition("=")
    if not sep or not value.strip():
        raise ParameterError(
            f"--set {text!r} is not of the form section.name=value, e.g. --set window.max_iterations=8"
        )
    return key.strip(), value.strip()


def _declaration(key: str) -> Declaration:
    if key in DECLARATIONS:
        return DECLARATIONS[key]
    import difflib

    near = difflib.get_close_matches(key, DECLARATIONS, n=3, cutoff=0.5)
    near += [k for k in DECLARATIONS if k.split(".")[1] == key and k not in near]
    hint = f"did you mean {' or '.join(near)}?" if near else "`vinspect run --help` lists all parameters"
    raise ParameterError(f"unknown parameter {key!r}; {hint}")


def _coerce(declared: Declaration, value: Any) -> Any:
    expected = f"one of {', '.join(declared.choices)}" if declared.choices else declared.type.__name__
    if declared.low is not None:
        expected += f" from {declared.low:g} to {declared.high:g}"
    problem = ParameterError(
        f"parameter {declared.key}={value!r}: expected {expected}{' ' + declared.unit if declared.unit else ''}"
    )
    if declared.type is bool:
        if isinstance(value, bool):
            return value
        word = str(value).strip().lower()
        if word in ("1", "true", "yes", "on"):
            return True
        if word in ("0", "false", "no", "off"):
            return False
        raise problem
    if declared.choices:
        if value not in declared.choices:
            raise problem
        return value
    try:
        number = declared.type(value)
        if declared.type is int and float(value) != number:
            raise problem
    except (TypeError, ValueError, OverflowError):
        raise problem from None
    if not (declared.low is None or declared.high is None or declared.low <= number <= declared.high):
        raise problem
    return number
