"""A vocabulary from a recording's own images: no file needed, and it knows this place (SPEC 7.1).

Hierarchical k-majority clustering (Grana et al. 2013): k-means for binary descriptors, where the center of a cluster
is the majority of each bit and distance is Hamming's; seeds are chosen as k-means++ does.  A level of the tree is
clustered at once, over all its nodes.  Deterministic: randomness comes from the seed and the level alone, and all
arithmetic is in integers.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array

from ..sensors import ImageRef, ImageSource
from .describe import Describer
from .hamming import distances, packed
from .index import InvertedIndex
from .vocabulary import VINS_LIMITS, ScoreLimits, Vocabulary

BRANCHING = 10
MAX_LEVELS = 6
PER_WORD = 10
"""How deep the tree is: the fewest levels with room for words of no more descriptors than this."""
ITERATIONS = 6
TRAINING_CORNERS = 400
FEW_IMAGES, MANY_IMAGES = 200, 600
MIN_STRIDE_S, MAX_STRIDE_S = 0.2, 6.0
"""Images to train on: a few, unless they lie closer than the one stride or further apart than the other."""
CALIBRATION_IMAGES = 100


def training_images(images: Sequence[ImageRef]) -> tuple[ImageRef, ...]:
    """Which of a recording's images a vocabulary is trained on: a fixed stride that depends on the recording alone."""
    if not images:
        return ()
    span_s = (images[-1].t_ns - images[0].t_ns) * 1e-9
    wanted = min(max(FEW_IMAGES, span_s / MAX_STRIDE_S), MANY_IMAGES, span_s / MIN_STRIDE_S + 1)
    return tuple(images[:: max(1, round(len(images) / wanted))])


def train_on_images(
    refs: Iterable[ImageRef], source: ImageSource, describer: Describer, usable: np.ndarray | None = None
) -> Vocabulary:
    """A vocabulary from some images of a recording."""
    nothing = np.zeros((0, 2), np.float32)
    documents = [describer(source.load(ref), nothing, TRAINING_CORNERS, usable).descriptors for ref in refs]
    return train(documents, describer.name)


def train(documents: Sequence[np.ndarray], descriptor: str, seed: int = 0) -> Vocabulary:
    """A vocabulary from the descriptors (n_i, 32) uint8 of each image.

    A word's weight is log(N / N_i): N images, N_i of them with the word.  At least one image must have descriptors.
    """
    bits = packed(np.concatenate(list(documents)))
    if not len(bits):
        raise ValueError("a vocabulary cannot be trained on images without descriptors")
    levels = int(np.clip(np.ceil(np.log(len(bits) / PER_WORD) / np.log(BRANCHING)), 1, MAX_LEVELS))
    centers, first_child, n_children, node = _grow(bits, levels, seed)
    is_leaf = n_children == 0
    word = np.where(is_leaf, np.cumsum(is_leaf) - 1, -1).astype(np.int32)
    image = np.repeat(np.arange(len(documents)), [len(d) for d in documents])
    pairs = np.unique(np.stack([word[node], image]), axis=1)
    weights = np.log(len(documents) / np.bincount(pairs[0], minlength=np.count_nonzero(is_leaf)))
    vocabulary = Vocabulary(
        descriptor, BRANCHING, levels, centers, first_child, n_children, word, weights, ScoreLimits(0.0, 0.0)
    )
    return replace(vocabulary, limits=_calibrate(vocabulary, documents))


def _calibrate(vocabulary: Vocabulary, documents: Sequence[np.ndarray]) -> ScoreLimits:
    """The median score of two training images is what any two images of this place score.

    That is what an image must reach with its neighbour; for candidates VINS' limits keep their ratio to each other.
    """
    some = documents[:: max(1, len(documents) // CALIBRATION_IMAGES)]
    bags = [vocabulary.bag_of(d) for d in some if len(d)]
    index = InvertedIndex.of(bags)
    scores = np.array([index.scores(bag) for bag in bags])
    chance = float(np.median(scores[np.triu_indices(len(bags), 1)])) if len(bags) > 1 else 0.0
    return ScoreLimits(chance, chance * VINS_LIMITS.candidate / VINS_LIMITS.neighbour)


def _grow(bits: np.ndarray, levels: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Centers, first child and number of children of every node, and the leaf that each descriptor ends in."""
    centers, first_child, n_children = np.zeros((1, bits.shape[1]), np.uint64), np.zeros(1, int), np.zeros(1, int)
    node = np.zeros(len(bits), int)
    open_rows = np.arange(len(bits))  # descriptors whose node may be split further
    for level in range(levels):
        parents, group = np.unique(node[open_rows], return_inverse=True)
        found, owner, member = cluster(bits[open_rows], group, BRANCHING, np.random.default_rng([seed, level]))
        count = np.bincount(owner, minlength=len(parents))
        is_split = count > 1
        kept = is_split[owner]
        n_children[parents[is_split]] = count[is_split]
        first_child[parents[is_split]] = len(centers) + (np.cumsum(count * is_split) - count)[is_split]
        name = len(centers) + np.cumsum(kept) - 1
        open_rows, member = open_rows[kept[member]], member[kept[member]]
        node[open_rows] = name[member]
        centers = np.concatenate([centers, found[kept]])
        first_child, n_children = (np.append(a, np.zeros(kept.sum(), int)) for a in (first_child, n_children))
    return centers, first_child.astype(np.int32), n_children.astype(np.uint8), node


def cluster(
    bits: np.ndarray, group: np.ndarray, k: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Split every group of packed descriptors into up to k clusters by k-majority.

    bits (n, 4) uint64; group (n,) from 0, without holes.  Returns the centers (c, 4), sorted by the group that owns
    them (c,), and the cluster of every descriptor (n,).
    """
    order = np.argsort(group, kind="stable")
    bits, group = bits[order], group[order]
    centers, exists = _seeds(bits, group, k, rng)
    nearest = _nearest(bits, group, centers, exists)
    for _ in range(ITERATIONS):
        centers = _majorities(bits, group * k + nearest, centers.reshape(-1, bits.shape[1])).reshape(centers.shape)
        before, nearest = nearest, _nearest(bits, group, centers, exists)
        if np.array_equal(before, nearest):
            break
    used, member = np.unique(group * k + nearest, return_inverse=True)  # a cluster may have lost all its members
    cluster_of = np.empty(len(bits), int)
    cluster_of[order] = member
    return centers.reshape(-1, bits.shape[1])[used], used // k, cluster_of


def _seeds(bits: np.ndarray, group: np.ndarray, k: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Up to k members of each group, each drawn in proportion to its squared distance to those before it.

    Returns (groups, k, 4) and which of them exist (groups, k): a group may have fewer distinct members.
    """
    start = np.searchsorted(group, np.arange(group[-1] + 2))
    rows, exists = np.zeros((len(start) - 1, k), int), np.zeros((len(start) - 1, k), bool)
    mass = np.ones(len(bits), np.int64)
    for j in range(k):
        below = np.concatenate([[0], np.cumsum(mass)])
        total = below[start[1:]] - below[start[:-1]]
        target = below[start[:-1]] + (rng.random(len(total)) * total).astype(np.int64)
        exists[:, j] = total > 0
        rows[:, j] = np.where(exists[:, j], np.searchsorted(below, target, side="right") - 1, 0)
        squared = distances(bits, bits[rows[group, j]]).astype(np.int64) ** 2
        mass = np.where(exists[group, j], np.minimum(mass, squared) if j else squared, mass)
    return bits[rows], exists


def _nearest(bits: np.ndarray, group: np.ndarray, centers: np.ndarray, exists: np.ndarray) -> np.ndarray:
    """(n,) which center of its group is nearest, the first among equals."""
    best, closest = np.full(len(bits), np.iinfo(np.uint16).max, np.uint16), np.zeros(len(bits), int)
    for j in range(centers.shape[1]):
        distance = distances(bits, centers[group, j])
        closer = exists[group, j] & (distance < best)
        best[closer], closest[closer] = distance[closer], j
    return closest


def _majorities(bits: np.ndarray, label: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """The bit-wise majority of the members of each label; labels without members keep their center."""
    used, label, count = np.unique(label, return_inverse=True, return_counts=True)
    rows = np.argsort(label, kind="stable")
    members = csr_array((np.ones(len(bits), np.int32), rows, np.append(0, np.cumsum(count))))
    out = centers.copy()
    for word in range(bits.shape[1]):
        ones = members @ np.unpackbits(bits[:, word, None].view(np.uint8), axis=1)
        out[used, word] = np.packbits(2 * ones > count[:, None], axis=1).view(np.uint64)[:, 0]
    return out
