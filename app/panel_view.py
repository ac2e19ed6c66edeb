"""A panel in a tab: renders only what can be seen, sends only what changed."""

from __future__ import annotations

import importlib
import logging
import pkgutil
from collections.abc import Mapping
from types import MappingProxyType, ModuleType

import viser

from . import panels
from .context import PanelContext
from .html import tag

log = logging.getLogger("vinspect")


def _find_panels() -> Mapping[str, ModuleType]:
    modules = (importlib.import_module(f"{panels.__name__}.{m.name}") for m in pkgutil.iter_modules(panels.__path__))
    return MappingProxyType({module.KEY: module for module in modules})


PANELS = _find_panels()
"""Every module in `app/panels` by its KEY: a new panel is one new file."""


class PanelView:
    """One panel of one session; see context.py for what a panel module offers."""

    def __init__(self, gui: viser.GuiApi, module: ModuleType) -> None:
        self.module = module
        self.key: str = module.KEY
        self._backdrop = gui.add_html("") if hasattr(module, "backdrop") else None
        self._backdrop_of: object = None
        self._depends = getattr(module, "backdrop_of", _of_run)
        self._content = ""
        self._body = gui.add_html(str(tag("div", cls="vi", data_vip=self.key)))

    def render(self, ctx: PanelContext) -> bool:
        """Whether there was anything to send."""
        behind = False
        try:
            if self._backdrop is not None and self._backdrop_of != (of := self._depends(ctx)):
                self._backdrop.content = str(self.module.backdrop(ctx))
                self._backdrop_of, behind = of, True
            content = str(self.module.render(ctx))
            if self._backdrop is not None:
                content = playhead(ctx.frame, len(ctx.run)) + content
        except Exception as problem:  # a bug in one panel must not blank the others
            log.exception("panel %s, frame %d", self.key, ctx.frame)
            content = message(self.key, f"This panel failed at frame {ctx.frame} ({type(problem).__name__}).")
        return self._show(content) or behind

    def forget_backdrop(self) -> None:
        """Draw it again next time."""
        self._backdrop_of = None

    def say(self, sentence: str) -> bool:
        """One sentence instead of the panel."""
        return self._show(message(self.key, sentence))

    @property
    def content(self) -> str:
        """The html the page has now."""
        return self._content

    def _show(self, content: str) -> bool:
        if content == self._content:
            return False
        self._content = self._body.content = content
        return True


def _of_run(ctx: PanelContext) -> object:
    other = (id(ctx.other.run), len(ctx.other.run)) if ctx.other else ()
    return id(ctx.run), len(ctx.run), ctx.signals, other


def message(key: str, sentence: str) -> str:
    return str(tag("div", tag("p", sentence, cls="vi-empty"), cls="vi", data_vip=key))


def playhead(k: int, n: int) -> str:
    """Tells page.js where the playheads belong, so that plots are not sent again: 0..1."""
    return str(tag("i", hidden="hidden", data_head=f"{k / max(n - 1, 1):.5f}"))
