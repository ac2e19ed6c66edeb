"""Milliseconds of the loop stage: `OPENBLAS_NUM_THREADS=1 pytest tests/benchmarks/test_loop.py --benchmark-enable`.

Retrieval among many keyframes, with words drawn as from a vocabulary trained on a recording (10^4 words, some of them
everywhere), and what a single keyframe costs.  `python tests/benchmarks/test_loop.py` prints how time and memory grow.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time

import cv2
import numpy as np
import pytest

from vins_core.loop.describe import UprightOrb
from vins_core.loop.index import InvertedIndex
from vins_core.loop.match import match
from vins_core.loop.train import train
from vins_core.loop.vocabulary import BagOfWords

WORDS, POINTS = 10_000, 600


def bags(n: int, seed: int = 0) -> list[BagOfWords]:
    """Bags of POINTS words each, of frequencies that fall as 1 / (rank + 200)."""
    rng = np.random.default_rng(seed)
    share = 1.0 / (np.arange(WORDS) + 200.0)
    edges = np.cumsum(share / share.sum())
    out = []
    for _ in range(n):
        words, count = np.unique(np.searchsorted(edges, rng.random(POINTS)).clip(0, WORDS - 1), return_counts=True)
        out.append(BagOfWords(words.astype(np.int32), count / count.sum()))
    return out


def images(n: int) -> list[np.ndarray]:
    """Smooth random textures, 752x480."""
    rng = np.random.default_rng(1)
    return [
        cv2.resize(rng.integers(0, 256, (60, 94), np.uint8), (752, 480), interpolation=cv2.INTER_CUBIC)
        for _ in range(n)
    ]


@pytest.mark.parametrize("n", [1_000, 20_000])
def test_query(benchmark, n):
    index, queries = InvertedIndex.of(bags(n)), bags(16, seed=9)
    turn = iter(range(10**9))
    scores = benchmark(lambda: index.scores(queries[next(turn) % 16]))
    assert len(scores) == n


def test_add_over_a_segment(benchmark):
    some = bags(1024)

    def grow():
        index = InvertedIndex()
        for bag in some:
            index = index.add(bag)
        return index

    assert len(benchmark.pedantic(grow, rounds=2)) == 1024


def test_describe(benchmark):
    (image,) = images(1)
    tracked = cv2.goodFeaturesToTrack(image, 150, 0.01, 30).reshape(-1, 2)
    assert len(benchmark(lambda: UprightOrb()(image, tracked, 500))) > 500


def test_match(benchmark):
    a, b = (UprightOrb()(image, np.zeros((0, 2)), 650) for image in images(2))
    assert benchmark(lambda: match(a.descriptors, a.uv_px, 120, b.descriptors, b.uv_px)) is not None


def test_words(benchmark):
    documents = [UprightOrb()(image, np.zeros((0, 2)), 650).descriptors for image in images(40)]
    vocabulary = train(documents, UprightOrb.name)
    assert len(benchmark(lambda: vocabulary.bag_of(documents[0]))) > 100


def main() -> None:
    print(f"{'keyframes':>9} {'query ms':>9} {'worst':>7} {'add ms':>7} {'worst':>7} {'index MB':>9}")
    index, new = InvertedIndex(), bags(512)
    for n in (1_000, 10_000, 100_000):
        add_ms = []
        while len(index) < n:
            t0 = time.perf_counter()
            index = index.add(new[len(index) % 512])
            add_ms.append(1e3 * (time.perf_counter() - t0))
        query_ms = []
        for bag in bags(20, seed=9):
            t0 = time.perf_counter()
            index.scores(bag)
            query_ms.append(1e3 * (time.perf_counter() - t0))
        figures = np.median(query_ms), max(query_ms), np.median(add_ms), max(add_ms), index.n_bytes / 1e6
        print(f"{n:9d} {figures[0]:9.2f} {figures[1]:7.2f} {figures[2]:7.2f} {figures[3]:7.2f} {figures[4]:9.1f}")


if __name__ == "__main__":
    main()
