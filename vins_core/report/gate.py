"""A comparison that decided something."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Gate:
    """One comparison `value op limit` and the parameter (`section.name`) that sets the limit.

    `value` is None when it could not be computed; such a gate has not passed.
    An advisory gate (`decides=False`) is shown but changes nothing.
    """

    name: str
    value: float | None
    op: str  # ">=", ">", "<=", "<"
    limit: float
    knob: str = ""
    unit: str = ""
    decides: bool = True

    def __post_init__(self) -> None:
        """Counts become floats here, as they would when written and read, so that equal gates stay equal."""
        object.__setattr__(self, "value", None if self.value is None else float(self.value))
        object.__setattr__(self, "limit", float(self.limit))

    @property
    def passed(self) -> bool:
        if self.value is None or not np.isfinite(self.value):
            return False
        match self.op:
            case ">=":
                return self.value >= self.limit
            case ">":
                return self.value > self.limit
            case "<=":
                return self.value <= self.limit
            case "<":
                return self.value < self.limit
        raise ValueError(f"unknown comparison {self.op!r} in gate {self.name!r}")

    @property
    def margin(self) -> float | None:
        """How far the value is on the passing side (negative: what is missing), in the gate's unit."""
        if self.value is None:
            return None
        return self.value - self.limit if self.op.startswith(">") else self.limit - self.value


def all_pass(gates: tuple[Gate, ...] | list[Gate]) -> bool:
    """True when every deciding gate has passed."""
    return all(g.passed for g in gates if g.decides)
