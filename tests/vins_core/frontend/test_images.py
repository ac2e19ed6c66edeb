import dataclasses

import cv2
import numpy as np
from plane_world import PARAMS, Film, film, packets, ref, start

from vins_core.frontend.images import EqualizedImages
from vins_core.frontend.step import track


def test_each_image_is_loaded_once_in_a_run():
    from plane_world import CAMERA

    images, _ = film(9)
    source, state = EqualizedImages(images), start()
    for p in packets(9):
        state, _, _ = track(PARAMS, CAMERA, source, state, p)
    assert images.loads == list(range(9))


def test_images_are_equalised_as_the_parameters_say_and_cannot_be_written_to():
    images, _ = film(1)
    source = EqualizedImages(images)
    plain = source.equalized(ref(0), dataclasses.replace(PARAMS, equalize=False))
    np.testing.assert_array_equal(plain, images.images[0])
    equalized = source.equalized(ref(0), PARAMS)
    np.testing.assert_array_equal(equalized, cv2.createCLAHE(3.0, (8, 8)).apply(images.images[0]))
    stronger = source.equalized(ref(0), dataclasses.replace(PARAMS, clahe_clip=6.0))
    assert (stronger != equalized).any()
    assert not plain.flags.writeable and not equalized.flags.writeable
    assert images.images[0].flags.writeable


def test_only_the_last_few_images_are_kept():
    images = Film([np.full((8, 8), k, np.uint8) for k in range(5)])
    source = EqualizedImages(images, capacity=2)
    for k in (0, 1, 0, 2, 0, 1):  # 2 pushes out 1, the one not used for longest
        source.equalized(ref(k), PARAMS)
    assert images.loads == [0, 1, 2, 1]
    assert source.load(ref(4))[0, 0] == 4
