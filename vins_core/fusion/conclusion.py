"""What a run knows in the end: all its frames held to all its fixes at once (smooth.py), and the live poses beside it.

Between two stretches of odometry, when the estimator began anew, nothing is known of the motion: each is smoothed by
itself, in the one frame `e` of the run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import RunError
from ..record.header import RunHeader
from ..record.reader import RunReader
from ..report import FixVerdict, FrameSummary
from ..sensors import Calibration, GpsFix, Trajectory
from .available import antenna, settings_of, time_of
from .geodesy import EnuFrame
from .smooth import Smoothed, smooth


@dataclass(frozen=True)
class FinalTrack:
    """The final trajectory in `e`, east-north-up at `origin`, of the stretches that could be aligned.

    Fields are those of `Smoothed`, one stretch after the other; fixes are of the antenna.
    """

    origin: np.ndarray | None  # (3,) latitude, longitude in degrees, altitude in metres; None without a stretch
    stretch: np.ndarray  # (n,) int64, running number
    frame: np.ndarray  # (n,) int64
    t_ns: np.ndarray  # (n,) int64, of the poses, on the clock of IMU and fixes
    T_e_b: np.ndarray  # (n, 7)
    covariance: np.ndarray  # (n, 6, 6)
    scale: np.ndarray  # (n,)
    scale_sigma: np.ndarray  # (n,)
    fix_t_ns: np.ndarray  # (m,) int64
    fix_used: np.ndarray  # (m,) bool
    fix_z_e: np.ndarray  # (m, 3), NaN for those that failed before they had a place
    fix_chi2: np.ndarray  # (m,) against all others, NaN likewise
    notes: tuple[str, ...]  # why a stretch is missing


@dataclass(frozen=True)
class _Stretch:
    """Consecutive frames of one odometry."""

    frame: np.ndarray  # (n,)
    t_ns: np.ndarray  # (n,) of the poses
    T_o_b: np.ndarray  # (n, 7)
    fixes: tuple[GpsFix, ...]


def final_track(run: RunReader) -> FinalTrack:
    """As kept when the run ended, else from the frames it holds.  Raises RunError for a run without GPS fusion."""
    if not has_fixes(run.summaries):
        raise RunError(f"{run.path} has no GPS fusion: {_why_not(run.header, run.summaries)}")
    return run.final_track or smooth_run(run.header, run.summaries)


def global_trajectory(run: RunReader, live: bool = False) -> Trajectory:
    """Poses in `e` at their times on the IMU's clock: final, or live, each as it was right after its own frame.

    Raises RunError when there are none.
    """
    final = final_track(run)
    if not live:
        if not len(final.t_ns):
            raise RunError(f"{run.path} has no final GPS trajectory: {'; '.join(final.notes)}")
        return Trajectory(final.t_ns, final.T_e_b[:, :3], final.T_e_b[:, 3:])
    calibration = run.header.calibration
    rows = [
        (time_of(calibration, s.t_ns, s.pose), s.gps.T_e_b)
        for s in run.summaries
        if s.pose is not None and s.gps is not None and s.gps.T_e_b is not None
    ]
    if not rows:
        raise RunError(
            f"{run.path} has no live GPS poses: its fixes never counted; `vinspect open {run.path}` shows why"
        )
    T = np.array([T for _, T in rows])
    return Trajectory(np.array([t for t, _ in rows], np.int64), T[:, :3], T[:, 3:])


def has_fixes(summaries: Sequence[FrameSummary]) -> bool:
    """Whether any fix was taken in."""
    return any(s.gps is not None and s.gps.arrived for s in summaries)


def smooth_run(header: RunHeader, summaries: Sequence[FrameSummary]) -> FinalTrack:
    """The final trajectory of the frames so far, by the parameters of the last."""
    settings = settings_of(header.params.gps, header.calibration)
    p_b_gps = antenna(settings, header.calibration)
    if p_b_gps is None:  # a fork no longer says where the antenna is
        return _join([], ("GPS: no final trajectory, since gps.lever_arm is on and p_b_gps not known",))
    origins = (s.gps.origin for s in summaries if s.gps is not None and s.gps.origin is not None)
    first = next(origins, None)
    origin = None if first is None else EnuFrame(*first.tolist())
    found: list[tuple[_Stretch, Smoothed]] = []
    notes = []
    for stretch in _stretches(header.calibration, summaries):
        smoothed = smooth(settings, p_b_gps, stretch.t_ns, stretch.T_o_b, stretch.fixes, origin)
        if isinstance(smoothed, str):
            span = f"{stretch.frame[0]} to {stretch.frame[-1]}"
            notes.append(f"GPS: frames {span} are not in the final trajectory: {smoothed}")
        else:
            found.append((stretch, smoothed))
    return _join(found, tuple(notes))


def _stretches(calibration: Calibration, summaries: Sequence[FrameSummary]) -> Iterator[_Stretch]:
    frames: list[int] = []
    times: list[int] = []
    poses: list[np.ndarray] = []
    fixes: list[GpsFix] = []

    def taken() -> Iterator[_Stretch]:
        if frames:
            yield _Stretch(np.array(frames, np.int64), np.array(times, np.int64), np.array(poses), tuple(fixes))
        for rows in (frames, times, poses, fixes):
            rows.clear()

    for s in summaries:
        if s.pose is None or s.gps is None:
            yield from taken()
            continue
        t_ns = time_of(calibration, s.t_ns, s.pose)
        if times and t_ns <= times[-1]:
            yield from taken()
        frames.append(s.frame)
        times.append(t_ns)
        poses.append(np.concatenate([s.pose.p_w_b, s.pose.q_w_b]))
        fixes += s.gps.arrived
    yield from taken()


def _join(found: list[tuple[_Stretch, Smoothed]], notes: tuple[str, ...]) -> FinalTrack:
    def rows(name: str, shape: tuple[int, ...], dtype: type = float) -> np.ndarray:
        return np.concatenate([np.zeros((0, *shape), dtype), *(getattr(s, name) for _, s in found)])

    fixes = [f for _, s in found for f in s.fixes]
    chi2 = [next((g.value for g in f.gates if g.name == "chi2"), None) for f in fixes]
    return FinalTrack(
        origin=found[0][1].origin.coordinates if found else None,
        stretch=np.repeat(np.arange(len(found)), [len(s.t_ns) for _, s in found]).astype(np.int64),
        frame=np.concatenate([np.zeros(0, np.int64), *(stretch.frame for stretch, _ in found)]),
        t_ns=rows("t_ns", (), np.int64),
        T_e_b=rows("T_e_b", (7,)),
        covariance=rows("covariance", (6, 6)),
        scale=rows("scale", ()),
        scale_sigma=rows("scale_sigma", ()),
        fix_t_ns=np.array([f.t_ns for f in fixes], np.int64),
        fix_used=np.array([f.verdict is FixVerdict.USED for f in fixes], bool),
        fix_z_e=np.array([np.full(3, np.nan) if f.z_e is None else f.z_e for f in fixes]).reshape(-1, 3),
        fix_chi2=np.array([np.nan if c is None else c for c in chi2], float),
        notes=notes,
    )


def _why_not(header: RunHeader, summaries: Sequence[FrameSummary]) -> str:
    if not header.calibration.gps_topic:
        return "its recording has no fixes"
    if not header.params.gps.enabled:
        return "it was made with gps.enabled=off"
    if antenna(header.params.gps, header.calibration) is None:
        return "the calibration does not say where the antenna is (p_b_gps; or --set gps.lever_arm=off)"
    if not any(s.pose for s in summaries):
        return "it never initialised"
    return "no fix came while it had a pose"
