"""The windows of one tab: a layout's panels as viser's, where they stand, which of them can be seen."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import viser

from .browser import Bridge
from .context import RunView
from .html import tag
from .layout import Layout, Panel, Placement, canvas_width, place
from .panel_view import PANELS, PanelView
from .scene.view import OFF


class Workspace:
    def __init__(self, client: viser.ClientHandle, bridge: Bridge, layout: Layout) -> None:
        self._client = client
        self._bridge = bridge
        self._windows: dict[str, viser.PanelHandle] = {}
        self._link: viser.GuiHtmlHandle | None = None
        self.layout = layout
        self._offered: set[str] = set()
        self.panels: dict[str, PanelView] = {}
        self.visible: set[str] = set()
        """KEYs of the panels that the page shows."""
        self.page = int(client.camera.image_width), int(client.camera.image_height)
        self.canvas = 0
        """Width of the 3D view, px."""
        self.image_aspect = 1.5

    def use(self, layout: Layout, run: RunView | None) -> None:
        """Build the panels of a layout in place of those that are there, those of which the run has something."""
        self.layout, self._offered = layout, offered(run)
        for window in self._windows.values():
            window.remove()
        self.panels, self._windows = {}, {}
        for name, spec in layout.panels.items():
            window = self._windows[name] = self._client.gui.add_panel()
            for key in spec.tabs:
                if key in self._offered:
                    self._add_tab(window, key)
        self.place()

    def suits(self, run: RunView) -> bool:
        """Whether the panels built are those of which this run has something."""
        return self._offered == offered(run)

    def draws(self, toggle: str) -> bool:
        """Whether the layout wants a layer of the 3D view."""
        return self.layout.layers.get(toggle, toggle not in OFF)

    def as_it_is(self, layers: Mapping[str, bool], camera: str) -> Layout:
        """The layout with the tabs, layers and viewpoint that the user has chosen since."""
        panels = {name: shown_first(spec, self.visible) for name, spec in self.layout.panels.items()}
        return msgspec.structs.replace(self.layout, panels=panels, layers=dict(layers), camera=camera)

    def forget_knobs(self) -> None:
        """A knob was moved: panels that cannot be seen now draw theirs again when they can."""
        for key, panel in self.panels.items():
            if key not in self.visible:
                panel.forget_backdrop()

    def name_view(self, link: str) -> None:
        """Let the page's address say what is shown."""
        content = str(tag("i", hidden="hidden", data_link=link))
        if self._link is not None and self._link.content != content:
            self._link.content = content

    def place(self) -> None:
        """Put every panel where the layout says, as wide as the page allows."""
        self.canvas = canvas_width(self.layout, self.page, self.image_aspect)
        for name, at in self._placements().items():
            spec, window = self.layout.panels[name], self._windows[name]
            if spec.dock:
                window.dock_left() if spec.dock == "left" else window.dock_right()
                window.set_width(at.width)
            else:
                window.float(x=at.x, y=at.y, width=at.width)
        for name, spec in self.layout.panels.items():
            if spec.below:
                self._windows[name].dock_below(self._windows[spec.below])

    def fit_to(self, page: tuple[int, int], canvas: int) -> None:
        """The page has another size, or the user has made the 3D view wider or narrower."""
        if page != self.page:
            self.page = page
            self.place()
        elif canvas and canvas != self.canvas:
            self.canvas = canvas
            for name, at in self._placements().items():
                if self.layout.panels[name].floating:
                    self._windows[name].float(x=at.x, y=at.y, width=at.width)

    def _placements(self) -> dict[str, Placement]:
        return place(self.layout, self.page, self.image_aspect, self.canvas)

    def _add_tab(self, window: viser.PanelHandle, key: str) -> None:
        module = PANELS[key]
        with window.add_tab(module.TITLE, getattr(viser.Icon, module.ICON)):
            if not self.panels:
                self._bridge.install()
                self._link = self._client.gui.add_html("")
            self.panels[key] = PanelView(self._client.gui, module)


def offered(run: RunView | None) -> set[str]:
    """KEYs of the panels that have something to show of a run."""
    return {
        key
        for key, module in PANELS.items()
        if not hasattr(module, "exists") or (run is not None and module.exists(run))
    }


def shown_first(panel: Panel, visible: set[str]) -> Panel:
    """The panel with the tab that is open in front."""
    return msgspec.structs.replace(panel, tabs=tuple(sorted(panel.tabs, key=lambda key: key not in visible)))
