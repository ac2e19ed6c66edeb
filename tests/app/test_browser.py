"""What comes from the page is checked; what goes into it is escaped."""

from __future__ import annotations

import html
import json

import pytest

from app.browser import Apply, Edge, Fork, GoTo, Knob, Loops, Page, Pick, Play, Seek, Step, boot_fragment, decode
from app.html import send
from app.style import CSS
from app.tooltips import TIPS


@pytest.mark.parametrize(
    ("text", "event"),
    [
        ('{"k":"seek","f":0.25,"n":1}', Seek(0.25)),
        ('{"k":"frame","i":12}', GoTo(12)),
        ('{"k":"step","d":-1,"kf":true}', Step(-1, True)),
        ('{"k":"play"}', Play()),
        ('{"k":"pick","t":"track","i":57}', Pick("track", 57)),
        ('{"k":"knob","key":"init.min_matches"}', Knob("init.min_matches")),
        ('{"k":"pick","t":"loop","i":466,"j":21}', Pick("loop", 466, 21)),
        ('{"k":"fork","at":12}', Fork(12)),
        ('{"k":"loops","show":"missed"}', Loops("missed")),
        ('{"k":"edge","do":"force","i":21,"j":466}', Edge("force", 21, 466)),
        ('{"k":"apply","changes":{"loop.min_inliers":19}}', Apply({"loop.min_inliers": 19})),
        ('{"k":"page","panels":["camera"],"width":1600,"height":950,"canvas":640}', Page(("camera",), 1600, 950, 640)),
    ],
)
def test_events_of_the_page_are_read(text: str, event: object) -> None:
    assert decode(text) == event


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "7",
        '{"k":"boom"}',
        '{"k":"edge","do":"burn"}',
        '{"k":"frame"}',
        '{"k":"frame","i":"1"}',
        '{"k":"seek","f":NaN}',
        '{"f":1}',
    ],
)
def test_anything_else_is_ignored(text: str) -> None:
    assert decode(text) is None


def test_panels_speak_the_language_of_the_page() -> None:
    sent = send(k="pick", t="frame", i=3)
    assert decode(sent.removeprefix("vi.send(").removesuffix(")")) == Pick("frame", 3)


def test_the_boot_fragment_is_one_element_that_carries_style_and_tooltips() -> None:
    fragment = boot_fragment("an-id")
    assert fragment.count("<") == fragment.count(">") == 1
    script = html.unescape(fragment)
    assert json.dumps(CSS) in script and '"an-id"' in script
    assert all(json.dumps(tip.name)[1:-1] in script for tip in TIPS.values())
    assert "__" not in script.replace("__viserMutable", "")
