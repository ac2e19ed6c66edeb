"""What is missing for fusion is said, and never assumed."""

from dataclasses import replace

import numpy as np
import pytest

from vins_core.fusion.available import antenna, choose_topic, missing, settings_of
from vins_core.params import Gps
from vins_core.simulation.simulate import simulate


@pytest.fixture(scope="module")
def calibration():
    return replace(simulate("street_gps", duration_s=0.4).calibration, gps_topic="", sources=("car.yaml",))


def test_the_only_topic_is_meant_and_of_several_one_must_be_named(calibration):
    assert choose_topic(calibration, ("/fix",)).gps_topic == "/fix"
    assert choose_topic(calibration, ()).gps_topic == ""
    unnamed = choose_topic(calibration, ("/fix", "/rtk"))
    assert unnamed.gps_topic == ""
    (sentence,) = missing(Gps(), unnamed, ("/fix", "/rtk"))
    assert "/fix and /rtk" in sentence and "name one" in sentence
    named = replace(calibration, gps_topic="/rtk")
    assert choose_topic(named, ("/fix", "/rtk")).gps_topic == "/rtk"
    assert choose_topic(named, ("/fix",)).gps_topic == "", "another topic than the one named is not meant"


def test_an_unknown_antenna_is_told_with_the_file_and_both_ways_out(calibration):
    unknown = choose_topic(replace(calibration, p_b_gps=None), ("/fix",))
    (sentence,) = missing(Gps(), unknown, ("/fix",))
    assert "car.yaml" in sentence and "p_b_gps" in sentence and "--set gps.lever_arm=off" in sentence
    assert antenna(Gps(), unknown) is None
    np.testing.assert_array_equal(antenna(Gps(lever_arm=False), unknown), np.zeros(3))


def test_nobody_who_does_not_care_is_told_anything(calibration):
    unknown = replace(calibration, p_b_gps=None)
    assert missing(Gps(), choose_topic(unknown, ()), ()) == ()
    assert missing(Gps(enabled=False), choose_topic(unknown, ("/fix",)), ("/fix",)) == ()
    assert missing(Gps(), choose_topic(calibration, ("/fix",)), ("/fix",)) == ()


def test_without_an_imu_the_inclination_is_estimated_too(calibration):
    assert settings_of(Gps(), calibration).dof == "4"
    assert settings_of(Gps(), replace(calibration, has_imu=False)).dof == "6"
