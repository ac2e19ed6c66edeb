"""Where the files that come with the program lie: beside the packages in a checkout, else below the environment."""

from __future__ import annotations

import sys
from pathlib import Path


def shipped(name: str) -> Path:
    """The folder `layouts` or `sample_data`."""
    checkout = Path(__file__).resolve().parent.parent / name
    return checkout if checkout.is_dir() else Path(sys.prefix) / "share" / "vinspect" / name
