"""Milliseconds of the loop stage: `OPENBLAS_NUM_THREADS=1 pytest tests/benchmarks/test_loop.py --benchmark-enable`.

Retrieval among many keyframes, with words drawn as from a vocabulary trained on a recording (10^4 words, some of them
everywhere), and what a single keyframe costs.  `python tests/benchmarks/test_loop.py` prints how processor time and
memory grow: of the inverted index, of the keyframes with their descriptors, and of the nodes of consistency over laps
of 500 keyframes, three of ten of which close a loop.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time

import cv2
import numpy as np
import pytest

from vins_core.geometry import poses
from vins_core.loop.consistency import Node, arrive, judge, settle
from vins_core.loop.describe import UprightOrb
from vins_core.loop.index import InvertedIndex
from vins_core.loop.match import match
from vins_core.loop.step import decide
from vins_core.loop.train import train
from vins_core.loop.vocabulary import BagOfWords
from vins_core.params import Loop
from vins_core.report import LoopCandidate, LoopOutcome, LoopReport

WORDS, POINTS = 10_000, 600
LAP = 500


def bags(n: int, seed: int = 0) -> list[BagOfWords]:
    """Bags of POINTS words each, of frequencies that fall as 1 / (rank + 200)."""
    rng = np.random.default_rng(seed)
    share = 1.0 / (np.arange(WORDS) + 200.0)
    edges = np.cumsum(share / share.sum())
    out = []
    for _ in range(n):
        words, count = np.unique(np.searchsorted(edges, rng.random(POINTS)).clip(0, WORDS - 1), return_counts=True)
        out.append(BagOfWords(words.astype(np.int32), count.astype(np.uint16), count / count.sum()))
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


class Walk:
    """Laps of LAP keyframes; after the first, three of ten close a loop with the lap before, which ties the third."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        angle = 2 * np.pi * np.arange(LAP) / LAP
        q = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], -1)
        self.T = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), 0 * angle, q])
        self.odometry, self.params = np.diag([1e-6] * 3 + [1e-8] * 3), Loop()

    def advance(self) -> None:
        k = len(self.nodes)
        here, before = self.T[k % LAP], self.T[(k - 1) % LAP] if k else None
        nodes = arrive(self.nodes.__getitem__, k, here, before, self.odometry if k else None)
        report = LoopReport(k, k, k, 0, 0, None, (), (), LoopOutcome.TOO_RECENT)
        if k >= LAP and k % 10 < 3:
            covariance = 4 * self.odometry
            loop = LoopCandidate(k, k - LAP, 0.5, (), LoopOutcome.ACCEPTED, None, poses.IDENTITY, covariance)
            report = decide(report, [judge(self.params, nodes, loop)])
        self.nodes.append(settle(nodes, report))

    def n_bytes(self) -> int:
        """Of one node: the arrays of its two ways and its ask."""
        node = self.nodes[-1]
        motions = [node.odometry.motion, node.tied.motion, *(a.loop for a in node.asks)]
        return sum(m.T_a_b.nbytes + m.covariance.nbytes for m in motions)


def test_consistency_of_a_keyframe(benchmark):
    walk = Walk()
    while len(walk.nodes) < LAP + 10:
        walk.advance()
    benchmark.pedantic(walk.advance, rounds=100)
    assert any(node.tied.tie >= 0 for node in walk.nodes)


def keyframe_bytes() -> int:
    """What one keyframe of POINTS points, 120 of them landmarks, takes: the arrays that every one of them has."""
    bag = bags(1)[0]
    return 120 * (8 + 24) + POINTS * (8 + 12 + 32) + bag.words.nbytes + bag.values.nbytes


def main() -> None:
    columns = f"{'query ms':>9} {'worst':>7} {'add ms':>7} {'worst':>7} {'fit ms':>7} {'worst':>7}"
    print(f"{'keyframes':>9} {columns} {'index MB':>9} {'keyframes MB':>13} {'nodes MB':>9}")
    index, new, walk = InvertedIndex(), bags(512), Walk()
    for n in (1_000, 10_000, 100_000):
        fit_ms = []
        while len(walk.nodes) < n:
            t0 = time.process_time()
            walk.advance()
            fit_ms.append(1e3 * (time.process_time() - t0))
        add_ms = []
        while len(index) < n:
            t0 = time.process_time()
            index = index.add(new[len(index) % 512])
            add_ms.append(1e3 * (time.process_time() - t0))
        query_ms = []
        for bag in bags(20, seed=9):
            t0 = time.process_time()
            index.scores(bag)
            query_ms.append(1e3 * (time.process_time() - t0))
        closing = sorted(fit_ms[-LAP:])[-LAP * 3 // 10 :]
        times = [f(ms) for ms in (query_ms, add_ms, closing) for f in (np.median, np.max)]
        memory = [index.n_bytes / 1e6, n * keyframe_bytes() / 1e6, n * walk.n_bytes() / 1e6]
        told = f"{times[0]:9.2f} " + " ".join(f"{t:7.2f}" for t in times[1:])
        print(f"{n:9d} {told} {memory[0]:9.1f} {memory[1]:13.1f} {memory[2]:9.1f}")


if __name__ == "__main__":
    main()
