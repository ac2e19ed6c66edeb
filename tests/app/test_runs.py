"""What was opened: a finished run, a recording under estimation, or a reason why there is nothing to show."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from fake_run import FRAMES, fake_run, image

from app.images import Images
from app.runs import OpenRun, open_path
from app.worker import Job, new_run_folder
from vins_core.errors import RecordingError, VinspectError
from vins_core.record.writer import RunWriter
from vins_core.sensors import ImageRef


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


# Estimators for the worker process; they must be importable there, hence at module level.


def estimate_slowly(recording: Path, calib: Sequence[Path], out: Path, cancelled: Callable[[], bool]) -> None:
    run = fake_run(FRAMES)
    with RunWriter(out, run.header, run.truth, images=run) as record:
        for report, summary in zip(run.reports, run.summaries):
            record.append(report, summary.ms)
            if cancelled():
                record.close("interrupted")
                return
            time.sleep(0.02)


def complain(recording: Path, calib: Sequence[Path], out: Path, cancelled: Callable[[], bool]) -> None:
    raise RecordingError(f"{recording}: no images in it")


def crash(recording: Path, calib: Sequence[Path], out: Path, cancelled: Callable[[], bool]) -> None:
    raise SystemExit(7)


def wait_until(condition: Callable[[], bool], timeout_s: float = 60.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "timed out"
        time.sleep(0.02)


def opened_with(estimate: Callable[..., None], tmp_path: Path) -> OpenRun:
    job = Job.start(tmp_path / "room.bag", (), estimate)
    return OpenRun("room.bag", job.out, job)


def test_a_run_opens_whole(run_folder: Path) -> None:
    opened = open_path(run_folder)
    assert opened.view is not None and len(opened.view) == FRAMES
    assert opened.error == opened.doing == "" and not opened.growing


def test_frames_appear_while_the_estimator_runs_and_all_are_there_at_the_end(tmp_path: Path) -> None:
    opened = opened_with(estimate_slowly, tmp_path)
    assert "starting" in opened.doing
    lengths = set()

    def done() -> bool:
        opened.poll()
        lengths.add(0 if opened.view is None else len(opened.view))
        return not opened.growing

    wait_until(done)
    opened.poll()
    assert len(lengths) > 3
    assert opened.view is not None and len(opened.view) == FRAMES and opened.view.complete
    assert opened.error == opened.doing == ""


def test_a_run_that_another_program_writes_grows_in_the_page(tmp_path: Path) -> None:
    run = fake_run(20)
    writer = RunWriter(tmp_path / "run", run.header, run.truth, images=run)
    for k in range(5):
        writer.append(run.reports[k], {})
    opened = open_path(tmp_path / "run")
    assert opened.view is not None and len(opened.view) == 5 and opened.growing
    writer.append(run.reports[5], {})
    assert opened.poll() and len(opened.view) == 6
    writer.close()
    assert opened.poll() and not opened.growing and opened.doing == ""


def test_progress_is_the_share_of_the_expected_frames(tmp_path: Path) -> None:
    opened = opened_with(estimate_slowly, tmp_path)
    wait_until(lambda: opened.poll() and opened.view is not None)
    assert opened.view is not None and opened.progress == pytest.approx(len(opened.view) / FRAMES)
    opened.close()


def test_a_cancelled_estimator_leaves_what_it_has_done_and_no_error(tmp_path: Path) -> None:
    opened = opened_with(estimate_slowly, tmp_path)
    wait_until(lambda: opened.poll() and opened.view is not None)
    opened.close()
    opened.poll()
    assert opened.view is not None and 0 < len(opened.view) < FRAMES
    assert opened.error == "" and not opened.growing
    assert opened.doing == f"The estimator was stopped after frame {len(opened.view) - 1}."


def test_what_the_estimator_complains_of_is_the_page_s_sentence(tmp_path: Path) -> None:
    opened = opened_with(complain, tmp_path)
    wait_until(lambda: opened.poll() and not opened.growing)
    assert opened.error == f"{(tmp_path / 'room.bag').resolve()}: no images in it"


def test_an_estimator_that_dies_is_told(tmp_path: Path) -> None:
    opened = opened_with(crash, tmp_path)
    wait_until(lambda: opened.poll() and not opened.growing)  # that it ended is news
    assert not opened.poll()
    assert "unexpectedly" in opened.error and "7" in opened.error


@pytest.mark.parametrize("name", ["nothing.bag", "text.bag", "folder"])
def test_what_cannot_be_opened_is_one_sentence_that_names_it(tmp_path: Path, name: str) -> None:
    (tmp_path / "text.bag").write_text("not a bag")
    (tmp_path / "folder").mkdir()
    opened = open_path(tmp_path / name)
    assert name in opened.error and "\n" not in opened.error
    assert opened.view is None and not opened.growing


def test_each_run_gets_a_folder_of_its_own_in_the_user_s_cache(tmp_path: Path) -> None:
    folder = new_run_folder(Path("/data/room.bag"))
    assert folder.parent == tmp_path / "cache" / "vinspect" / "runs"
    assert folder.name.startswith("room-") and not folder.exists()


# Images


class Counting:
    """An image source that counts how often it is asked."""

    def __init__(self) -> None:
        self.asked = 0

    def encoded(self, ref: ImageRef) -> tuple[str, bytes]:
        self.asked += 1
        if ref.index == 13:
            raise RecordingError("image 13 is damaged")
        return "image/png", cv2.imencode(".png", image(ref.index))[1].tobytes()


def ref(index: int) -> ImageRef:
    return ImageRef(index, 0, index)


def test_an_image_is_fetched_once_while_scrubbing_over_it() -> None:
    source = Counting()
    images = Images(source)
    first = [images.uri(ref(k)) for k in (1, 2, 1, 2, 1)]
    images.thumbnail(ref(1))
    assert source.asked == 2 and first[0] == first[2] and first[0].startswith("data:image/png;base64,")


def test_the_cache_keeps_the_most_recent_images_within_its_size() -> None:
    source = Counting()
    size = len(source.encoded(ref(1))[1])
    images, source.asked = Images(source, keep_bytes=int(2.5 * size)), 0
    for k in (1, 2, 3, 2):
        images.uri(ref(k))
    assert source.asked == 3
    images.uri(ref(1))
    assert source.asked == 4


def test_thumbnails_keep_the_aspect_and_the_grey_values() -> None:
    thumbnail = Images(Counting()).thumbnail(ref(20), width=94)
    assert thumbnail.shape == (60, 94, 3)
    assert abs(thumbnail.mean() - image(20).mean()) < 2
    assert (thumbnail == thumbnail[:, :, :1]).all()


def test_a_damaged_image_is_told_and_not_remembered_as_good() -> None:
    images = Images(Counting())
    for _ in range(2):
        with pytest.raises(VinspectError, match="13"):
            images.uri(ref(13))


def test_a_run_whose_recording_is_gone_shows_a_sentence_instead_of_images(tmp_path: Path) -> None:
    run = fake_run(15)
    header = run.header.__class__(**{**vars(run.header), "embedded_images": False, "recording": "/gone/room.bag"})
    with RunWriter(tmp_path / "run", header) as record:
        for report, summary in zip(run.reports, run.summaries):
            record.append(report, summary.ms)
    opened = open_path(tmp_path / "run")
    assert opened.view is not None and opened.error == ""
    with pytest.raises(VinspectError, match=r"/gone/room\.bag"):
        opened.images.uri(opened.view.report(3).images[-1])


def test_images_inside_a_run_are_the_ones_that_were_recorded(run_folder: Path) -> None:
    opened = open_path(run_folder)
    assert opened.view is not None
    thumbnail = opened.images.thumbnail(opened.view.report(20).images[-1], width=10_000)
    expected = cv2.resize(image(20), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    assert np.abs(thumbnail[:, :, 0].astype(int) - expected).mean() < 3
