"""What a panel gets and what it gives, for tests without a browser: contexts of a fake run, and parsed html."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from html.parser import HTMLParser
from typing import Any

from fake_run import FIRST_SOLVE, HEIGHT, WIDTH, FakeRun, fake_run

from app.context import PanelContext, RunView, Selection
from vins_core.report import FrameReport, Gate, Status, summarize

__all__ = ["FIRST_SOLVE", "Markup", "context", "gate_values", "lost_again", "parse", "run_with", "shared_run"]


@lru_cache(maxsize=1)
def shared_run() -> FakeRun:
    return fake_run(45)


@lru_cache(maxsize=1)
def shared_view() -> RunView:
    return RunView(shared_run())  # type: ignore[arg-type]


def run_with(*reports: FrameReport, truth: bool = True) -> RunView:
    """The shared run with some frames replaced."""
    run = shared_run()
    changed = {r.frame: r for r in reports}
    frames = [changed.get(r.frame, r) for r in run.reports]
    summaries = [summarize(r, dict(s.ms)) for r, s in zip(frames, run.summaries)]
    copy = dataclasses.replace(run, reports=frames, summaries=summaries, truth=run.truth if truth else None)
    return RunView(copy)  # type: ignore[arg-type]


def context(frame: int, *, run: RunView | None = None, track: int | None = None, **changes: Any) -> PanelContext:
    """What panels get at `frame`; `track` selects one."""
    run = run or shared_view()
    plain: dict[str, Any] = {
        "run": run,
        "frame": frame,
        "report": run.report(frame),
        "ms": run.ms(frame),
        "selection": Selection("track", track) if track is not None else Selection(),
        "image_uri": "data:image/jpeg;base64,AAAA",
        "image_note": "",
        "width": WIDTH,
        "height": HEIGHT,
    }
    return PanelContext(**{**plain, **changes})


def lost_again(report: FrameReport) -> FrameReport:
    """The same frame, but the estimator failed at it."""
    assert report.health is not None
    bad = Gate("accelerometer bias", 3.1, "<=", 2.5, "health.max_acc_bias", "m/s^2")
    health = dataclasses.replace(report.health, gates=(bad, *report.health.gates), outcome="the bias is too large")
    return dataclasses.replace(report, health=health, status=Status.FAILED)


@dataclass
class Element:
    name: str
    attributes: dict[str, str]
    text: str = ""
    children: list[Element] = field(default_factory=list)

    def walk(self) -> Iterator[Element]:
        yield self
        for child in self.children:
            yield from child.walk()


class Markup(HTMLParser):
    """Parses strictly: every element that opens must close, in order."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.root = Element("", {})
        self._open = [self.root]
        self.feed(html)
        self.close()
        assert len(self._open) == 1, f"not closed: {[e.name for e in self._open[1:]]}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len({name for name, _ in attrs}) == len(attrs), f"attribute twice in <{tag} {attrs}>"
        element = Element(tag, {name: value or "" for name, value in attrs})
        self._open[-1].children.append(element)
        if tag not in ("img", "br", "input"):
            self._open.append(element)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._open[-1].children.append(Element(tag, {name: value or "" for name, value in attrs}))

    def handle_endtag(self, tag: str) -> None:
        assert self._open[-1].name == tag, f"</{tag}> closes <{self._open[-1].name}>"
        self._open.pop()

    def handle_data(self, data: str) -> None:
        for element in self._open:
            element.text += data

    @property
    def text(self) -> str:
        return " ".join(self.root.text.split())

    def all(self, name: str = "", **attributes: str) -> list[Element]:
        """Elements by name and attributes (`data_x` is data-x, `cls` one of its classes)."""
        return [e for e in self.root.walk() if (not name or e.name == name) and _matches(e, attributes)]

    def one(self, name: str = "", **attributes: str) -> Element:
        found = self.all(name, **attributes)
        assert len(found) == 1, f"{len(found)} elements {name} {attributes}"
        return found[0]


def _matches(element: Element, wanted: dict[str, str]) -> bool:
    for key, value in wanted.items():
        if key == "cls":
            if value not in element.attributes.get("class", "").split():
                return False
        elif element.attributes.get(key.replace("_", "-")) != value:
            return False
    return True


def parse(html: str) -> Markup:
    return Markup(html)


def gate_values(report: FrameReport) -> list[Gate]:
    """Every gate in a report."""
    parts: list[Gate] = [*report.tracks.gates]
    if report.keyframe:
        parts += report.keyframe.gates
    if report.initialization:
        parts += [g for stage in report.initialization.stages for g in stage.gates]
    if report.health:
        parts += report.health.gates
    return parts
