"""The pages say what the program does: generated ones are up to date, and what the others name exists."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

from vins_core import params
from vins_core.io import own_yaml, vins_yaml
from vins_core.io.yaml_file import Keys, read_yaml
from vins_core.params import DECLARATIONS

DOCS = Path(__file__).parents[2] / "docs"
PAGES = [*sorted(DOCS.glob("*.md")), DOCS.parent / "README.md"]
SECTIONS = {key.split(".")[0] for key in DECLARATIONS}


def text_of(name: str) -> str:
    return (DOCS / name).read_text("utf-8")


def test_the_page_of_parameters_is_up_to_date() -> None:
    made = runpy.run_path(str(DOCS / "make_parameters.py"))["page"]()
    assert text_of("parameters.md") == made, "run `python docs/make_parameters.py`"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_and_pictures_are_there(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text("utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_parameters_that_a_page_names_exist(page: Path) -> None:
    named = re.findall(rf"(?<![\w/-])((?:{'|'.join(sorted(SECTIONS))})\.\w+)", page.read_text("utf-8"))
    others = {f"{section}.{rest}" for section in SECTIONS for rest in ("name", "md")}  # placeholders and pages
    assert set(named) - others <= DECLARATIONS.keys()


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_assignments_that_a_page_shows_are_accepted(page: Path) -> None:
    shown = dict(re.findall(r"--set (\w+\.\w+)=([\w.]+)", page.read_text("utf-8")))
    params.replace(params.Params(), shown)


def test_every_key_of_a_vins_config_is_explained() -> None:
    keys = {*vins_yaml.TUNING, *vins_yaml.ALWAYS_IGNORED, *vins_yaml.IGNORED_WHEN_ON, *vins_yaml.SILENT}
    page = text_of("configs.md")
    assert [key for key in keys if not re.search(rf"`{key}\b", page)] == []
    rows = dict(re.findall(r"^\| `(\w+)` \| `(\w+\.\w+)` \|", page, re.MULTILINE))
    assert rows == {key: parameter for key, (parameter, _) in vins_yaml.TUNING.items()}


def test_the_calibration_that_the_page_shows_can_be_read(tmp_path: Path) -> None:
    shown = next(b for b in re.findall(r"```yaml\n(.*?)```", text_of("recordings.md"), re.DOTALL) if "cameras" in b)
    path = tmp_path / "calibration.yaml"
    path.write_text(shown, "utf-8")
    calibration, overrides, notes = own_yaml.read(Keys(path, read_yaml(path)))
    assert calibration.imu_topic == "/imu0" and overrides == {"window.max_iterations": 8} and notes == ()
