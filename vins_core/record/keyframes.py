"""A keyframe of loop closing in a record: what it was made of.  The rest is worked out again when it is read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..loop.consistency import Node
from ..loop.keyframe import LoopKeyframe
from ..mapping.places import Places


@dataclass(frozen=True)
class KeyframeRecord:
    """A `LoopKeyframe` without its rays, which the camera gives, and with words counted instead of weighed."""

    frame: int
    t_ns: int
    T_w_b: np.ndarray
    T_b_c: np.ndarray
    track_ids: np.ndarray
    points_w: np.ndarray
    uv_px: np.ndarray
    descriptors: np.ndarray
    words: np.ndarray
    counts: np.ndarray
    odometry: np.ndarray | None
    node: Node | None


def reduce(keyframe: LoopKeyframe) -> KeyframeRecord:
    return KeyframeRecord(
        keyframe.frame,
        keyframe.t_ns,
        keyframe.T_w_b,
        keyframe.T_b_c,
        keyframe.track_ids,
        keyframe.points_w,
        keyframe.uv_px,
        keyframe.descriptors,
        keyframe.bag.words,
        keyframe.bag.counts,
        keyframe.odometry,
        keyframe.node,
    )


def complete(record: KeyframeRecord, places: Places) -> LoopKeyframe:
    """The keyframe, bit for bit.  Raises ValueError for what no camera saw or no vocabulary has."""
    words, counts, uv_px = record.words, record.counts, record.uv_px
    known = not len(words) or 0 <= words.min() <= words.max() < places.vocabulary.n_words
    if words.shape != (len(words),) or counts.shape != words.shape or uv_px.shape != (len(uv_px), 2) or not known:
        raise ValueError(f"the keyframe of frame {record.frame} contradicts itself")
    return LoopKeyframe(
        record.frame,
        record.t_ns,
        record.T_w_b,
        record.T_b_c,
        record.track_ids,
        record.points_w,
        uv_px,
        places.camera.model.lift(uv_px).astype(np.float32),
        record.descriptors,
        places.vocabulary.weigh(words, counts),
        record.odometry,
        record.node,
    )
