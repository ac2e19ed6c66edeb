from dataclasses import replace

import numpy as np
import pytest

from vins_core.errors import VocabularyError
from vins_core.loop.dbow2 import read_binary, read_text, read_vocabulary
from vins_core.loop.train import train
from vins_core.loop.vocabulary import VINS_LIMITS

HEADER = np.dtype([(n, "<i4") for n in ("k", "levels", "scoring", "weighting", "nodes", "words")])
NODE = np.dtype([("id", "<i4"), ("parent", "<i4"), ("weight", "<f8"), ("bits", "<u8", 4)])
WORD = np.dtype([("node", "<i4"), ("word", "<i4")])


@pytest.fixture(scope="module")
def vocabulary():
    rng = np.random.default_rng(0)
    return train([rng.integers(0, 256, (40, 32), np.uint8) for _ in range(12)], "brief")


def parents(vocabulary):
    parent = np.zeros(len(vocabulary.centers), np.int32)
    for node, (first, n) in enumerate(zip(vocabulary.first_child, vocabulary.n_children)):
        parent[first : first + n] = node
    return parent


def binary(vocabulary, shuffle=None):
    """The file as VINS writes it: nodes without the root, in the order of their ids or another one."""
    n = len(vocabulary.centers) - 1
    nodes, words = np.zeros(n, NODE), np.zeros(vocabulary.n_words, WORD)
    nodes["id"], nodes["parent"], nodes["bits"] = np.arange(1, n + 1), parents(vocabulary)[1:], vocabulary.centers[1:]
    leaf = np.flatnonzero(vocabulary.word >= 0)
    nodes["weight"][leaf - 1] = vocabulary.weights[vocabulary.word[leaf]]
    words["node"], words["word"] = leaf, vocabulary.word[leaf]
    head = np.array([(vocabulary.k, vocabulary.levels, 0, 0, n, len(words))], HEADER)
    if shuffle is not None:
        nodes = nodes[np.random.default_rng(shuffle).permutation(n)]
    return head, nodes, words


def text(vocabulary):
    lines = [f"{vocabulary.k} {vocabulary.levels} 0 0"]
    for node, parent in enumerate(parents(vocabulary)):
        if node:
            word = vocabulary.word[node]
            numbers = " ".join(map(str, vocabulary.centers[node].view(np.uint8)))
            weight = vocabulary.weights[word] if word >= 0 else 0
            lines.append(f"{parent} {int(word >= 0)} {numbers} {weight!r} ".replace("np.float64(", "").replace(")", ""))
    return "\n".join(lines) + "\n"


def save(path, *parts):
    path.write_bytes(b"".join(p if isinstance(p, bytes) else p.tobytes() for p in parts))
    return path


def test_the_binary_format_of_vins_is_read_as_it_was_written(tmp_path, vocabulary):
    read = read_vocabulary(save(tmp_path / "voc.bin", *binary(vocabulary)))
    assert read.descriptor == "brief" and read.limits == VINS_LIMITS
    query = np.random.default_rng(1).integers(0, 256, (500, 32), np.uint8)
    assert np.array_equal(read.words_of(query), vocabulary.words_of(query))
    assert np.array_equal(read.weights, vocabulary.weights)


def test_the_order_of_nodes_decides_between_equals_only(tmp_path, vocabulary):
    read = read_binary(save(tmp_path / "voc.bin", *binary(vocabulary, shuffle=3)))
    query = np.random.default_rng(1).integers(0, 256, (300, 32), np.uint8)
    same = read.words_of(query) == vocabulary.words_of(query)
    assert same.mean() > 0.8  # of siblings at equal distance the first in the file is taken


def test_the_text_format_of_orb_slam_is_read_as_it_was_written(tmp_path, vocabulary):
    path = tmp_path / "voc.txt"
    path.write_text(text(vocabulary))
    read = read_vocabulary(path)
    assert read.descriptor == "orb"
    query = np.random.default_rng(2).integers(0, 256, (500, 32), np.uint8)
    a, b = read.words_of(query), vocabulary.words_of(query)
    assert len(set(zip(a, b))) == len(set(a)) == len(set(b))  # the same words under other numbers
    assert np.array_equal(read.weights[a], vocabulary.weights[b])


def with_(array, **changes):
    """The table with other values in its first row."""
    array = array.copy()
    for key, value in changes.items():
        array[key][0] = value
    return array


@pytest.mark.parametrize(
    "words, damage",
    [
        ("hold no header", lambda head, nodes, words: (b"",)),
        ("hold no header", lambda head, nodes, words: (b"\x00" * 10,)),
        ("damaged", lambda head, nodes, words: (head, nodes, words.tobytes()[:-1])),
        ("and 1 words take", lambda head, nodes, words: (with_(head, words=1), nodes, words)),
        ("-5 nodes", lambda head, nodes, words: (with_(head, nodes=-5), nodes, words)),
        ("2147483647 nodes", lambda head, nodes, words: (with_(head, nodes=2**31 - 1), nodes, words)),
        ("0 branches", lambda head, nodes, words: (with_(head, k=0), nodes, words)),
        ("99 levels", lambda head, nodes, words: (with_(head, levels=99), nodes, words)),
        ("scoring 3", lambda head, nodes, words: (with_(head, scoring=3), nodes, words)),
        ("weighting 1", lambda head, nodes, words: (with_(head, weighting=1), nodes, words)),
        ("not numbered from 1", lambda head, nodes, words: (head, with_(nodes, id=2), words)),
        ("parent that does not", lambda head, nodes, words: (head, with_(nodes, parent=len(nodes) + 1), words)),
        ("parent that does not", lambda head, nodes, words: (head, with_(nodes, parent=-1), words)),
        ("do not form a tree", lambda head, nodes, words: (head, with_(nodes, parent=1), words)),  # its own parent
        ("do not form a tree", lambda head, nodes, words: (with_(head, levels=1), nodes, words)),
        ("words are not numbered", lambda head, nodes, words: (head, nodes, with_(words, word=1))),
        ("words are not numbered", lambda head, nodes, words: (head, nodes, with_(words, node=0))),
    ],
)
def test_a_damaged_binary_vocabulary_is_refused_with_a_sentence(tmp_path, vocabulary, words, damage):
    path = save(tmp_path / "voc.bin", *damage(*binary(vocabulary)))
    with pytest.raises(VocabularyError, match=words) as told:
        read_binary(path)
    assert str(path) in str(told.value)


def test_weights_must_be_numbers(tmp_path, vocabulary):
    head, nodes, words = binary(vocabulary)
    nodes["weight"][words["node"][0] - 1] = np.nan
    with pytest.raises(VocabularyError, match="weights"):
        read_binary(save(tmp_path / "voc.bin", head, nodes, words))


def test_any_byte_may_be_wrong_without_another_error(tmp_path, vocabulary):
    data = bytearray(b"".join(p.tobytes() for p in binary(vocabulary)))
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(300):
        broken = bytearray(data)
        for at in rng.integers(0, len(data) if rng.random() < 0.5 else 24, 3):
            broken[at] = rng.integers(0, 256)
        try:
            read_binary(save(tmp_path / "voc.bin", bytes(broken))).words_of(np.zeros((3, 32), np.uint8))
        except VocabularyError:
            refused += 1
    assert refused > 100


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda t: "", "line 1"),
        (lambda t: "10 3 0\n" + t, "line 1"),
        (lambda t: t.replace("10 ", "10000 ", 1), "branches"),
        (lambda t: t[: len(t) // 2].rsplit(" ", 1)[0], "no whole number of lines|tree"),
        (lambda t: t + "x", "not everything after line 1 is a number"),
        (lambda t: t.replace("\n0 0 ", "\n0 7 ", 1), "are not `parent leaf"),
        (lambda t: t.split("\n")[0] + "\n", "0 numbers after line 1"),
    ],
)
def test_a_damaged_text_vocabulary_is_refused_with_a_sentence(tmp_path, vocabulary, change, words):
    path = tmp_path / "voc.txt"
    path.write_text(change(text(vocabulary)))
    with pytest.raises(VocabularyError, match=words):
        read_text(path)


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(VocabularyError, match="cannot be read"):
        read_vocabulary(tmp_path / "none.bin")


def test_limits_of_a_file_can_be_named(tmp_path, vocabulary):
    limits = replace(VINS_LIMITS, candidate=0.02)
    assert read_binary(save(tmp_path / "voc.bin", *binary(vocabulary)), limits=limits).limits == limits
