"""What a parameter is declared with."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Range:
    low: float
    high: float


@dataclass(frozen=True)
class Doc:
    text: str
    unit: str = ""
