"""The dark palette: one colour, one meaning, in the page and in the 3D view alike.

The hues come from Okabe and Ito (2008), moved apart on a dark ground.  tests/app/test_palette.py measures their
distances as people with protanopia, deuteranopia and tritanopia see them; where two come near each other
(estimate and ok to a tritanope) the marks also differ in shape, never in colour alone.
"""

from __future__ import annotations

import cv2
import numpy as np

ESTIMATE = "#56B4E9"  # this run: trajectory, window, triangulated landmarks, visual factors
FORK = "#CA60A7"  # another run or a fork of this one
TRUTH = "#E6E9EE"  # ground truth
IMU = "#E69F00"  # everything inertial
OK = "#2BC48A"  # a gate that passed
BAD = "#F0603A"  # a gate that failed, an outlier
SELECTION = "#F0E442"  # what the user picked, and the playhead
PRIOR = "#BF4FFA"  # what marginalisation left behind
CANDIDATE = "#6A6C72"  # not decided yet: landmarks without depth, a window that fills
UNTRACKED = "#E1A5C3"  # a track the optical flow could not follow

ROLES = {
    "estimate": ESTIMATE,
    "fork": FORK,
    "truth": TRUTH,
    "imu": IMU,
    "ok": OK,
    "bad": BAD,
    "selection": SELECTION,
    "prior": PRIOR,
    "candidate": CANDIDATE,
    "untracked": UNTRACKED,
}

# Surfaces and text carry no meaning.
GROUND = "#242424"  # a viser panel
SUNKEN = "#1A1D22"  # plots and bars
RAISED = "#30353D"  # chips
LINE = "#363B44"
TEXT = "#D7DBE0"
MUTED = "#98A1AE"
STRONG = "#FFFFFF"

OLD_TRACK = 40
"""Tracks of this age in images, and older ones, share the last colour."""


def rgb(colour: str) -> tuple[int, int, int]:
    """`#RRGGBB` -> (r, g, b), each 0..255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def _hex_ramp(colormap: int, first: int, n: int) -> tuple[str, ...]:
    """`n` colours of an OpenCV colour map, from entry `first` of 256 to the last."""
    entries = np.linspace(first, 255, n).astype(np.uint8)[None]
    bgr = cv2.applyColorMap(entries, colormap)[0]
    return tuple(f"#{r:02x}{g:02x}{b:02x}" for b, g, r in bgr.tolist())


AGE_RAMP = _hex_ramp(cv2.COLORMAP_CIVIDIS, 70, OLD_TRACK)
"""Cividis without its darkest part: index 0 is a new track, the last one `OLD_TRACK` images or older."""


def age_colour(age: int) -> str:
    return AGE_RAMP[min(max(age, 1), OLD_TRACK) - 1]
