"""A run on disk: a folder that only ever grows, readable while it is written and after a crash (SPEC 9.1).

    header.json   how the run came about
    truth.log     ground truth of the recording, when it has one
    frames.log    a block a frame: report, timings, packet, and the state after it (HOUSE, "Time travel")
    index.log     a block a frame: where it lies in frames.log, and its summary; made again when missing or damaged
    map/          with loops: the map that the run begins with, its vocabulary at least (mapping/maps.py)
    images.log    with --embed-images: the images of each frame and its depth, losslessly
    global.log    with GPS: the final trajectory, written when the run ends (fusion/conclusion.py)
    end.json      written last: how the run ended

The state of every frame comes back bit for bit without replay: see codec.py for how a window costs little.
"""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

HEADER = "header.json"
TRUTH = "truth.log"
FRAMES = "frames.log"
INDEX = "index.log"
IMAGES = "images.log"
GLOBAL = "global.log"
END = "end.json"
MAP = "map"
FINISHED = "finished"
INTERRUPTED = "interrupted"


class End(msgspec.Struct):
    outcome: str  # FINISHED, INTERRUPTED, or the sentence of the error that ended the run
    frames: int


def is_run(path: str | os.PathLike[str]) -> bool:
    """Whether a folder is a run rather than a recording."""
    return (Path(path) / HEADER).is_file()
