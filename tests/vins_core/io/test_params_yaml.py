from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vins_core import params as parameters
from vins_core.errors import OutputError, ParameterError
from vins_core.io.params_yaml import params_yaml, read_params, write_params
from vins_core.params import DECLARATIONS, Declaration, Params


def values(declared: Declaration) -> st.SearchStrategy[Any]:
    if declared.choices:
        return st.sampled_from(declared.choices)
    if declared.type is bool:
        return st.booleans()
    assert declared.low is not None and declared.high is not None
    if declared.type is int:
        return st.integers(int(declared.low), int(declared.high))
    return st.floats(declared.low, declared.high)


@given(st.fixed_dictionaries({}, optional={key: values(d) for key, d in DECLARATIONS.items()}))
def test_what_is_written_is_read_back_to_the_last_bit(
    tmp_path_factory: pytest.TempPathFactory, changes: dict[str, Any]
) -> None:
    params = parameters.replace(Params(), changes)
    file = tmp_path_factory.mktemp("params") / "params.yaml"
    write_params(file, params)
    read = read_params(file)
    assert parameters.replace(Params(), read) == params
    assert read == parameters.changed(params)


def test_only_what_changed_is_written_with_its_meaning() -> None:
    text = params_yaml(parameters.replace(Params(), {"window.keyframe_parallax": 8, "window.loss": "none"}))
    assert text.splitlines() == [
        "window:",
        "  keyframe_parallax: 8.0  # a frame with more mean parallax is a keyframe [px460]",
        "  loss: none  # robust loss on projections",
    ]


def test_what_differs_from_another_run_can_be_written() -> None:
    base = parameters.replace(Params(), {"window.size": 8})
    other = parameters.replace(base, {"window.max_iterations": 4})
    assert "size" not in params_yaml(other, base) and "max_iterations: 4" in params_yaml(other, base)


def test_nothing_changed_is_a_file_that_can_be_read(tmp_path: Path) -> None:
    write_params(tmp_path / "params.yaml", Params())
    assert read_params(tmp_path / "params.yaml") == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("window:\n  sise: 8\n", r"params\.yaml: unknown parameter 'window\.sise'; did you mean window\.size"),
        ("widow:\n  size: 8\n", r"params\.yaml: unknown parameter 'widow\.size'; did you mean window\.size"),
        ("window:\n  size: 800\n", r"params\.yaml: parameter window\.size=800: expected int from 4 to 20"),
        ("window:\n  size: [8]\n", r"params\.yaml: parameter window\.size=\[8\]: expected int"),
        ("window:\n  loss: gemanmcclure\n", r"expected one of cauchy, huber, none"),
        ("window:\n  size:\n", r"parameter window\.size=None"),
        ("window: 8\n", r"params\.yaml: window: 8 is not of the form `section: \{name: value\}`"),
        ("window.size: 8\n", r"is not of the form `section: \{name: value\}`"),
        ("window:\n  size: 8\n  size: 9\n", r"params\.yaml, line 3: .*keep one of them"),
        ("window: [\n", r"params\.yaml, line \d+: not valid YAML"),
        ("", r"params\.yaml: expected YAML"),
        ("!!python/object/apply:os.system ['touch hacked']\n", r"params\.yaml"),
    ],
)
def test_a_wrong_file_gets_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "params.yaml").write_text(text)
    with pytest.raises(ParameterError, match=message):
        read_params(tmp_path / "params.yaml")
    assert [f.name for f in tmp_path.iterdir()] == ["params.yaml"]


def test_a_missing_file_is_named_and_an_existing_one_kept(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"nowhere\.yaml: cannot be read"):
        read_params(tmp_path / "nowhere.yaml")
    write_params(tmp_path / "params.yaml", Params())
    with pytest.raises(OutputError, match="already there"):
        write_params(tmp_path / "params.yaml", Params())
    with pytest.raises(OutputError, match="cannot write"):
        write_params(tmp_path / "no" / "params.yaml", Params())
