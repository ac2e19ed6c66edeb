"""What the window makes of loops, and what that costs.

    python tests/benchmarks/relocalization.py RUN [--set section.name=value]

Repeats the loop stage over the keyframes of a record (place_recognition.py), then every solve from the first accepted
loop on with the requests that would be alive, at most 0, 1, 2, 4 and 8 at a time, the newest first.  Prints how far
relative poses are from ground truth, by PnP alone and as the last solve had them, whether the covariance tells the
truth about that (squared error in its units: 6 on average), and the milliseconds of the solve.  Nothing is asserted.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from place_recognition import keyframes_of, true_poses

from vins_core import params as parameters
from vins_core.arrival import receive
from vins_core.factors.prior import difference_poses
from vins_core.geometry import poses
from vins_core.loop import step
from vins_core.loop.relocalize import RelocalisationRequest, recheck, request
from vins_core.params import Params
from vins_core.process import prepare
from vins_core.record.reader import RunReader
from vins_core.report import LoopCandidate, RelocalizationReport, Timings, all_pass
from vins_core.solver import backend
from vins_core.whatif import recorded_tracks
from vins_core.window.step import solve_window

AT_ONCE = (0, 1, 2, 4, 8)
NEAR_M, NEAR_DEG = 0.05, 1.0
"""What a relative pose should be good for."""


def over_run(folder: Path, settings: list[str]) -> None:
    prepare()
    params = parameters.replace(Params(), dict(s.split("=", 1) for s in settings))
    with RunReader(folder) as run:
        keyframes, truth, state, _ = keyframes_of(run, params)
        loops: list[LoopCandidate] = []
        for keyframe in keyframes:
            found = step.detect(params.loop, state, keyframe).accepted
            state = step.remember(state, keyframe)
            loops += [found] if found else []
        if not loops:
            raise SystemExit("no loop was accepted")
        T_true = true_poses(keyframes, truth)
        asked = [request(c, keyframes[c.query], keyframes[c.match]) for c in loops]
        print(f"{len(keyframes)} keyframes, {len(loops)} loops\n\n            error, median / 95 % / worst")
        _print_errors("PnP alone", loops, T_true)
        with backend.using(backend.recorded(run.header.backend)):
            for n in AT_ONCE:
                answers, ms = _repeat(run, params, asked, n)
                if n:
                    _print_errors(f"{n} at once", answers, T_true)
                    failed = sum(not all_pass(recheck(params.loop, a)) for a in answers)
                    print(f"            {len(asked) - len(answers)} never refined, {failed} fail a gate afterwards")
                print(f"            solve {ms['solve']:.2f} ms, answers {ms.get('relocalize', 0.0):.2f} ms (median)")


def _repeat(
    run: RunReader, params: Params, asked: list[RelocalisationRequest], n: int
) -> tuple[list[RelocalizationReport], Timings]:
    """The last answer to each request when at most n are alive, and medians over frames."""
    answers: dict[int, RelocalizationReport] = {}
    times: list[Timings] = []
    for k in range(asked[0].frame + 2, len(run)):
        alive = [r for r in asked if r.frame < k - 1][-n:] if n else []
        ms: Timings = {}
        for answer in _solve(run, params, k, tuple(alive), ms):
            answers[answer.query] = answer
        times += [ms] if "solve" in ms else []
    return list(answers.values()), {
        s: float(np.median([t.get(s, 0.0) for t in times])) for s in ("solve", "relocalize")
    }


def _solve(
    run: RunReader, params: Params, k: int, requests: tuple[RelocalisationRequest, ...], ms: Timings
) -> Iterator[RelocalizationReport]:
    calibration = run.header.calibration
    arrival = receive(params, calibration, run.state(k - 1), run.packet(k), recorded_tracks(run, k, params), {})
    if arrival.ready:
        yield from solve_window(params, arrival.calibration, arrival.state.window, ms, requests).relocalizations


def _print_errors(name: str, found: list, T_true: np.ndarray) -> None:
    true = np.array([poses.between(T_true[c.match], T_true[c.query]) for c in found])
    d = difference_poses(true, np.array([c.T_match_query for c in found]))
    m, deg = np.linalg.norm(d[:, :3], axis=1), np.degrees(np.linalg.norm(d[:, 3:], axis=1))
    squared = [e @ np.linalg.solve(c.covariance, e) for e, c in zip(d, found) if c.covariance is not None]
    told = (" / ".join(f"{v:.{digits}f}" for v in np.percentile(e, (50, 95, 100))) for e, digits in ((m, 4), (deg, 3)))
    far = int(np.count_nonzero((m > NEAR_M) | (deg > NEAR_DEG)))
    print(f"{name:11s} {next(told)} m, {next(told)} deg; {far} beyond {NEAR_M} m or {NEAR_DEG} deg; "
          f"in units of the covariance {np.mean(squared):.1f}")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="section.name=value")
    args = parser.parse_args()
    over_run(args.run, args.set)


if __name__ == "__main__":
    main()
