from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from .arguments import Json, Run
from .console import print_json, progress_bar

if TYPE_CHECKING:
    from vins_core.record.compare import Comparison, Metrics

Run2 = Positional[Annotated[Path, arg(metavar="RUN2", help="another run, or a fork of the first")]]


def compare(run: Run, run2: Run2, /, json: Json = False) -> None:
    """Show what two runs were given, what came of it, and the first decision that differs."""
    from vins_core.record.compare import compare
    from vins_core.record.reader import RunReader

    with RunReader(run) as first, RunReader(run2) as second, progress_bar("comparing") as report:
        found = compare(first, second, report)
    if json:
        print_json(found)
    else:
        _print(found)


def _print(found: Comparison) -> None:
    rows = [("", found.runs[0].path, found.runs[1].path)]
    rows += [(s.key, _text(s.first), _text(s.second)) for s in found.parameters]
    rows += [(label, _text(a), _text(b)) for label, a, b in _numbers(*found.metrics)]
    widths = [max(len(row[i]) for row in rows) for i in range(2)]
    for name, first, second in rows:
        print(f"{name:>{widths[0]}}  {first:<{widths[1]}}  {second}")
    for s in (*found.calibration, *found.input, *found.environment):
        print(f"differs: {s.key}: {_text(s.first)} against {_text(s.second)}")
    if found.first_number:
        n = found.first_number
        print(f"first number that differs: frame {n.frame}, {n.path}, by {n.largest:.3g}")
    if found.first_difference:
        print(f"first decision that differs: {found.first_difference.sentence}")
    else:
        print(f"no decision differs in {found.frames_compared} frames")


def _numbers(a: Metrics, b: Metrics) -> Iterator[tuple[str, object, object]]:
    for name in ("frames", "poses", "keyframes", "restarts", "landmarks"):
        yield name, getattr(a, name), getattr(b, name)
    measured = any(m.cost and m.cost.depth for m in (a, b))
    for kind in ("visual", "imu", "prior", *(("depth",) if measured else ())):
        yield f"mean {kind} cost", a.cost and getattr(a.cost, kind), b.cost and getattr(b.cost, kind)
    yield "ms per frame", a.ms, b.ms
    for name, label in (("accuracy", ""), ("accuracy_common", " over common poses")):
        x, y = getattr(a, name), getattr(b, name)
        yield f"ATE rmse m{label}", x and x.ate_rmse_m, y and y.ate_rmse_m
        yield f"RPE rmse m{label}", x and x.rpe_rmse_m, y and y.rpe_rmse_m
        yield f"scale{label}", x and x.scale, y and y.scale


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
