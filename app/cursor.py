"""Which frame of which run is wanted: moved by the user, by playing, and by a run that grows."""

from __future__ import annotations

import numpy as np

from .context import RunView
from .runs import OpenRun

PLAY_S = (0.03, 0.5)
"""Shortest and longest time a frame is shown while playing."""


class Cursor:
    def __init__(self, opened: OpenRun) -> None:
        self.opened = opened
        self.want = 0
        self.playing = False
        self.live = opened.growing
        """The newest frame is wanted until the user takes over."""

    @property
    def run(self) -> RunView | None:
        """None before its first frame."""
        return self.opened.view

    @property
    def length(self) -> int:
        return len(self.run) if self.run is not None else 0

    def use(self, opened: OpenRun, frame: int) -> None:
        """Another run, at one of its frames."""
        self.opened, self.want, self.live = opened, max(frame, 0), False

    def go(self, frame: int) -> None:
        self.live = False
        self.want = max(0, min(frame, self.length - 1))

    def step(self, by: int, keyframe: bool = False) -> None:
        self.playing = False
        self.go(self._next_keyframe(by) if keyframe else self.want + by)

    def play(self) -> None:
        """Or pause; at the end, start over."""
        if not self.playing and self.want >= self.length - 1 and not self.opened.growing:
            self.want = 0
        self.playing = not self.playing

    def advance(self) -> None:
        """The frame shown has been shown long enough."""
        if self.want < self.length - 1:
            self.want += 1
        elif not self.opened.growing:
            self.playing = False

    def catch_up(self) -> None:
        """To the newest frame, as long as the user has not taken over."""
        if self.live:
            self.want = max(self.length - 1, 0)

    def worst_cost(self) -> int | None:
        """The frame whose solve left the highest cost."""
        if self.run is None or not np.isfinite(cost := self.run.series.cost.sum(1)).any():
            return None
        return int(np.nanargmax(cost))

    @property
    def pause_s(self) -> float | None:
        """How long the wanted frame is shown while playing: as long as it lasted, within limits.  None when paused."""
        if not self.playing:
            return None
        if self.run is None or self.want >= self.length - 1:
            return PLAY_S[1]
        t_s = self.run.series.t_s
        return float(np.clip(t_s[self.want + 1] - t_s[self.want], *PLAY_S))

    def _next_keyframe(self, by: int) -> int:
        keyframes = self.run.series.keyframes if self.run is not None else np.zeros(0, int)
        later = keyframes[keyframes > self.want] if by > 0 else keyframes[keyframes < self.want][::-1]
        return int(later[0]) if len(later) else self.want
