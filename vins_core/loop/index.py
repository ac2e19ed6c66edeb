"""The inverted index: which keyframes hold a word, and how much of them it is.

Immutable: `add` gives a new index that shares almost everything with the old one, so that every frame of a run keeps
its own and a fork costs nothing.  Postings lie in segments sorted by word; two segments of equal size become one, as
in the logarithmic method (Bentley and Saxe 1980), until they are full.  A score is the same sum in the same order
whatever the segments are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .vocabulary import BagOfWords

SEGMENT_KEYFRAMES = 1024


@dataclass(frozen=True)
class Segment:
    """Postings of consecutive keyframes, sorted by (word, keyframe).  Word i owns rows start[i] : start[i + 1]."""

    n: int  # keyframes
    words: np.ndarray  # (w,) int32, increasing
    start: np.ndarray  # (w + 1,) int32
    keyframes: np.ndarray  # (p,) uint16, from the first of the segment
    values: np.ndarray  # (p,) float32

    def scores(self, bag: BagOfWords) -> np.ndarray:
        """(n,) L1 score of each keyframe."""
        row = np.searchsorted(self.words, bag.words)
        row[row == len(self.words)] = 0
        common = np.flatnonzero(self.words[row] == bag.words) if len(self.words) else np.zeros(0, int)
        first = self.start[row[common]]
        count = self.start[row[common] + 1] - first if len(common) else first
        postings = np.repeat(first - np.cumsum(count) + count, count) + np.arange(count.sum())
        shared = np.minimum(np.repeat(bag.values[common].astype(np.float32), count), self.values[postings])
        return np.bincount(self.keyframes[postings], shared, self.n)


@dataclass(frozen=True)
class InvertedIndex:
    """Keyframes 0 to n - 1."""

    n: int = 0
    segments: tuple[Segment, ...] = ()

    def __len__(self) -> int:
        return self.n

    def add(self, bag: BagOfWords) -> InvertedIndex:
        """The index with one more keyframe."""
        segments = [*self.segments, _segment([bag])]
        while len(segments) > 1 and segments[-2].n == segments[-1].n < SEGMENT_KEYFRAMES:
            segments[-2:] = [_merge(*segments[-2:])]
        return InvertedIndex(self.n + 1, tuple(segments))

    @staticmethod
    def of(bags: Sequence[BagOfWords]) -> InvertedIndex:
        """The index that adding the bags one after the other gives."""
        sizes, left = [], len(bags)
        while left:
            sizes.append(SEGMENT_KEYFRAMES if left >= SEGMENT_KEYFRAMES else 1 << (left.bit_length() - 1))
            left -= sizes[-1]
        ends = np.cumsum(sizes, dtype=int)
        return InvertedIndex(len(bags), tuple(_segment(bags[end - size : end]) for size, end in zip(sizes, ends)))

    def scores(self, bag: BagOfWords) -> np.ndarray:
        """(n,) float64, the L1 score of every keyframe with an image."""
        return np.concatenate([np.zeros(0), *(s.scores(bag) for s in self.segments)])

    @property
    def n_bytes(self) -> int:
        arrays = (a for s in self.segments for a in (s.words, s.start, s.keyframes, s.values))
        return sum(a.nbytes for a in arrays)


def _segment(bags: Sequence[BagOfWords]) -> Segment:
    words = np.concatenate([b.words for b in bags])
    keyframes = np.repeat(np.arange(len(bags), dtype=np.uint16), [len(b) for b in bags])
    return _sorted(len(bags), words, keyframes, np.concatenate([b.values for b in bags]).astype(np.float32))


def _merge(a: Segment, b: Segment) -> Segment:
    words = np.concatenate([np.repeat(s.words, np.diff(s.start)) for s in (a, b)])
    keyframes = np.concatenate([a.keyframes, b.keyframes + np.uint16(a.n)])
    return _sorted(a.n + b.n, words, keyframes, np.concatenate([a.values, b.values]))


def _sorted(n: int, words: np.ndarray, keyframes: np.ndarray, values: np.ndarray) -> Segment:
    """Postings that come by keyframe, sorted by word."""
    order = np.argsort(words, kind="stable")
    present, start = np.unique(words[order], return_index=True)
    ends = np.append(start, len(words)).astype(np.int32)
    return Segment(n, present, ends, keyframes[order], values[order])
