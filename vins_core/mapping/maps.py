"""Maps on disk with all that a second session needs: pose graph, vocabulary, keyframes with their descriptors.

A run keeps the map that it begins with in the same form: at least its vocabulary, and no keyframes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import MapError, RunError, VocabularyError
from ..loop.consistency import Way
from ..loop.describe import BYTES, Brief, Describer, describer_named
from ..loop.keyframe import LoopKeyframe
from ..loop.vocabulary import Vocabulary
from ..pose_graph.graph import PoseGraph
from ..pose_graph.storage import camera_of, load_map, save_map
from ..record.codec import Blob, pack
from ..sensors import CameraCalibration
from .places import Places

KEYFRAMES_PER_PART = 256


@dataclass(frozen=True)
class _Words:
    vocabulary: Vocabulary
    brief_offsets: np.ndarray | None  # of a BRIEF describer


def save(folder: Path, places: Places, graph: PoseGraph, keyframes: Sequence[LoopKeyframe]) -> None:
    """Write a map: `keyframes` are those of `graph`, in its order.  Raises OutputError."""
    if len(graph) != len(keyframes):
        raise ValueError(f"{len(keyframes)} keyframes do not fit a graph of {len(graph)}")
    describer = places.describer
    offsets = describer.offsets if isinstance(describer, Brief) else None
    parts = {"vocabulary": pack({"words": _Words(places.vocabulary, offsets)})}
    for first in range(0, len(keyframes), KEYFRAMES_PER_PART):
        some = tuple(keyframes[first : first + KEYFRAMES_PER_PART])
        parts[f"keyframes-{first // KEYFRAMES_PER_PART}"] = pack({"keyframes": some})
    save_map(folder, places.camera.model, graph, parts)


def load(folder: Path, camera: CameraCalibration) -> Places:
    """A map to begin a run with.  Raises MapError when it is damaged or was made with another camera."""
    graph, parts = load_map(folder, camera.model)
    try:
        words = Blob(parts.pop("vocabulary"), f"the vocabulary of {folder}").get("words", _Words)
        _check_vocabulary(words.vocabulary)
        keyframes: list[LoopKeyframe] = []
        for k in range(len(parts)):
            blob = Blob(parts[f"keyframes-{k}"], f"part {k} of the keyframes of {folder}")
            keyframes += blob.get("keyframes", tuple[LoopKeyframe, ...])
        for number, keyframe in enumerate(keyframes):
            check_keyframe(number, keyframe, words.vocabulary)
        if len(keyframes) != len(graph):
            raise ValueError(f"it has {len(graph)} poses and {len(keyframes)} keyframes")
        describer = _describer(words)
    except (KeyError, ValueError, RunError, VocabularyError) as problem:
        raise MapError(f"the map {folder} is damaged: {problem}; save it again") from None
    return Places(camera, words.vocabulary, describer, tuple(keyframes), graph)


def read(folder: Path) -> Places:
    """A map by itself, seen with its own camera, whose place on the body it does not know.  Raises MapError."""
    model = camera_of(folder)
    return load(folder, CameraCalibration("cam0", model, np.eye(4)))


def restart(places: Places) -> Places:
    """The same places without the map that a run began with."""
    return replace(places, keyframes=(), graph=PoseGraph())


def _describer(words: _Words) -> Describer:
    if words.vocabulary.descriptor != Brief.name:
        return describer_named(words.vocabulary.descriptor)
    offsets = words.brief_offsets
    if offsets is None or offsets.shape != (8 * BYTES, 2, 2) or np.abs(offsets).max() > 255:
        raise ValueError("its BRIEF pattern is no pattern")
    return Brief(offsets)


def _check_vocabulary(words: Vocabulary) -> None:
    n = len(words.centers)
    leaves = words.word[words.n_children == 0]
    inner = np.flatnonzero(words.n_children)
    last = words.first_child[inner].astype(np.int64) + words.n_children[inner]
    sound = (
        words.centers.shape == (n, BYTES // 8)
        and words.centers.dtype == np.uint64
        and len(words.first_child) == len(words.n_children) == len(words.word) == n
        and np.all((words.first_child[inner] > inner) & (last <= n))
        and np.array_equal(np.sort(leaves), np.arange(words.n_words))
    )
    if not sound:
        raise ValueError("its vocabulary is no tree of words")


def check_keyframe(number: int, keyframe: LoopKeyframe, words: Vocabulary) -> None:
    """Raises ValueError for what no loop stage made: its arrays do not fit, or it is reached from where it is not."""
    n, bag, node = len(keyframe.uv_px), keyframe.bag, keyframe.node
    shapes = (
        keyframe.T_w_b.shape == (7,)
        and keyframe.T_b_c.shape == (4, 4)
        and keyframe.points_w.shape[1:] == (3,)
        and keyframe.track_ids.ndim == 1
        and keyframe.n_landmarks <= len(keyframe.track_ids) <= n
        and keyframe.uv_px.shape == (n, 2)
        and keyframe.rays.shape == (n, 3)
        and keyframe.descriptors.shape == (n, BYTES)
        and keyframe.descriptors.dtype == np.uint8
        and bag.words.shape == bag.values.shape == (len(bag),)
        and (keyframe.odometry is None or keyframe.odometry.shape == (6, 6))
    )
    if not shapes or (len(bag) and not 0 <= bag.words.min() <= bag.words.max() < words.n_words):
        raise ValueError(f"keyframe {number} contradicts itself")
    if node is not None and not (_sound(node.odometry, number) and _sound(node.tied, number)):
        raise ValueError(f"keyframe {number} is reached from no earlier one")


def _sound(way: Way, number: int) -> bool:
    """Does a way lead back to the root of its tree?"""
    back = way.tie == -1 if way.chain == way.tree else way.tree <= way.tie < way.chain
    motion = way.motion.T_a_b.shape == (7,) and way.motion.covariance.shape == (6, 6)
    return 0 <= way.tree <= way.chain <= number and back and motion
