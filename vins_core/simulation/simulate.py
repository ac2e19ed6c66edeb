"""From a scenario's name to a recording with known truth."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..errors import ParameterError
from ..geometry import se3, so3
from ..io.calibration import Settings
from ..io.messages import GpsMessage, ImageMessage, ImuMessage, Message, TruthMessage
from ..sensors import Calibration, CameraCalibration, DepthCalibration, GpsFix, ImuSamples, Trajectory
from .receiver import START, measure
from .render import Renderer
from .scenarios import SCENARIOS, Interval, Scenario
from .sensors import encode_jpeg, expose, measure_depth, sample_imu
from .trajectory import Motion

T0_NS = 1_700_000_000_000_000_000  # stamp of the first IMU sample
LEAD_S = 0.1  # the IMU begins this long before the first image and ends as long after the last
TRUTH_EVERY = 2  # IMU samples
MAX_DURATION_S = 600.0
IDENTITY = np.eye(4)
IMAGE_TOPICS, IMU_TOPIC, TRUTH_TOPIC = ("/cam0/image_raw", "/cam1/image_raw"), "/imu0", "/groundtruth"
DEPTH_TOPIC, GPS_TOPIC = "/depth0/image_raw", "/gps0"
_IMU_STREAM, _IMAGE_STREAM, _DEPTH_STREAM, _GPS_STREAM = 10, 11, 12, 13  # of the seeded randomness


@dataclass(frozen=True)
class Simulation:
    """A recording that renders its images when they are asked for.  Equal arguments give equal bytes."""

    name: str
    scenario: Scenario
    seed: int
    duration_s: float
    motion: Motion
    imu: ImuSamples  # after gaps
    truth: Trajectory  # of the body, on the IMU's clock, with biases
    image_t_ns: np.ndarray  # (n,) stamps, after dropouts
    calibration: Calibration  # as the user has it: wrong where the scenario says so
    true_calibration: Calibration
    fixes: tuple[GpsFix, ...] = ()
    outlier: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))  # (m,) of the fixes

    @cached_property
    def renderer(self) -> Renderer:
        return Renderer(self.scenario.world(self.seed), self.scenario.rig.camera)

    @property
    def settings(self) -> Settings:
        """What to write beside the recording."""
        note = (
            f"Simulated by vinspect: scenario {self.name}, seed {self.seed}, {self.duration_s:g} s. {self.scenario.doc}"
        )
        return Settings(self.calibration, dict(self.scenario.parameters), (note,))

    def image(self, index: int, camera: int = 0) -> np.ndarray:
        """(rows, columns) uint8."""
        t_ns = int(self.image_t_ns[index]) - T0_NS + round(self.scenario.td_s * 1e9)
        rng = np.random.default_rng([self.seed, _IMAGE_STREAM, t_ns, *([camera] if camera else [])])
        T_b_c = self.scenario.rig.Ts_b_c[camera]
        return expose(self.renderer, self.motion, T_b_c, t_ns * 1e-9, self.scenario.exposure, rng)

    def depth(self, index: int) -> np.ndarray:
        """(rows, columns) uint16 of the depth camera, taken with image `index`; 0 where it sees nothing."""
        assert self.scenario.depth is not None
        t_ns = int(self.image_t_ns[index]) - T0_NS + round(self.scenario.td_s * 1e9)
        body = self.motion.at(np.array([t_ns * 1e-9]))
        T_w_c = se3.from_quaternion_translation(body.q_w_b, body.p_w_b)[0] @ self.scenario.rig.T_b_c
        rng = np.random.default_rng([self.seed, _DEPTH_STREAM, t_ns])
        return measure_depth(self.renderer.depth_m(T_w_c), self.scenario.depth, rng)

    def messages(self) -> Iterator[Message]:
        """Everything in the order of its stamps; at equal stamps truth, IMU, GPS, image, depth."""
        streams: list[Iterator[Message]] = [self._truth_messages(), self._imu_messages(), self._gps_messages()]
        return heapq.merge(*streams, self._image_messages(), key=lambda message: message.t_ns)

    def _truth_messages(self) -> Iterator[Message]:
        truth = self.truth
        assert truth.v_w_b is not None and truth.b_g is not None and truth.b_a is not None
        for row in zip(truth.t_ns.tolist(), truth.p_w_b, truth.q_w_b, truth.v_w_b, truth.b_g, truth.b_a):
            yield TruthMessage(row[0], TRUTH_TOPIC, *row[1:])

    def _imu_messages(self) -> Iterator[Message]:
        for t_ns, gyro, accel in zip(self.imu.t_ns.tolist(), self.imu.gyro_rad_s, self.imu.accel_m_s2):
            yield ImuMessage(t_ns, IMU_TOPIC, gyro, accel)

    def _gps_messages(self) -> Iterator[Message]:
        for f in self.fixes:
            place = f.latitude_deg, f.longitude_deg, f.altitude_m
            yield GpsMessage(f.t_ns, GPS_TOPIC, *place, f.covariance_enu_m2, f.status)

    def _image_messages(self) -> Iterator[Message]:
        quality = self.scenario.exposure.jpeg_quality
        for index, t_ns in enumerate(self.image_t_ns.tolist()):
            for camera in range(len(self.scenario.rig.Ts_b_c)):
                data = encode_jpeg(self.image(index, camera), quality)
                yield ImageMessage(t_ns, IMAGE_TOPICS[camera], "jpeg", data)
            if self.scenario.depth:
                yield ImageMessage(t_ns, DEPTH_TOPIC, "16UC1", self.depth(index))


def simulate(name: str, seed: int = 1, duration_s: float | None = None) -> Simulation:
    """The scenario `name`, with all randomness and the room's pictures from `seed`.

    A shorter `duration_s` cuts the same recording short.  Raises ParameterError.
    """
    if name not in SCENARIOS:
        raise ParameterError(f"unknown scenario {name!r}; expected one of {', '.join(SCENARIOS)}")
    return build(name, SCENARIOS[name], seed, duration_s)


def build(name: str, scenario: Scenario, seed: int = 1, duration_s: float | None = None) -> Simulation:
    """A scenario of one's own, e.g. `dataclasses.replace(SCENARIOS["room_loop"], td_s=0.01)`."""
    duration_s = scenario.duration_s if duration_s is None else duration_s
    if not 2 * LEAD_S < duration_s <= MAX_DURATION_S:
        raise ParameterError(
            f"duration {duration_s:g} s of scenario {name!r}: expected more than {2 * LEAD_S:g} s and at most "
            f"{MAX_DURATION_S:g} s"
        )
    if seed < 0:
        raise ParameterError(f"seed {seed}: expected a whole number of 0 or more")
    motion = Motion.from_channels(scenario.motion(scenario.rig), duration_s, scenario.rig.q_f_b)

    imu_t_ns = _stamps(0.0, duration_s, scenario.imu.rate_hz)
    imu, biases = sample_imu(
        motion, imu_t_ns, scenario.imu, scenario.gravity_m_s2, np.random.default_rng([seed, _IMU_STREAM])
    )
    exact = motion.at(imu_t_ns * 1e-9)
    image_t_ns = _stamps(LEAD_S, duration_s - LEAD_S, scenario.exposure.rate_hz)
    image_t_ns = image_t_ns[_outside(image_t_ns, scenario.image_dropouts)] - round(scenario.td_s * 1e9)
    heard = imu[_outside(imu_t_ns, scenario.imu_gaps)]
    every = slice(None, None, TRUTH_EVERY)
    return Simulation(
        name,
        scenario,
        seed,
        duration_s,
        motion,
        ImuSamples(heard.t_ns + T0_NS, heard.gyro_rad_s, heard.accel_m_s2),
        Trajectory(
            imu_t_ns[every] + T0_NS,
            exact.p_w_b[every],
            exact.q_w_b[every],
            exact.v_w_b[every],
            biases.b_g_rad_s[every],
            biases.b_a_m_s2[every],
        ),
        image_t_ns + T0_NS,
        _believed(scenario),
        _calibration(scenario, scenario.td_s),
        *_fixes(scenario, motion, duration_s, seed),
    )


def _fixes(scenario: Scenario, motion: Motion, duration_s: float, seed: int) -> tuple[tuple[GpsFix, ...], np.ndarray]:
    receiver = scenario.gps
    if receiver is None:
        return (), np.zeros(0, bool)
    t_s = _stamps(receiver.first_s, duration_s, receiver.rate_hz) * 1e-9
    body = motion.at(t_s)
    antenna_w = body.p_w_b + so3.rotate(body.q_w_b, np.array(receiver.p_b_gps))
    noise, gross = (np.random.default_rng([seed, _GPS_STREAM, part]) for part in range(2))
    fixes, outlier = measure(receiver, t_s, antenna_w, START, noise, gross)
    return tuple(replace(fix, t_ns=fix.t_ns + T0_NS) for fix in fixes), outlier


def _stamps(start_s: float, end_s: float, rate_hz: float) -> np.ndarray:
    """Relative stamps in ns from `start_s` on, none after `end_s`."""
    count = int(np.floor((end_s - start_s) * rate_hz + 1e-6)) + 1
    return np.round((start_s + np.arange(count) / rate_hz) * 1e9).astype(np.int64)


def _outside(t_ns: np.ndarray, intervals: tuple[Interval, ...]) -> np.ndarray:
    inside = [(t_ns >= round(a * 1e9)) & (t_ns < round(b * 1e9)) for a, b in intervals]
    return ~np.any(inside, axis=0) if inside else np.ones(len(t_ns), bool)


def _believed(scenario: Scenario) -> Calibration:
    """What the user has."""
    error = np.eye(4)
    error[:3, :3] = so3.to_matrix(so3.exp(np.radians(scenario.believed_rotation_error_deg)))
    shift = np.eye(4)
    shift[:3, 3] = scenario.believed_translation_error_m
    calibration = _calibration(scenario, scenario.believed_td_s, shift, error)
    if scenario.believed_extrinsics == "unknown":
        cameras = tuple(replace(camera, T_b_c=np.eye(4)) for camera in calibration.cameras)
        calibration = replace(calibration, cameras=cameras)
    return replace(calibration, estimate_td=scenario.estimate_td, extrinsics=scenario.believed_extrinsics)


def _calibration(
    scenario: Scenario, td_s: float, before: np.ndarray = IDENTITY, behind: np.ndarray = IDENTITY
) -> Calibration:
    """Each T_b_c is `before` @ the true one @ `behind`.  A readout not stamped with its first row is not in there."""
    exposure = scenario.exposure
    readout_s = exposure.readout_s if exposure.stamped_row == 0.0 else 0.0
    cameras = tuple(
        CameraCalibration(f"cam{i}", scenario.rig.camera, before @ T_b_c @ behind, IMAGE_TOPICS[i], readout_s=readout_s)
        for i, T_b_c in enumerate(scenario.rig.Ts_b_c)
    )
    if scenario.depth:
        seen = scenario.depth
        depth = DepthCalibration(DEPTH_TOPIC, seen.scale_m, seen.min_m, seen.max_m)
        cameras = (replace(cameras[0], depth=depth), *cameras[1:])
    calibration = Calibration(cameras, scenario.imu.noise, scenario.gravity_m_s2, td_s, IMU_TOPIC)
    if scenario.gps:
        calibration = replace(calibration, gps_topic=GPS_TOPIC, p_b_gps=scenario.gps.p_b_gps)
    return calibration
