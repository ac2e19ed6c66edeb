"""The bundled sample is what its README says."""

from pathlib import Path

import numpy as np

from vins_core.io.calibration import read_calibration
from vins_core.io.messages import ImageMessage, ImuMessage
from vins_core.io.recording import open_recording
from vins_core.simulation import simulate

SAMPLE = Path(__file__).parents[3] / "sample_data"
BAGS = {"ros1": SAMPLE / "room_loop.bag", "mcap": SAMPLE / "room_loop_mcap"}


def test_both_bags_hold_the_same_messages_and_together_less_than_20_mb():
    def content(bag: Path) -> list[tuple]:
        with open_recording(bag) as recording:
            return [
                (m.t_ns, m.data if isinstance(m, ImageMessage) else m.accel_m_s2.tobytes() + m.gyro_rad_s.tobytes())
                for m in recording.messages()
                if isinstance(m, ImageMessage | ImuMessage)
            ]

    assert content(BAGS["ros1"]) == content(BAGS["mcap"])
    assert sum(f.stat().st_size for f in SAMPLE.rglob("*") if f.is_file()) < 20e6


def test_both_bags_hold_the_truth_of_the_scenario():
    truth = simulate("room_loop", 1, 28.0).truth
    for bag in BAGS.values():
        with open_recording(bag) as recording:
            recorded = recording.truth()
        assert recorded is not None
        np.testing.assert_array_equal(recorded.t_ns, truth.t_ns)
        np.testing.assert_allclose(recorded.p_w_b, truth.p_w_b, atol=1e-9)
        np.testing.assert_allclose(recorded.q_w_b, truth.q_w_b, atol=1e-9)


def test_the_calibration_beside_each_bag_is_the_scenario_s():
    believed = simulate("room_loop", 1, 28.0).settings
    for name in ("room_loop.yaml", "room_loop_mcap.yaml"):
        settings = read_calibration([SAMPLE / name])
        assert settings.calibration.cameras[0].model == believed.calibration.cameras[0].model
        np.testing.assert_allclose(
            settings.calibration.cameras[0].T_b_c, believed.calibration.cameras[0].T_b_c, atol=1e-12
        )
        assert settings.calibration.noise == believed.calibration.noise
        assert settings.overrides == believed.overrides
