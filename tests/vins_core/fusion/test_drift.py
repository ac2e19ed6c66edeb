import numpy as np
from gps_run import settings

from vins_core.fusion.drift import SIZE, Increment, between, compose, nothing, stack
from vins_core.geometry import so3


def composed(parts: list[Increment]) -> Increment:
    out = nothing()
    for part in parts:
        out = compose(out, part)
    return out


def path(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, 3)) * [1.0, 1.0, 0.1]


def assert_same(a: Increment, b: Increment) -> None:
    for name in ("moved_o", "stretched_o", "kept", "covariance"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-10, atol=1e-14)


def test_the_order_of_composing_does_not_matter():
    gps = settings()
    a, b, c = (between(gps, way, 0.1) for way in path(3))
    assert_same(compose(compose(a, b), c), compose(a, compose(b, c)))
    assert_same(compose(nothing(), a), a)
    assert_same(compose(a, nothing()), a)


def test_many_at_once_are_the_same_as_one_by_one():
    gps, ways = settings(), path(5)
    together = between(gps, ways, np.full(5, 0.1))
    assert_same(together, stack([between(gps, way, 0.1) for way in ways]))
    assert_same(compose(together[:2], together[2:4]), stack([compose(together[k], together[k + 2]) for k in range(2)]))


def test_covariance_is_that_of_many_random_walks():
    """Errors drawn frame by frame, applied to real poses, spread as the composed covariance says."""
    gps = settings(dof="6", scale_sigma=0.02, scale_length_m=50.0, yaw_walk_deg=0.2, tilt_walk_deg=0.1)
    ways = np.tile([[1.0, 0.0, 0.0], [0.8, 0.6, 0.0]], (20, 1))
    steps = between(gps, ways, np.full(40, 0.1))
    total = composed([steps[k] for k in range(40)])
    rng, n = np.random.default_rng(0), 20_000
    p, q, s = np.zeros((n, 3)), np.tile([1.0, 0, 0, 0], (n, 1)), np.zeros(n)
    for k in range(40):
        noise = rng.normal(size=(n, SIZE)) * np.sqrt(np.diagonal(steps.covariance[k]))
        p = p + so3.rotate(q, (1 + s)[:, None] * ways[k] + noise[:, :3])
        q, s = so3.retract(q, noise[:, 3:6]), steps.kept[k] * s + noise[:, 6]
    drawn = np.cov(np.column_stack([p, so3.log(q), s]).T)
    sigma = np.sqrt(np.diagonal(total.covariance))
    np.testing.assert_allclose(drawn / np.outer(sigma, sigma), total.covariance / np.outer(sigma, sigma), atol=0.05)
    np.testing.assert_allclose(p.mean(0), total.moved_o, atol=5 * sigma[:3].max() / np.sqrt(n) + 0.01)


def test_error_of_the_path_does_not_depend_on_the_frame_rate_and_that_of_frames_does():
    def heading_variance(frames: int, **changes) -> float:
        ways = np.tile([100.0 / frames, 0.0, 0.0], (frames, 1))
        steps = between(settings(**changes), ways, np.full(frames, 10.0 / frames))
        return float(composed([steps[k] for k in range(frames)]).covariance[5, 5])

    np.testing.assert_allclose(heading_variance(50), heading_variance(200), rtol=1e-9)
    np.testing.assert_allclose(heading_variance(200, noise="frame"), 4 * heading_variance(50, noise="frame"))


def test_odometry_at_rest_hardly_drifts():
    parked = composed([between(settings(), np.zeros(3), 0.1)] * 6000)  # 10 minutes
    assert np.sqrt(parked.covariance[0, 0]) < 0.05
    assert np.rad2deg(np.sqrt(parked.covariance[5, 5])) < 0.1
