"""What recognising places needs from outside a run's state: a camera, a vocabulary, perhaps a map to begin with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import VocabularyError
from ..frontend.images import usable_area
from ..loop.dbow2 import read_vocabulary
from ..loop.describe import Brief, Describer, UprightOrb, describer_named
from ..loop.keyframe import LoopKeyframe, describe_keyframe
from ..loop.train import train_on_images, training_images
from ..loop.vocabulary import Vocabulary
from ..pose_graph.graph import PoseGraph
from ..sensors import CameraCalibration, ImageRef, ImageSource
from ..window.state import WindowState
from .schedule import Optimizer


@dataclass(frozen=True)
class Places:
    """Fixed for a run and kept with its record; a run without them closes no loops."""

    camera: CameraCalibration
    vocabulary: Vocabulary
    describer: Describer
    keyframes: Sequence[LoopKeyframe] = ()  # of the map that the run begins with
    graph: PoseGraph = field(default_factory=PoseGraph)  # of that map
    optimizer: Optimizer = field(default_factory=Optimizer, compare=False)

    def __post_init__(self) -> None:
        self.vocabulary.require(self.describer.name)

    def describe(self, window: WindowState, slot: int, image: np.ndarray, max_corners: int) -> LoopKeyframe:
        """The frame in a slot of the window as loop closing keeps it; `image` as recorded."""
        usable = usable_area(self.camera)
        model = self.camera.model
        return describe_keyframe(window, slot, model, image, self.describer, self.vocabulary, max_corners, usable)


def learn_places(camera: CameraCalibration, images: Sequence[ImageRef], source: ImageSource) -> Places | None:
    """Places of a recording by a vocabulary trained on its own images; None when they show nothing to describe.

    `images`: all of the camera's.  Deterministic, and independent of every parameter of a run (SPEC 7.1).
    """
    describer = UprightOrb()
    try:
        vocabulary = train_on_images(training_images(images), source, describer, usable_area(camera))
    except ValueError:
        return None
    return Places(camera, vocabulary, describer)


def read_places(camera: CameraCalibration, vocabulary: Path, brief_pattern: Path | None = None) -> Places:
    """Places by a DBoW2 vocabulary: `brief_k10L6.bin` with its pattern file, or ORB-SLAM's `ORBvoc.txt`.

    Raises VocabularyError.
    """
    words = read_vocabulary(vocabulary)
    if brief_pattern is not None and words.descriptor != Brief.name:
        raise VocabularyError(f"{vocabulary} is made for {words.descriptor!r} descriptors; a BRIEF pattern has no use")
    return Places(camera, words, describer_named(words.descriptor, brief_pattern))
