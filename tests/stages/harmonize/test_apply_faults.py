"""Harmonizing that is disturbed: killed, resumed, out of disk, cancelled, hosted elsewhere."""

from __future__ import annotations

import builtins
import contextlib
import errno
import io
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from sensorgate.stages.errors import Cancelled, MissingDependency, UsageError
from sensorgate.stages.harmonize import HarmonizePlan, OutputError, apply
from sensorgate.stages.harmonize import files as put
from sensorgate.stages.thresholds import DEFAULTS

from .applying import ROOT, action, digests, run, shrunk, survey, survey_again

pytest.importorskip("cv2")


def test_the_journal_keeps_what_is_done_by_content_not_by_date(tmp_path):
    frames = survey(tmp_path / "in")
    journal = tmp_path / "work" / "journal"
    run(shrunk(frames), frames, tmp_path / "in", tmp_path / "out", journal=journal)
    first = digests(tmp_path / "out")
    inodes = {p.name: p.stat().st_ino for p in (tmp_path / "out").iterdir()}
    names = list(frames)
    os.utime(tmp_path / "in" / names[0], (1, 1))
    (tmp_path / "out" / names[1]).write_bytes(b"spoilt")
    changed = bytearray((tmp_path / "in" / names[2]).read_bytes())
    changed[-1:] = b"\x05"
    (tmp_path / "in" / names[2]).write_bytes(changed)
    with open(journal, "a") as stream:
        stream.write('\n["IMG_000.JPG", "cut by a ki')
    done, _ = run(shrunk(frames), frames, tmp_path / "in", tmp_path / "out", journal=journal)
    assert len(done) == 3
    assert digests(tmp_path / "out") == first
    after = {p.name: p.stat().st_ino for p in (tmp_path / "out").iterdir()}
    assert after[names[0]] == inodes[names[0]]
    assert after[names[1]] != inodes[names[1]] and after[names[2]] != inodes[names[2]]
    other = run(
        shrunk(frames),
        frames,
        tmp_path / "in",
        tmp_path / "out",
        journal=journal,
        thresholds=DEFAULTS.replaced({"jpeg_quality": 60}),
    )
    assert len(other[0]) == 3 and digests(tmp_path / "out") != first


@pytest.mark.parametrize("workers", [1, 3])
def test_workers_change_nothing(tmp_path, workers):
    frames = survey(tmp_path / "in", 4)
    run(shrunk(frames), frames, tmp_path / "in", tmp_path / "one", workers=1)
    run(shrunk(frames), frames, tmp_path / "in", tmp_path / "many", workers=workers)
    assert digests(tmp_path / "one") == digests(tmp_path / "many")


SCRIPT = """
import json, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from tests.stages.harmonize.applying import survey_again, shrunk, run
source, out = Path(sys.argv[2]), Path(sys.argv[3])
frames = survey_again(source)
print("go", flush=True)
run(shrunk(frames), frames, source, out / "images", journal=out / "journal")
"""


@pytest.mark.skipif(os.name != "posix", reason="kills with POSIX signals")
def test_killed_at_any_moment_and_run_again_gives_the_same(tmp_path):
    frames = survey(tmp_path / "in", 30)
    before = digests(tmp_path / "in")
    run(shrunk(survey_again(tmp_path / "in")), frames, tmp_path / "in", tmp_path / "whole")
    wanted = digests(tmp_path / "whole")
    rng = random.Random(11)
    killed_inside = 0
    for attempt in range(3):
        out = tmp_path / f"out{attempt}"
        for _ in range(2):
            command = [sys.executable, "-c", SCRIPT, str(ROOT), str(tmp_path / "in"), str(out)]
            process = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
            assert process.stdout is not None and process.stdout.readline() == b"go\n"
            time.sleep(rng.uniform(0.02, 0.5))
            killed_inside += process.poll() is None
            with contextlib.suppress(ProcessLookupError):  # a quick machine may have finished
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            process.stdout.close()
        done, broken = run(shrunk(frames), frames, tmp_path / "in", out / "images", journal=out / "journal")
        assert len(done) == 30 and not broken
        assert {n: d for n, d in digests(out / "images").items() if not n.startswith(".")} == wanted
        assert set(digests(out / "images")) == set(wanted)
    assert killed_inside
    assert digests(tmp_path / "in") == before


def _alive(session: int) -> bool:
    """Whether a process of the session lives: a worker that outlived its parent."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = stat.read_text().rpartition(")")[2].split()
            if int(fields[3]) == session and fields[0] != "Z":
                return True
    return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_workers_end_with_a_parent_that_is_killed_alone(tmp_path):
    """A worker left behind would write beside the next run."""
    survey(tmp_path / "in", 60, width=1200, height=900)
    script = SCRIPT.replace("survey_again(source)", "survey_again(source, 1200, 900)")
    command = [sys.executable, "-c", script, str(ROOT), str(tmp_path / "in"), str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
    images = tmp_path / "out" / "images"
    limit = time.monotonic() + 20
    while not (images.exists() and any(images.iterdir())) and time.monotonic() < limit:
        time.sleep(0.01)
    process.kill()
    process.communicate()
    limit = time.monotonic() + 3
    while _alive(process.pid) and time.monotonic() < limit:
        time.sleep(0.02)
    assert not _alive(process.pid)
    assert 0 < len(list(images.iterdir())) < 60


def test_what_a_killed_link_left_is_never_written_through(tmp_path):
    """The unfinished name may be a hard link to an original: opening it for writing would destroy that."""
    frames = survey(tmp_path / "in", 1)
    name = next(iter(frames))
    before = digests(tmp_path / "in")
    (tmp_path / "out").mkdir()
    os.link(tmp_path / "in" / name, tmp_path / "out" / f".{name}.part")
    os.link(tmp_path / "in" / name, tmp_path / "out" / name)
    done, _ = run(shrunk(frames), frames, tmp_path / "in", tmp_path / "out")
    assert done[0].how == "resampled" and digests(tmp_path / "in") == before
    assert [p.name for p in (tmp_path / "out").iterdir()] == [name]


def test_a_target_that_is_an_original_is_refused(tmp_path):
    frames = survey(tmp_path / "in", 2)
    before = digests(tmp_path / "in")
    with pytest.raises(UsageError, match="original"):
        run(shrunk(frames), frames, tmp_path / "in", tmp_path / "in")
    (tmp_path / "alias").symlink_to(tmp_path / "in")
    with pytest.raises(UsageError, match="original"):
        run(shrunk(frames), frames, tmp_path / "in", tmp_path / "alias")
    with pytest.raises(UsageError, match="Two frames"):
        target = dict.fromkeys(frames, tmp_path / "out" / "same.jpg")
        apply(shrunk(frames), frames, {n: tmp_path / "in" / n for n in frames}, target, thresholds=DEFAULTS)
    assert digests(tmp_path / "in") == before


def test_full_disk_is_named_and_leaves_nothing_half_written(tmp_path, monkeypatch):
    target = tmp_path / "out" / "a.jpg"
    put.put_bytes(target, b"old")

    class Full(io.BytesIO):
        def write(self, _data):
            raise OSError(errno.ENOSPC, "No space left on device")

    def opener(path, mode="r", *args, **options):
        Path(path).touch()
        return Full()

    with monkeypatch.context() as patch:
        patch.setattr(builtins, "open", opener)
        with pytest.raises(OutputError, match="full") as caught:
            put.put_bytes(target, b"new")
    assert caught.value.exit_code == 2 and "--resume" in str(caught.value)
    assert target.read_bytes() == b"old" and [p.name for p in target.parent.iterdir()] == ["a.jpg"]


def test_a_source_that_cannot_be_read_is_the_verdict_of_its_frame(tmp_path, monkeypatch):
    """A bad sector of the card under a copy is no fault of the output folder: the others go on."""
    frames = survey(tmp_path / "in", 3)

    def refuse(*_args, **_options):
        raise OSError(errno.EXDEV, "cross-device")

    original = builtins.open

    def opener(path, *args, **options):
        if str(path).endswith("in/IMG_001.JPG"):
            raise OSError(errno.EIO, "Input/output error")
        return original(path, *args, **options)

    monkeypatch.setattr(put.os, "link", refuse)
    with monkeypatch.context() as patch:
        patch.setattr(builtins, "open", opener)
        done, broken = run(HarmonizePlan((action(frames),)), frames, tmp_path / "in", tmp_path / "out")
    assert [(b.path, b.code) for b in broken] == [("IMG_001.JPG", "unreadable-file")]
    assert [d.how for d in done] == ["copied"] * 2
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["IMG_000.JPG", "IMG_002.JPG"]


def test_unwritable_folder_is_named(tmp_path):
    frames = survey(tmp_path / "in", 2)
    (tmp_path / "out").write_bytes(b"a file stands where the folder should be")
    for plan in (shrunk(frames), HarmonizePlan((action(frames),))):
        with pytest.raises(OutputError, match="--out"):
            run(plan, frames, tmp_path / "in", tmp_path / "out")


def test_cancel_stops_and_resume_goes_on(tmp_path):
    frames = survey(tmp_path / "in", 12)
    seen = []

    def progress(stage, done, total):
        seen.append((stage, done, total))

    with pytest.raises(Cancelled):
        run(
            shrunk(frames),
            frames,
            tmp_path / "in",
            tmp_path / "out",
            progress=progress,
            cancel=lambda: len(seen) >= 3,
            journal=tmp_path / "j",
        )
    done, _ = run(shrunk(frames), frames, tmp_path / "in", tmp_path / "out", journal=tmp_path / "j", progress=progress)
    assert len(done) == 12 and seen[-1] == ("harmonize", 12, 12)


def test_missing_opencv_is_named(tmp_path, monkeypatch):
    frames = survey(tmp_path / "in", 1)
    blocker = tmp_path / "block"
    blocker.mkdir()
    (blocker / "cv2.py").write_text("raise ImportError('not here')")
    monkeypatch.syspath_prepend(str(blocker))
    with pytest.raises(MissingDependency, match="pip install"):
        run(shrunk(frames), frames, tmp_path / "in", tmp_path / "out")
    done, _ = run(HarmonizePlan((action(frames, focal_mm=9.0),)), frames, tmp_path / "in", tmp_path / "out")
    assert done[0].how == "retagged"


def test_a_decoder_that_dies_takes_one_frame_along(tmp_path, monkeypatch):
    frames = survey(tmp_path / "in", 4)
    blocker = tmp_path / "block"
    blocker.mkdir()
    real_cv2 = json.dumps(str(Path(__import__("cv2").__file__).parent.parent))
    (blocker / "cv2.py").write_text(
        "import os, sys\n"
        f"sys.path.insert(0, {real_cv2}); here = sys.modules.pop('cv2')\n"
        "import cv2 as real\n"
        "inner = real.imdecode\n"
        "def imdecode(data, flags):\n"
        "    if data[-2:].tolist() == [0, 0] and data[-3] != 0: os._exit(9)\n"
        "    return inner(data, flags)\n"
        "real.imdecode = imdecode\n"
    )
    monkeypatch.syspath_prepend(str(blocker))
    done, broken = run(shrunk(frames), frames, tmp_path / "in", tmp_path / "out", workers=2)
    assert [(b.path, b.code) for b in broken] == [("IMG_002.JPG", "frame-fault")]
    assert len(done) == 3


HOSTED = """
import multiprocessing, sys, types
from pathlib import Path
root, source, out = sys.argv[1:]
for name in ("plugins", "plugins.gate"):
    sys.modules[name] = types.ModuleType(name)
sys.modules["plugins"].__path__ = []
sys.modules["plugins.gate"].__path__ = [root]

def work():
    from plugins.gate.stages.frame import Frame
    from plugins.gate.stages.harmonize import FlightAction, HarmonizePlan, apply
    from plugins.gate.stages.thresholds import DEFAULTS
    file = Path(source) / "IMG_000.JPG"
    frame = Frame("a", file.stat().st_size, "jpeg", 320, 240)
    action = FlightAction("p", "f", ("a",), 2.0, 1.0, 2.0, 320, 240, 640, 480)
    done, broken = apply(
        HarmonizePlan((action,)), {"a": frame}, {"a": file}, {"a": Path(out) / "a.jpg"}, thresholds=DEFAULTS
    )
    assert not broken and done[0].how == "resampled", broken

process = multiprocessing.get_context("fork").Process(target=work, daemon=True)
process.start()
process.join()
sys.exit(process.exitcode)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="a daemonic forked worker, as task queues have them")
def test_works_in_a_daemonic_worker_under_another_package_name(tmp_path):
    survey(tmp_path / "in", 1)
    command = [sys.executable, "-c", HOSTED, str(ROOT), str(tmp_path / "in"), str(tmp_path / "out")]
    assert subprocess.run(command, check=False, cwd=tmp_path).returncode == 0
    assert (tmp_path / "out" / "a.jpg").exists()
