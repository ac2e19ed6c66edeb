from pathlib import Path

import pytest
from chromium import browser, open_page, run_folder, serve, served_run
from sample import sample_run

__all__ = ["browser", "open_page", "run_folder", "sample_run", "serve", "served_run"]


@pytest.fixture(autouse=True)
def no_runs_of_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs and layouts of whoever runs the tests are not theirs to see."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
