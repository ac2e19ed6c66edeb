"""The explanation of a name on the page."""

from __future__ import annotations

from dataclasses import dataclass

from ..html import UNITS, Html, tag, text


@dataclass(frozen=True)
class Tip:
    name: str
    text: str
    equation: str = ""
    unit: str = ""
    frame: str = ""
    source: str = ""

    def html(self) -> Html:
        facts = (("unit", UNITS.get(self.unit, self.unit)), ("frame", self.frame), ("source", self.source))
        known = [part for name, value in facts if value for part in (tag("dt", name), tag("dd", value))]
        return text(
            (
                tag("b", self.name),
                tag("div", self.text),
                tag("code", self.equation) if self.equation else None,
                tag("dl", *known) if known else None,
            )
        )
