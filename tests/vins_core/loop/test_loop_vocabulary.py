import numpy as np
import pytest

from vins_core.errors import VocabularyError
from vins_core.loop import index as index_module
from vins_core.loop.hamming import distances, packed
from vins_core.loop.index import InvertedIndex
from vins_core.loop.train import BRANCHING, cluster, train, training_images
from vins_core.loop.vocabulary import BagOfWords, score
from vins_core.sensors import ImageRef


def documents(n=30, per_image=80, kinds=120, flips=0.06, seed=0):
    """Images of some kinds of points, each described with some bits wrong."""
    rng = np.random.default_rng(seed)
    kind = rng.integers(0, 256, (kinds, 32), np.uint8)
    noise = [np.packbits(rng.random((per_image, 256)) < flips, axis=1) for _ in range(n)]
    return [kind[rng.integers(0, kinds, per_image)] ^ e for e in noise]


@pytest.fixture(scope="module")
def docs():
    return documents()


@pytest.fixture(scope="module")
def vocabulary(docs):
    return train(docs, "orb-upright")


def test_scores_are_those_of_dbow2(vocabulary, docs):
    """s = 1 - |v - u|_1 / 2, symmetric, 1 for the same image, from 0 to 1."""
    bags = [vocabulary.bag_of(d) for d in docs[:8]]
    for a in bags:
        assert score(a, a) == pytest.approx(1.0)
        for b in bags:
            v, u = np.zeros(vocabulary.n_words), np.zeros(vocabulary.n_words)
            v[a.words], u[b.words] = a.values, b.values
            assert score(a, b) == score(b, a) == pytest.approx(1 - np.abs(v - u).sum() / 2)
            assert 0.0 <= score(a, b) <= 1.0 + 1e-12


def test_a_bag_is_tf_idf_of_sum_one(vocabulary, docs):
    words = vocabulary.words_of(docs[0])
    bag = vocabulary.bag(words)
    expected = np.bincount(words, minlength=vocabulary.n_words) * vocabulary.weights
    assert np.allclose(bag.values, (expected / expected.sum())[bag.words]) and np.all(bag.values > 0)
    assert bag.values.sum() == pytest.approx(1.0)


def test_weights_are_the_inverse_document_frequency(vocabulary, docs):
    seen_in = np.zeros(vocabulary.n_words)
    for d in docs:
        seen_in[np.unique(vocabulary.words_of(d))] += 1
    known = seen_in > 0
    assert known.mean() > 0.95  # looking up may end elsewhere than training did, seldom
    agreed = np.isclose(vocabulary.weights[known], np.log(len(docs) / seen_in[known]))
    assert agreed.mean() > 0.9


def test_a_word_in_every_image_says_nothing(docs):
    common = np.zeros((1, 32), np.uint8)
    vocabulary = train([np.concatenate([d, common]) for d in docs], "orb-upright")
    assert vocabulary.weights[vocabulary.words_of(common)][0] == pytest.approx(0.0, abs=0.2)
    assert len(vocabulary.bag(vocabulary.words_of(np.zeros((0, 32), np.uint8)))) == 0


def test_looking_up_goes_to_the_nearest_child_at_every_level(vocabulary, docs):
    for descriptor, word in zip(docs[3], vocabulary.words_of(docs[3])):
        node = 0
        while vocabulary.n_children[node]:
            first = vocabulary.first_child[node]
            children = range(first, first + vocabulary.n_children[node])
            apart = [int(np.unpackbits(packed(descriptor)[0:1].view(np.uint8)
                                       ^ vocabulary.centers[c].view(np.uint8)).sum()) for c in children]  # fmt: skip
            node = first + int(np.argmin(apart))
        assert vocabulary.word[node] == word


def test_descriptors_of_one_kind_often_share_a_word_and_those_of_two_kinds_seldom(vocabulary):
    words = [vocabulary.words_of(documents(n=1, per_image=200, kinds=1, seed=seed)[0]) for seed in (0, 5)]
    alike = np.mean(words[0][:, None] == words[0])
    unlike = np.mean(words[0][:, None] == words[1])
    assert alike > 20 * max(unlike, 0.001)


def test_the_tree_is_a_tree(vocabulary):
    children = np.concatenate([np.arange(f, f + n) for f, n in zip(vocabulary.first_child, vocabulary.n_children) if n])
    assert np.array_equal(np.sort(children), np.arange(1, len(vocabulary.centers)))
    assert vocabulary.n_children.max() <= BRANCHING and not np.any(vocabulary.n_children == 1)
    leaves = vocabulary.word[vocabulary.n_children == 0]
    assert np.array_equal(np.sort(leaves), np.arange(vocabulary.n_words))
    assert np.all(vocabulary.word[vocabulary.n_children > 0] == -1)


def test_training_gives_the_same_bits_every_time(docs, vocabulary):
    again = train(docs, "orb-upright")
    assert again.centers.tobytes() == vocabulary.centers.tobytes()
    assert again.weights.tobytes() == vocabulary.weights.tobytes() and again.limits == vocabulary.limits
    assert train(docs, "orb-upright", seed=1).centers.tobytes() != vocabulary.centers.tobytes()


def test_clusters_are_found_where_there_are_some():
    rng = np.random.default_rng(2)
    centers = rng.integers(0, 256, (5, 32), np.uint8)
    label = rng.integers(0, 5, 400)
    points = packed(centers[label] ^ np.packbits(rng.random((400, 256)) < 0.03, axis=1))
    found, owner, member = cluster(points, np.zeros(400, int), 5, np.random.default_rng(0))
    assert np.all(owner == 0) and len(found) == 5
    assert distances(found[:, None], packed(centers)).min(0).max() <= 3
    assert len({(a, b) for a, b in zip(label, member)}) == 5


def test_equal_descriptors_are_one_cluster_and_groups_are_split_apart():
    points = packed(np.repeat(np.array([[0], [255], [15]], np.uint8), 32, 1)[[0, 0, 0, 1, 2, 2, 1]])
    found, owner, member = cluster(points, np.array([0, 0, 0, 1, 1, 1, 1]), 4, np.random.default_rng(0))
    assert owner.tolist() == [0, 1, 1] and len(found) == 3
    assert np.array_equal(found[member], points)


def test_images_without_points_are_no_obstacle(docs):
    empty = np.zeros((0, 32), np.uint8)
    vocabulary = train([empty, *docs, empty], "orb-upright")
    assert vocabulary.n_words > 50
    with pytest.raises(ValueError, match="without descriptors"):
        train([empty], "orb-upright")


def test_one_descriptor_is_a_vocabulary_of_one_word():
    vocabulary = train([np.zeros((1, 32), np.uint8)], "orb-upright")
    assert vocabulary.n_words == 1 and vocabulary.words_of(np.full((2, 32), 7, np.uint8)).tolist() == [0, 0]


def test_limits_follow_the_scores_that_chance_gives(vocabulary, docs):
    bags = [vocabulary.bag_of(d) for d in docs]
    pairs = [score(a, b) for i, a in enumerate(bags) for b in bags[:i]]
    assert vocabulary.limits.neighbour == pytest.approx(np.median(pairs), rel=1e-5)
    assert vocabulary.limits.candidate == pytest.approx(0.3 * np.median(pairs), rel=1e-5)


def test_a_vocabulary_refuses_other_descriptors(vocabulary):
    vocabulary.require("orb-upright")
    with pytest.raises(VocabularyError, match="made for 'orb-upright' descriptors and says nothing about 'brief'"):
        vocabulary.require("brief")


def random_bags(n, n_words=500, seed=0):
    rng = np.random.default_rng(seed)
    bags = []
    for size in rng.integers(0, 60, n):
        words = np.sort(rng.permutation(n_words)[:size]).astype(np.int32)
        values = rng.random(size) + 0.01
        bags.append(BagOfWords(words, np.ones(size, np.uint16), values / values.sum() if size else values))
    return bags


def test_the_index_scores_every_keyframe(monkeypatch):
    monkeypatch.setattr(index_module, "SEGMENT_KEYFRAMES", 16)
    bags = random_bags(77)
    index = InvertedIndex()
    for k, bag in enumerate(bags):
        assert np.allclose(index.scores(bag), [score(bag, b) for b in bags[:k]], atol=1e-6)
        index = index.add(bag)
    assert len(index) == 77 and max(s.n for s in index.segments) == 16


def test_scores_do_not_depend_on_how_the_index_grew(monkeypatch):
    monkeypatch.setattr(index_module, "SEGMENT_KEYFRAMES", 16)
    bags = random_bags(53)
    grown = InvertedIndex()
    for bag in bags:
        grown = grown.add(bag)
    made = InvertedIndex.of(bags)
    one = index_module.InvertedIndex(53, (index_module._segment(bags),))
    assert [s.n for s in made.segments] == [s.n for s in grown.segments]
    for bag in random_bags(10, seed=1):
        assert grown.scores(bag).tobytes() == made.scores(bag).tobytes() == one.scores(bag).tobytes()


def test_adding_leaves_the_index_before_as_it_was():
    bags = random_bags(9)
    before = InvertedIndex.of(bags[:8])
    scores = before.scores(bags[8]).tobytes()
    after = before.add(bags[8]).add(bags[0])
    assert (len(before), len(after)) == (8, 10) and before.scores(bags[8]).tobytes() == scores


def test_an_empty_index_or_bag_scores_nothing():
    nothing = BagOfWords(np.zeros(0, np.int32), np.zeros(0, np.uint16), np.zeros(0))
    assert len(InvertedIndex().scores(random_bags(1)[0])) == 0
    assert InvertedIndex.of([nothing, *random_bags(3)]).scores(nothing).tolist() == [0.0] * 4


def test_training_images_depend_on_the_recording_alone():
    def refs(n, hz):
        return [ImageRef(int(i * 1e9 / hz), 0, i) for i in range(n)]

    assert len(training_images(refs(1200, 20))) == 200
    assert 540 <= len(training_images(refs(100_000, 30))) <= 560  # an hour: one in six seconds
    assert 590 <= len(training_images(refs(1_000_000, 30))) <= 610
    assert len(training_images(refs(84, 1))) == 84
    assert training_images([]) == () and len(training_images(refs(1, 20))) == 1
    few = training_images(refs(100, 20))  # five seconds: no two images nearer than MIN_STRIDE_S
    assert np.diff([r.t_ns for r in few]).min() >= 0.2e9
