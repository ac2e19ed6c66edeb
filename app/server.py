"""The server: one viser server, one session per tab, one look at the growing run for all of them."""

from __future__ import annotations

import asyncio
import contextlib
import io
import logging
import sys
import threading
import time
import webbrowser
from collections.abc import Sequence
from pathlib import Path

import cv2
import viser

from vins_core.errors import RecordingError

from .drawing import SCENE
from .layout import shipped_layouts, user_layouts
from .places import shipped
from .runs import OpenRun, open_path
from .session import Session
from .store import RunStore

log = logging.getLogger("vinspect")
POLL_S = 0.25
MAP_PAUSE_S = 0.01
SWITCH_S = 0.0005
"""After which a thread that computes lets the event loop have its turn; Python's 5 ms are felt in every step."""


class Server:
    """Serves one opened run, and its forks, to any number of tabs."""

    def __init__(self, opened: OpenRun, host: str = "127.0.0.1", port: int = 8080) -> None:
        cv2.setNumThreads(1)  # more threads starve the event loop
        sys.setswitchinterval(SWITCH_S)
        self.store = RunStore(opened)
        self._layouts = shipped_layouts()
        self.sessions: dict[int, Session] = {}
        with contextlib.redirect_stdout(io.StringIO()):  # viser's own banner
            self._viser = viser.ViserServer(host=host, port=port, label="vinspect", verbose=False)
        gui, scene = self._viser.gui, self._viser.scene
        gui.configure_theme(dark_mode=True, brand_color=(86, 180, 233), show_logo=False, show_share_button=False)
        scene.set_up_direction("+z")
        scene.configure_default_lights(cast_shadow=False)
        scene.world_axes.visible = False
        self._viser.on_client_connect(self._connect)
        self._viser.on_client_disconnect(self._disconnect)
        self._polling = asyncio.run_coroutine_threadsafe(self._poll(), self._viser.get_event_loop())

    @property
    def url(self) -> str:
        """Where it really listens: a busy port has silently become the next one."""
        host = self._viser.get_host()
        name = "localhost" if host in ("127.0.0.1", "0.0.0.0", "::") else f"[{host}]" if ":" in host else host
        return f"http://{name}:{self._viser.get_port()}"

    def stop(self) -> None:
        self._polling.cancel()
        asyncio.run_coroutine_threadsafe(self._end_sessions(), self._viser.get_event_loop()).result(timeout=10)
        self.store.close()
        with contextlib.redirect_stdout(io.StringIO()):
            self._viser.stop()

    async def _end_sessions(self) -> None:
        for session in self.sessions.values():
            session.close()
        await asyncio.gather(*(session.drawing.task for session in self.sessions.values()))

    async def _connect(self, client: viser.ClientHandle) -> None:
        try:
            self.sessions[client.client_id] = Session(client, self.store, [*self._layouts, *user_layouts()])
        except Exception:
            log.exception("a tab could not be set up")

    async def _disconnect(self, client: viser.ClientHandle) -> None:
        session = self.sessions.pop(client.client_id, None)
        if session is not None:
            session.close()

    async def _poll(self) -> None:
        while True:
            behind = False
            try:
                self._tell(self.store.poll())
                behind = self._extend_maps()
            except Exception:
                log.exception("the run could not be read further")
            await asyncio.sleep(MAP_PAUSE_S if behind else POLL_S)

    def _tell(self, changed: set[OpenRun]) -> None:
        if changed:
            for session in self.sessions.values():
                session.grown(changed)

    def _extend_maps(self) -> bool:
        """A slice of the maps of passed landmarks; True while some are not complete."""
        shown = {self.store.first, *(session.opened for session in self.sessions.values())}
        done = [run for run in shown if run.map_behind and not run.extend_map()]
        for session in self.sessions.values():
            if session.opened in done:
                session.refresh(SCENE)
        return any(run.map_behind for run in shown)


def sample() -> tuple[Path, tuple[Path, ...]]:
    """The bundled recording and its calibration.  Raises RecordingError."""
    folder = shipped("sample_data")
    bags, calibrations = sorted(folder.glob("*.bag")), sorted(folder.glob("*.yaml"))
    if not bags or not calibrations:
        raise RecordingError(f"{folder} holds no recording; name one: vinspect open RECORDING --calib FILE")
    return bags[0], tuple(calibrations[:1])


def open_browser(
    path: Path | None = None,
    calib: Sequence[Path] = (),
    host: str = "127.0.0.1",
    port: int = 8080,
    no_browser: bool = False,
) -> None:
    """Serve a run folder or a recording (None: the bundled sample) until Ctrl-C.

    What cannot be read is one sentence, in the terminal (raised, when there is nothing to show) and in the page.
    """
    opened = open_path(*((path, calib) if path is not None else sample()))
    server = Server(opened, host, port)
    print(f"vinspect: {opened.title} at {server.url}  (Ctrl-C ends it)", flush=True)
    if opened.error:
        print(f"vinspect: {opened.error}", flush=True)
    if not no_browser:
        threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        pass
    finally:
        server.stop()
