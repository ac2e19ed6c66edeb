import dataclasses

import numpy as np
from plane_world import STEP_NS, ref

from vins_core.frontend.ledger import FATES, KEPT, TrackLedger
from vins_core.frontend.state import TrackerState
from vins_core.report import LOSS_REASONS, LossReason


def unit(*v):
    return np.array(v, float) / np.linalg.norm(v, axis=1, keepdims=True)


def ledger(rays):
    tracks = TrackLedger(dataclasses.replace(TrackerState.empty(), next_id=7))
    tracks.image = ref(0)
    tracks.add(np.zeros((len(rays), 2), np.float32), rays)
    return tracks


def test_velocity_is_taken_on_the_plane_before_or_behind_and_zero_across():
    """Of three rays one stays in front, one crosses 90 degrees, one is behind all the time."""
    tracks = ledger(unit([0.1, 0.2, 1.0], [1.0, 0.0, 0.01], [1.0, 0.0, -0.2]))
    tracks.move(ref(1), tracks.uv_px, unit([0.2, 0.2, 1.0], [1.0, 0.0, -0.01], [1.0, 0.1, -0.2]))
    dt_s = STEP_NS * 1e-9
    np.testing.assert_allclose(tracks.velocity, [[0.1 / dt_s, 0.0], [0, 0], [0, -0.5 / dt_s]], rtol=1e-5)


def test_every_fate_is_written_down_with_the_last_position_and_age():
    tracks = ledger(unit(*np.random.default_rng(0).uniform(-1, 1, (5, 3))))
    tracks.uv_px = np.arange(10, dtype=np.float32).reshape(5, 2)
    tracks.drop(np.array([False, True, False, False, False]), LossReason.OUTLIER)
    tracks.move(ref(1), tracks.uv_px + 100, tracks.rays)
    tracks.end(np.array([KEPT, FATES[LossReason.FLOW], KEPT, FATES[LossReason.BORDER]]))
    ids, uv_px, age, fate = tracks.lost()
    assert ids.tolist() == [8, 9, 11] and age.tolist() == [1, 2, 2]
    assert uv_px.tolist() == [[2, 3], [104, 105], [108, 109]]
    assert [LOSS_REASONS[f] for f in fate] == [LossReason.OUTLIER, LossReason.FLOW, LossReason.BORDER]
    assert tracks.ids.tolist() == [7, 10] and tracks.next_id == 12
    assert tracks.count_lost(LossReason.FLOW) == 1 and tracks.count_lost(LossReason.MASK) == 0
