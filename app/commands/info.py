from __future__ import annotations

from typing import TYPE_CHECKING

from .arguments import Calibrations, Json, Recording
from .console import print_json, progress_bar

if TYPE_CHECKING:
    from vins_core.io.inspect import RecordingInfo
    from vins_core.io.modes import ModeInfo

SHOWN = 20
"""Anomalies printed; JSON has more."""
PIPED_WIDTH = 200


def info(recording: Recording, /, calib: Calibrations = (), json: Json = False) -> None:
    """Show what is in a recording: topics, rates, gaps, anomalies, and in which modes it can run."""
    from vins_core.errors import VinspectError
    from vins_core.io.calibration import read_calibration
    from vins_core.io.inspect import inspect
    from vins_core.io.recording import open_recording
    from vins_core.record.header import cpu_model, package_versions
    from vins_core.solver.backend import describe

    with open_recording(recording) as source, progress_bar(f"reading {recording.name}") as report:
        try:
            calibration = read_calibration(calib, source).calibration
        except VinspectError:
            if calib:
                raise
            calibration = None  # what is in the recording can be told without
        found = inspect(source, report, calibration)
    backend, why = describe()
    if json:
        machine = {"backend": backend, "backend_note": why, "cpu": cpu_model(), "versions": package_versions()}
        print_json(found.to_dict() | machine)
    else:
        _print(found, f"{backend} ({why}) on {cpu_model()}")


def _print(found: RecordingInfo, backend: str) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console()
    if not console.is_terminal:
        console = Console(width=PIPED_WIDTH)
    table = Table(box=None, header_style="bold", pad_edge=False)
    for title in ("topic", "type", "role"):
        table.add_column(title)
    for title in ("messages", "Hz", "seconds", "longest gap s"):
        table.add_column(title, justify="right")
    table.add_column("image")
    for s in found.streams:
        length = (s.last_ns - s.first_ns) * 1e-9 if s.first_ns is not None and s.last_ns is not None else None
        numbers = (_number(s.rate_hz, 2), _number(length, 3), _number(s.longest_gap_s, 4))
        table.add_row(escape(s.topic), escape(s.type), s.role, str(s.count), *numbers, escape(s.image))
    console.print(f"{escape(found.path)}: {found.kind}, {found.duration_s:.3f} s", highlight=False, soft_wrap=True)
    console.print(table)
    total = sum(found.counts.values())
    summary = ", ".join(f"{count} {kind}" for kind, count in sorted(found.counts.items()))
    console.print(f"{total} anomalies{': ' + summary if total else ''}", highlight=False)
    for anomaly in found.anomalies[:SHOWN]:
        console.print(f"  {anomaly.kind}: {escape(anomaly.message)}", highlight=False, soft_wrap=True)
    if total > SHOWN:
        console.print(f"  and {total - SHOWN} more; see --json", highlight=False)
    for mode in found.modes:
        console.print(f"{mode.mode}: {_possible(mode)}", highlight=False, soft_wrap=True)
    if found.gps:
        console.print(escape(found.gps), highlight=False, soft_wrap=True)
    console.print(f"back end: {escape(backend)}", highlight=False, soft_wrap=True)


def _possible(mode: ModeInfo) -> str:
    from vins_core.io.modes import SUPPORTED

    if mode.missing:
        return f"needs {' and '.join(mode.missing)}"
    return "possible" + ("" if mode.mode in SUPPORTED else "; not supported yet")


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
