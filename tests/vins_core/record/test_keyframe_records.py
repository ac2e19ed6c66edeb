from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from same import differences

from vins_core.record.codec import pack
from vins_core.record.keyframes import complete, reduce
from vins_core.record.reader import RunReader


def test_a_keyframe_comes_back_bit_for_bit_from_less_than_it_holds(looping_run: Path) -> None:
    with RunReader(looping_run) as run:
        assert run.places is not None and len(run.keyframes) > 30
        for keyframe in run.keyframes:
            record = reduce(keyframe)
            assert differences(keyframe, complete(record, run.places)) == []
            assert len(pack({"keyframe": record})) < 0.85 * len(pack({"keyframe": keyframe}))


def test_words_that_no_vocabulary_has_and_pixels_that_no_image_has_are_refused(looping_run: Path) -> None:
    with RunReader(looping_run) as run:
        assert run.places is not None
        record = reduce(run.keyframes[3])
        n = run.places.vocabulary.n_words
        for wrong in (
            replace(record, words=record.words + np.int32(n)),
            replace(record, words=record.words - np.int32(n)),
            replace(record, counts=record.counts[1:]),
            replace(record, uv_px=record.uv_px.ravel()),
        ):
            with pytest.raises(ValueError, match=f"frame {record.frame} contradicts itself"):
                complete(wrong, run.places)
