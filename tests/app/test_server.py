"""The server says where it really listens, and ends cleanly."""

from __future__ import annotations

import socket
import urllib.request
from pathlib import Path

import pytest

from app.runs import open_path
from app.server import Server, sample
from vins_core.errors import RecordingError


def test_a_busy_port_becomes_another_one_and_the_url_says_which(run_folder: Path) -> None:
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 0))
        busy.listen()
        taken = busy.getsockname()[1]
        server = Server(open_path(run_folder), port=taken)
        try:
            assert server.url != f"http://localhost:{taken}"
            assert urllib.request.urlopen(server.url, timeout=10).status == 200
        finally:
            server.stop()


def test_it_listens_on_this_machine_only_unless_told_otherwise(run_folder: Path) -> None:
    server = Server(open_path(run_folder), port=8740)
    try:
        port = int(server.url.rpartition(":")[2])
        with socket.socket() as other:
            other.settimeout(5)
            assert other.connect_ex(("127.0.0.2", port)) != 0  # any address of this machine but the one bound
    finally:
        server.stop()


def test_only_the_page_is_served_and_no_file_beside_it(run_folder: Path) -> None:
    server = Server(open_path(run_folder), port=8760)
    try:
        for path in ("/../../../../../../etc/passwd", "/%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd", f"/{run_folder}"):
            try:
                body = urllib.request.urlopen(server.url + path, timeout=10).read()
            except OSError:
                continue
            assert b"root:" not in body and b"vinspect run" not in body
    finally:
        server.stop()


def test_a_missing_sample_is_told_with_what_to_type_instead(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("app.server.shipped", lambda name: tmp_path)
    with pytest.raises(RecordingError, match="vinspect open RECORDING"):
        sample()
