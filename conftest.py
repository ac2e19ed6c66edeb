"""Settings and fixtures for every test."""

import os

for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")  # before numpy is imported: two threads make a window solve ten times slower
os.environ.setdefault("VINSPECT_BACKEND", "numpy")  # nothing is compiled behind a test's back

pytest_plugins = ["chromium", "sample", "looping", "street", "calibrating", "depth_room"]
