"""The palette keeps its meanings apart for every kind of colour vision."""

import itertools

import numpy as np
import pytest

from app import palette

# Machado, Oliveira, Fernandes (2009), severity 1, on linear RGB.
VISION = {
    "normal": np.eye(3),
    "protan": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deutan": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritan": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
XYZ_FROM_RGB = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
JUST_NOTICEABLE = 2.3  # CIE76, Mahy et al. (1994)


def linear(colour: str) -> np.ndarray:
    c = np.array(palette.rgb(colour)) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(rgb_linear: np.ndarray) -> np.ndarray:
    t = XYZ_FROM_RGB @ np.clip(rgb_linear, 0, 1) / (XYZ_FROM_RGB @ np.ones(3))
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def distance(a: str, b: str, vision: str) -> float:
    see = VISION[vision]
    return float(np.linalg.norm(lab(see @ linear(a)) - lab(see @ linear(b))))


def luminance(colour: str) -> float:
    return float(XYZ_FROM_RGB[1] @ linear(colour))


def contrast(a: str, b: str) -> float:
    """WCAG 2 contrast ratio."""
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("vision", VISION)
def test_two_meanings_never_look_alike(vision):
    near = min((distance(palette.ROLES[a], palette.ROLES[b], vision), a, b)
               for a, b in itertools.combinations(palette.ROLES, 2))  # fmt: skip
    assert near[0] > 4.5 * JUST_NOTICEABLE, near


def test_one_colour_has_one_meaning():
    assert len(set(palette.ROLES.values())) == len(palette.ROLES)


@pytest.mark.parametrize("surface", [palette.GROUND, palette.SUNKEN, palette.RAISED])
def test_text_is_readable_on_every_surface(surface):
    assert contrast(palette.TEXT, surface) > 7
    assert contrast(palette.MUTED, surface) > 4.5


@pytest.mark.parametrize("role", [r for r in palette.ROLES if r != "candidate"])
def test_marks_stand_out_from_plots(role):
    assert contrast(palette.ROLES[role], palette.SUNKEN) > 4


def test_age_colours_brighten_with_age_and_saturate():
    shine = [luminance(palette.age_colour(age)) for age in range(1, palette.OLD_TRACK + 1)]
    assert np.all(np.diff(shine) > 0)
    assert palette.age_colour(0) == palette.age_colour(1)
    assert palette.age_colour(10_000) == palette.age_colour(palette.OLD_TRACK)
