import numpy as np
import pytest

from vins_core.factors.robust import Loss

LOSSES = [Loss("none"), Loss("cauchy", 1.0), Loss("cauchy", 2.5), Loss("huber", 1.0), Loss("huber", 0.3)]
S = np.array([0.0, 1e-6, 0.05, 0.5, 2.0, 30.0, 1e4])


@pytest.mark.parametrize("loss", LOSSES, ids=str)
def test_weight_squared_is_the_derivative_of_rho(loss):
    s = S[1:]
    h = 1e-5 * s
    numeric = (loss.rho(s + h) - loss.rho(s - h)) / (2 * h)
    np.testing.assert_allclose(loss.weight(s) ** 2, numeric, rtol=1e-6)


@pytest.mark.parametrize("loss", LOSSES, ids=str)
def test_small_residuals_are_untouched_and_large_ones_count_less(loss):
    assert loss.rho(S)[0] == 0 and loss.weight(S)[0] == 1
    assert loss.rho(S[1:2]) == pytest.approx(S[1], rel=1e-4)
    assert (loss.rho(S) <= S * (1 + 1e-15)).all()
    assert (np.diff(loss.rho(S)) > 0).all() and (np.diff(loss.weight(S)) <= 0).all()
