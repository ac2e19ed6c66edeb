"""Settings of a process that estimates: one thread for OpenCV, and memory that is kept between frames."""

from __future__ import annotations

import ctypes

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # <malloc.h>


def prepare() -> None:
    """Call once before estimating.

    glibc hands every large buffer back to the kernel as soon as it is freed; an image pyramid is then paged in anew
    for each image, which costs a quarter of a frame's time.  Other C libraries have no such switch.
    """
    import cv2

    cv2.setNumThreads(1)
    try:
        libc = ctypes.CDLL(None)
        libc.mallopt(M_MMAP_THRESHOLD, 32 << 20)
        libc.mallopt(M_TRIM_THRESHOLD, 128 << 20)
    except (AttributeError, OSError):
        return
