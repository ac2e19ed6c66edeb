"""docs/parity.yaml: settings of VINS-Mono that a user can run with."""

from pathlib import Path

from vins_core import params
from vins_core.io.params_yaml import read_params

PARITY = read_params(Path(__file__).parents[2] / "docs" / "parity.yaml")


def test_every_setting_of_parity_differs_from_ours():
    changed = params.changed(params.replace(params.Params(), PARITY))
    assert changed == PARITY


def test_every_switch_of_the_estimator_that_names_a_way_back_is_in_it():
    estimator = ("frontend", "imu", "init", "window", "solver")
    named = {
        key for key, d in params.DECLARATIONS.items() if key.split(".")[0] in estimator and "(parity: off)" in d.doc
    }
    assert named and named <= PARITY.keys()
