"""A vocabulary: a tree that turns binary descriptors into words, and images into bags of words.

Scores are those of DBoW2 (Galvez-Lopez and Tardos 2012) with TF-IDF weights and the L1 norm: a word that occurs n_i
times in an image and has the weight w_i gets v_i = n_i w_i / sum_j n_j w_j, and two images score

    s(v, u) = 1 - |v - u|_1 / 2 = sum_i min(v_i, u_i)        from 0 (nothing in common) to 1 (the same).

A vocabulary belongs to its descriptor, and limits on scores belong to the vocabulary: it names both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import VocabularyError
from .hamming import distances, packed

_FAR = np.uint16(0xFFFF)


@dataclass(frozen=True)
class BagOfWords:
    """An image as DBoW2 sees it: which words, and how much of the image each of them is."""

    words: np.ndarray  # (w,) int32, increasing
    counts: np.ndarray  # (w,) uint16, how often each occurs
    values: np.ndarray  # (w,) float64, positive, of sum 1

    def __len__(self) -> int:
        return len(self.words)


@dataclass(frozen=True)
class ScoreLimits:
    """What the scores of a vocabulary mean (REFERENCE L8)."""

    neighbour: float  # some keyframe, as a rule the previous one, must score as high, or the image is not distinctive
    candidate: float  # an earlier keyframe must score as high to be a candidate


VINS_LIMITS = ScoreLimits(neighbour=0.05, candidate=0.015)
"""Of vocabularies with a million words."""


@dataclass(frozen=True)
class Vocabulary:
    """A tree of packed descriptors.  Node 0 is the root; the children of a node are consecutive."""

    descriptor: str  # name of the describer it was made with (describe.py)
    k: int  # branching factor
    levels: int
    centers: np.ndarray  # (nodes, 4) uint64
    first_child: np.ndarray  # (nodes,) int32
    n_children: np.ndarray  # (nodes,) uint8, 0 for leaves
    word: np.ndarray  # (nodes,) int32, -1 for inner nodes
    weights: np.ndarray  # (words,) float64, inverse document frequency
    limits: ScoreLimits

    @property
    def n_words(self) -> int:
        return len(self.weights)

    def require(self, descriptor: str) -> None:
        """Raises VocabularyError when descriptors of another kind are to be looked up."""
        if descriptor != self.descriptor:
            raise VocabularyError(
                f"this vocabulary was made for {self.descriptor!r} descriptors and says nothing about {descriptor!r}: "
                "choose the descriptor that belongs to it, or a vocabulary trained on the recording"
            )

    def words_of(self, descriptors: np.ndarray) -> np.ndarray:
        """(n, 32) uint8 -> (n,) int32: down the tree, each time to the nearest child (the first among equals)."""
        bits = packed(descriptors)
        node = np.zeros(len(bits), np.int32)
        branch = np.arange(self.k)
        going = np.flatnonzero(self.n_children[node])
        while len(going):
            parent = node[going]
            children = self.first_child[parent, None] + branch
            exists = branch < self.n_children[parent, None]
            distance = distances(bits[going, None], self.centers[np.where(exists, children, 0)])
            nearest = np.argmin(np.where(exists, distance, _FAR), axis=1)
            node[going] = children[np.arange(len(going)), nearest]
            going = going[self.n_children[node[going]] > 0]
        return self.word[node]

    def bag(self, words: np.ndarray) -> BagOfWords:
        """The bag of an image with these words (n,); words without weight say nothing and are left out."""
        present, counts = np.unique(words, return_counts=True)
        weighty = self.weights[present] > 0
        return self.weigh(present[weighty].astype(np.int32), counts[weighty].astype(np.uint16))

    def weigh(self, words: np.ndarray, counts: np.ndarray) -> BagOfWords:
        """The bag of an image in which words (w,), each of some weight, occur so often."""
        values = counts * self.weights[words]
        return BagOfWords(words, counts, values / values.sum() if len(values) else values)

    def bag_of(self, descriptors: np.ndarray) -> BagOfWords:
        """The bag of an image with these descriptors (n, 32)."""
        return self.bag(self.words_of(descriptors))


def score(a: BagOfWords, b: BagOfWords) -> float:
    """L1 score of two images, from 0 to 1."""
    _, i, j = np.intersect1d(a.words, b.words, assume_unique=True, return_indices=True)
    return float(np.minimum(a.values[i], b.values[j]).sum())
