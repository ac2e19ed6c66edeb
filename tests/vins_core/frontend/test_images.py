import dataclasses

import cv2
import numpy as np
from plane_world import CAMERA, PARAMS, Film, film, packets, ref, start

from vins_core.frontend import images as module
from vins_core.frontend.images import equalized
from vins_core.frontend.step import track


def test_each_image_is_loaded_once_in_a_run():
    images, _ = film(9)
    state = start()
    for p in packets(9):
        state, _, _ = track(PARAMS, CAMERA, images, state, p)
    assert images.loads == list(range(9))


def test_images_are_equalised_as_the_parameters_say_and_cannot_be_written_to():
    images, _ = film(1)
    plain = equalized(images, ref(0), dataclasses.replace(PARAMS, equalize=False))
    np.testing.assert_array_equal(plain, images.images[0])
    after = equalized(images, ref(0), PARAMS)
    np.testing.assert_array_equal(after, cv2.createCLAHE(3.0, (8, 8)).apply(images.images[0]))
    stronger = equalized(images, ref(0), dataclasses.replace(PARAMS, clahe_clip=6.0))
    assert (stronger != after).any()
    assert not plain.flags.writeable and not after.flags.writeable
    assert images.images[0].flags.writeable


def test_only_the_last_few_images_are_kept_and_those_of_one_source_only():
    pixels = [np.full((8, 8), k, np.uint8) for k in range(6)]
    images, others = Film(pixels), Film(pixels)
    for k in (0, 1, 2, 3, 0, 4, 0, 1):  # 4 pushes out 1, the one not used for longest
        equalized(images, ref(k), PARAMS)
    assert images.loads == [0, 1, 2, 3, 4, 1]
    equalized(others, ref(0), PARAMS)
    assert others.loads == [0]


def test_nothing_is_kept_of_a_source_that_is_gone():
    images, _ = film(1)
    equalized(images, ref(0), PARAMS)
    before = len(module._kept)
    del images
    assert len(module._kept) == before - 1
