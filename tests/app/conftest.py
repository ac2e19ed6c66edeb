from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def no_runs_of_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs and layouts of whoever runs the tests are not theirs to see."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
