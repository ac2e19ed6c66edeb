"""How a pose-graph optimisation grows: `python tests/benchmarks/pose_graph.py [--large] [--dof 6] [--splu]`.

Keyframes on laps of 1/25 of the run, five ties each.  Loops lead back to the same place of an earlier lap, spread over
the whole run; `any` joins keyframes anywhere, which no building does and which fills in most.  Each case runs in a
process of its own.  CPU seconds count on a machine that is shared; memory is the process' peak above its start.
`--splu` adds one factorisation of the same matrix by SuperLU with minimum degree, 4 columns a keyframe.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import multiprocessing
import resource
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

CASES = ((1_000, 50, "laps"), (1_000, 200, "laps"), (10_000, 500, "laps"), (10_000, 2_000, "laps"),
         (10_000, 500, "any"), (10_000, 2_000, "any"))  # fmt: skip
LARGE = ((100_000, 5_000, "laps"), (100_000, 20_000, "laps"))


def graph(n: int, n_loops: int, kind: str):
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))
    import pose_graph_world as world

    from vins_core.geometry import poses

    lap = n // 25
    made = world.laps(n, lap, n_loops, step_m=0.001, turn_deg=0.01)
    if kind == "laps":
        return made.graph
    rng = np.random.default_rng(1)
    later = rng.choice(np.arange(100, n), n_loops, replace=False)
    earlier = (rng.random(n_loops) * (later - 50)).astype(int)
    measured = poses.between(made.truth[earlier], made.truth[later])
    return world.build(made.graph.T_vio, np.stack([earlier, later], 1), measured)


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measure(case: tuple[int, int, str], dof: str, with_splu: bool) -> dict:
    from vins_core import params
    from vins_core.pose_graph import levenberg_marquardt as lm
    from vins_core.pose_graph.optimize import optimize
    from vins_core.pose_graph.problem import assemble

    settings = params.PoseGraph(dof=dof, sequential_edges=5)
    optimize(settings, graph(200, 10, "laps"))  # imports, residuals written and differentiated
    made, before = graph(*case), peak_mb()
    clocks = time.perf_counter(), time.process_time()
    _, report = optimize(settings, made)
    wall, cpu = time.perf_counter() - clocks[0], time.process_time() - clocks[1]
    row = {"wall": wall, "cpu": cpu, "iterations": len(report.iterations), "mb": peak_mb() - before, "splu": np.nan}
    row["five"] = five(replace(settings, max_iterations=5, function_tolerance=0.0), made)
    row["share"] = report.after.total / report.before.total
    if with_splu:
        problem = assemble(settings, made)
        row["splu"] = splu(lm.Linearizer(problem), problem)
    return row


def five(settings, made) -> float:
    """CPU seconds of exactly five iterations, which is what VINS does."""
    from vins_core.pose_graph.optimize import optimize

    start = time.process_time()
    optimize(settings, made)
    return time.process_time() - start


def splu(linearizer, problem) -> float:
    import scipy.sparse as sp
    from scipy.sparse.linalg import splu as factorize

    system, m, t = linearizer.linearize(problem.nodes), len(problem.free), problem.variant.dof
    i = np.concatenate([np.arange(m), linearizer.pair_i, linearizer.pair_j])
    j = np.concatenate([np.arange(m), linearizer.pair_j, linearizer.pair_i])
    H = np.concatenate([system.diagonal, system.off_diagonal, system.off_diagonal.transpose(0, 2, 1)])
    order = np.lexsort((j, i))
    start = np.searchsorted(i[order], np.arange(m + 1))
    matrix = sp.bsr_matrix((H[order], j[order], start), shape=(m * t, m * t)).tocsc()
    clock = time.process_time()
    factorize(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return time.process_time() - clock


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--large", action="store_true", help="100,000 keyframes too: minutes and gigabytes")
    parser.add_argument("--dof", choices=("4", "6"), default="4")
    parser.add_argument("--splu", action="store_true")
    args = parser.parse_args()
    print(
        f"{'keyframes':>9} {'loops':>6} {'kind':4} {'iterations':>10} {'wall s':>7} {'CPU s':>7} {'5 it. CPU s':>11} "
        f"{'MB':>6} {'cost left':>9} {'one splu s':>10}"
    )
    context = multiprocessing.get_context("spawn")
    for case in CASES + (LARGE if args.large else ()):
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            r = pool.submit(measure, case, args.dof, args.splu).result()
        print(
            f"{case[0]:9d} {case[1]:6d} {case[2]:4} {r['iterations']:10d} {r['wall']:7.2f} {r['cpu']:7.2f} "
            f"{r['five']:11.2f} {r['mb']:6.0f} {r['share']:9.1%} {r['splu']:10.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
