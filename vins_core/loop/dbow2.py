"""Vocabularies of DBoW2, as VINS and ORB-SLAM ship them.  Both files are trees of words with their weights.

Binary, `brief_k10L6.bin` (VINS' VocabularyBinary, little endian): six int32 (k, levels, scoring, weighting, nodes,
words), then a record a node (id, parent, weight, 256 bits) and one a word (node, word).  The root, id 0, is left out.
Text, `ORBvoc.txt`: a line `k levels scoring weighting`, then a line a node: parent, 1 for leaves, 32 bytes, weight.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import VocabularyError
from .describe import BYTES, Brief, OrientedOrb
from .hamming import packed
from .vocabulary import VINS_LIMITS, ScoreLimits, Vocabulary

MAX_BYTES = 1 << 30
MAX_BRANCHING, MAX_LEVELS = 20, 10
TF_IDF = L1_NORM = 0
"""DBoW2's numbers for the only weighting and scoring that are defined here (vocabulary.py)."""

_HEADER = np.dtype([(name, "<i4") for name in ("k", "levels", "scoring", "weighting", "nodes", "words")])
_NODE = np.dtype([("id", "<i4"), ("parent", "<i4"), ("weight", "<f8"), ("bits", "<u8", 4)])
_WORD = np.dtype([("node", "<i4"), ("word", "<i4")])


def read_vocabulary(path: str | Path) -> Vocabulary:
    """The vocabulary in a file, told by its name: `.txt` for oriented ORB, anything else for VINS' BRIEF.

    Raises VocabularyError when it is none, is damaged, or scores in another way.
    """
    path = Path(path)
    return read_text(path) if path.suffix == ".txt" else read_binary(path)


def read_binary(path: str | Path, descriptor: str = Brief.name, limits: ScoreLimits = VINS_LIMITS) -> Vocabulary:
    """VINS' binary format.  Raises VocabularyError."""
    path = Path(path)
    data = _bytes(path)
    if len(data) < _HEADER.itemsize:
        raise VocabularyError(f"{path}: {len(data)} bytes hold no header; expected a vocabulary like brief_k10L6.bin")
    header = np.frombuffer(data, _HEADER, 1)[0]
    n, n_words = int(header["nodes"]), int(header["words"])
    _check_header(path, *(int(header[name]) for name in ("k", "levels", "scoring", "weighting")))
    expected = _HEADER.itemsize + n * _NODE.itemsize + n_words * _WORD.itemsize
    if n < 1 or n_words < 1 or len(data) != expected:
        raise VocabularyError(
            f"{path}: {len(data)} bytes, but {n} nodes and {n_words} words take {expected}; the file is damaged or is "
            "not VINS' binary vocabulary"
        )
    nodes = np.frombuffer(data, _NODE, n, _HEADER.itemsize)
    words = np.frombuffer(data, _WORD, n_words, _HEADER.itemsize + n * _NODE.itemsize)
    ids = nodes["id"].astype(np.int64)
    if not np.array_equal(np.sort(ids), np.arange(1, n + 1)):
        raise VocabularyError(f"{path}: the nodes are not numbered from 1 to {n}; the file is damaged")
    if not np.array_equal(np.sort(words["word"]), np.arange(n_words)) or not np.isin(words["node"], ids).all():
        raise VocabularyError(f"{path}: the words are not numbered from 0 to {n_words - 1}; the file is damaged")
    word_of = np.full(n + 1, -1, np.int32)
    word_of[words["node"]] = words["word"]
    rows = _Rows(ids, nodes["parent"].astype(np.int64), nodes["bits"], nodes["weight"], word_of[ids])
    return _tree(path, rows, int(header["k"]), int(header["levels"]), descriptor, limits)


def read_text(path: str | Path, descriptor: str = OrientedOrb.name, limits: ScoreLimits = VINS_LIMITS) -> Vocabulary:
    """DBoW2's text format as ORB-SLAM reads it.  Raises VocabularyError."""
    path = Path(path)
    head, _, body = _bytes(path).partition(b"\n")
    try:
        k, levels, scoring, weighting = (int(word) for word in head.split())
    except ValueError:
        raise VocabularyError(
            f"{path}, line 1: expected four numbers (branching, levels, scoring, weighting) as in ORBvoc.txt"
        ) from None
    _check_header(path, k, levels, scoring, weighting)
    table = _numbers(path, body)
    parent, leaf, descriptors, weight = table[:, 0], table[:, 1], table[:, 2:-1], table[:, -1]
    whole = np.array_equal(table[:, :-1], np.floor(table[:, :-1]))
    if not (whole and np.isin(leaf, (0, 1)).all() and descriptors.min() >= 0 and descriptors.max() <= 255):
        raise VocabularyError(f"{path}: the lines are not `parent leaf {BYTES} bytes weight`; the file is damaged")
    word = np.where(leaf == 1, np.cumsum(leaf) - 1, -1).astype(np.int32)
    ids = np.arange(1, len(table) + 1)
    rows = _Rows(ids, parent.astype(np.int64), packed(descriptors.astype(np.uint8)), weight, word)
    return _tree(path, rows, k, levels, descriptor, limits)


@dataclass(frozen=True)
class _Rows:
    """Nodes as a file lists them, without the root."""

    ids: np.ndarray  # (n,) 1 to n, in any order
    parent: np.ndarray  # (n,) id, 0 for children of the root
    bits: np.ndarray  # (n, 4) uint64
    weight: np.ndarray  # (n,)
    word: np.ndarray  # (n,) int32, -1 for inner nodes


def _tree(path: Path, rows: _Rows, k: int, levels: int, descriptor: str, limits: ScoreLimits) -> Vocabulary:
    """Number the nodes from the root down, siblings in the order of the file (which decides between equals)."""
    n = len(rows.ids)
    if rows.parent.min() < 0 or rows.parent.max() > n:
        raise VocabularyError(f"{path}: a node has a parent that does not exist; the file is damaged")
    by_parent = np.argsort(rows.parent, kind="stable")
    start = np.searchsorted(rows.parent[by_parent], np.arange(n + 2))
    count = np.diff(start)  # children of each id
    layers, above = [np.zeros(0, np.int64)], np.zeros(1, np.int64)
    for _ in range(levels):
        first = np.repeat(start[above] - np.cumsum(count[above]) + count[above], count[above])
        layers.append(by_parent[first + np.arange(len(first))])
        above = rows.ids[layers[-1]]
    order = np.concatenate(layers)  # rows, from the root down
    n_children = count[np.append(0, rows.ids[order])]
    word = np.append(-1, rows.word[order])
    if len(order) != n or n_children.max() > k or not np.array_equal(n_children == 0, word >= 0):
        raise VocabularyError(
            f"{path}: the nodes do not form a tree of {levels} levels and {k} branches whose leaves are the words; "
            "the file is damaged"
        )
    is_leaf = rows.word >= 0
    weights = np.empty(int(is_leaf.sum()))
    weights[rows.word[is_leaf]] = rows.weight[is_leaf]
    if not np.all(np.isfinite(weights) & (weights >= 0)):
        raise VocabularyError(f"{path}: the weights of words are not numbers from 0 on; the file is damaged")
    return Vocabulary(
        descriptor,
        k,
        levels,
        np.concatenate([np.zeros((1, 4), np.uint64), rows.bits[order]]),
        (1 + np.cumsum(n_children) - n_children).astype(np.int32),
        n_children.astype(np.uint8),
        word.astype(np.int32),
        weights,
        limits,
    )


def _numbers(path: Path, body: bytes) -> np.ndarray:
    """(nodes, 1 + 1 + 32 + 1) of the text."""
    columns = 1 + 1 + BYTES + 1
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # told to read numbers, numpy only warns about anything else
            values = np.fromstring(body.decode("ascii"), sep=" ")
    except (ValueError, DeprecationWarning):
        raise VocabularyError(f"{path}: not everything after line 1 is a number; the file is damaged") from None
    if not len(values) or len(values) % columns:
        raise VocabularyError(
            f"{path}: {len(values)} numbers after line 1 are no whole number of lines of {columns}; the file is cut "
            "off, or its descriptors have another size than 256 bits"
        )
    return values.reshape(-1, columns)


def _check_header(path: Path, k: int, levels: int, scoring: int, weighting: int) -> None:
    if not (2 <= k <= MAX_BRANCHING and 1 <= levels <= MAX_LEVELS):
        raise VocabularyError(
            f"{path}: a tree of {k} branches and {levels} levels; expected 2 to {MAX_BRANCHING} and 1 to {MAX_LEVELS}: "
            "the file is not a DBoW2 vocabulary, or is in another format (VINS: brief_k10L6.bin, ORB-SLAM: ORBvoc.txt)"
        )
    if scoring != L1_NORM or weighting != TF_IDF:
        raise VocabularyError(
            f"{path}: scoring {scoring} and weighting {weighting}; only the L1 norm ({L1_NORM}) and TF-IDF ({TF_IDF}) "
            "are supported, which VINS and ORB-SLAM use"
        )


def _bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise VocabularyError(f"{path}: {path.stat().st_size} bytes; a vocabulary has at most {MAX_BYTES}")
        return path.read_bytes()
    except OSError as problem:
        raise VocabularyError(f"{path}: cannot be read: {problem.strerror}; check the path of the vocabulary") from None
