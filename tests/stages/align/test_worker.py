from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from sensorgate.stages.align import worker
from sensorgate.stages.align.prepare import engine_settings
from sensorgate.stages.align.solution import CameraSetting, Job, JobFrame, load_solution, save_solution
from sensorgate.stages.errors import Cancelled, MissingDependency
from sensorgate.stages.record import dumps, from_plain
from sensorgate.stages.thresholds import DEFAULTS

from tests.stages.align.scenes import frames, grid, request, solution

EMPTY = Job((), (), (), engine_settings("quick", 1200, 1, DEFAULTS))


def _engine(tmp_path, monkeypatch, body):
    """Let the worker boot into ``body`` instead of an engine."""
    boot = f"import json, os, sys, time\nrequest = sys.argv[2]\n{body}\n"
    monkeypatch.setattr(worker, "_BOOT", boot)


def test_a_native_abort_is_an_error_with_its_last_words(tmp_path, monkeypatch):
    _engine(tmp_path, monkeypatch, "print('Check failed: x > 0', file=sys.stderr, flush=True); os.abort()")
    with pytest.raises(worker.SolverFailed, match="Check failed"):
        worker.solve(EMPTY, "pycolmap", tmp_path / "run", tmp_path)


def test_an_exit_without_an_answer_is_an_error(tmp_path, monkeypatch):
    _engine(tmp_path, monkeypatch, "sys.exit(0)")
    with pytest.raises(worker.SolverFailed):
        worker.solve(EMPTY, "pycolmap", tmp_path / "run", tmp_path)


def test_an_old_answer_is_not_taken_for_a_new_one(tmp_path, monkeypatch):
    asked = request(frames(grid()))
    (tmp_path / "run").mkdir()
    save_solution(solution(asked, grid()), tmp_path / "run" / "solve-00.npz")
    _engine(tmp_path, monkeypatch, "sys.exit(0)")
    with pytest.raises(worker.SolverFailed):
        worker.solve(EMPTY, "pycolmap", tmp_path / "run", tmp_path)


def test_cancel_kills_the_worker(tmp_path, monkeypatch):
    mark = tmp_path / "pid"
    _engine(tmp_path, monkeypatch, f"open({str(mark)!r}, 'w').write(str(os.getpid())); time.sleep(60)")
    with pytest.raises(Cancelled):
        worker.solve(EMPTY, "pycolmap", tmp_path / "run", tmp_path, cancel=mark.exists)
    pid = mark.read_text(encoding="utf-8")
    if pid and sys.platform == "linux":
        with pytest.raises(ProcessLookupError):
            os.kill(int(pid), 0)


@pytest.mark.skipif(sys.platform != "linux", reason="looks at processes by /proc")
def test_the_worker_ends_with_its_parent(tmp_path):
    root = Path(worker.__file__).resolve().parents[2]
    boot = worker._BOOT.replace("raise SystemExit(", "import time\n").split("importlib.import_module('sensorgate")[0]
    body = (
        boot
        + "worker = importlib.import_module('sensorgate.stages.align.worker')\n"
        + "worker.json.loads = lambda text: time.sleep(60)\nworker.main(sys.argv[2])\n"
    )
    request_file = tmp_path / "solve.json"
    request_file.write_text("{}", encoding="utf-8")
    child = subprocess.Popen([sys.executable, "-c", body, str(root), str(request_file)], stdin=subprocess.PIPE)
    time.sleep(1.0)
    assert child.poll() is None
    child.stdin.close()
    assert child.wait(timeout=20) == 1


def test_a_worker_that_answers_ends_quietly(tmp_path):
    pytest.importorskip("pycolmap")
    found = worker.solve(EMPTY, "pycolmap", tmp_path / "run", tmp_path)
    assert found.models == 0 and len(found.model) == 0
    assert "Fatal" not in (tmp_path / "run" / "solve.log").read_text(encoding="utf-8")


def test_progress_lines_reach_the_caller_and_noise_does_not(tmp_path, monkeypatch):
    body = "print('hello'); print(json.dumps(['pairs', 3, 9])); print('[1]', flush=True); sys.exit(1)"
    _engine(tmp_path, monkeypatch, body)
    seen = []
    with pytest.raises(worker.SolverFailed):
        worker.solve(EMPTY, "pycolmap", tmp_path / "run", tmp_path, progress=lambda *a: seen.append(a))
    assert seen == [("pairs", 3, 9)]


def test_a_missing_program_is_named_with_the_command(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingDependency, match="COLMAP"):
        worker.solve(EMPTY, "colmap", tmp_path / "run", tmp_path)


def test_a_solution_survives_its_file(tmp_path):
    asked = request(frames(grid()))
    solved = solution(asked, grid(), pairs=[(0, 1, 40)])
    save_solution(solved, tmp_path / "s.npz")
    back = load_solution(tmp_path / "s.npz")
    assert back.cameras == solved.cameras
    assert np.array_equal(back.center, solved.center) and np.array_equal(back.pairs, solved.pairs)


def test_a_job_survives_json():
    job = Job(
        (JobFrame("a", "/a.jpg", 0, "f"),), (CameraSetting("p", 4, 3, 0.6),), ((0, 1),), EMPTY.settings, start="/x"
    )
    assert from_plain(Job, json.loads(dumps(job))) == job


def test_the_worker_writes_into_its_folder_only(tmp_path, monkeypatch):
    _engine(tmp_path, monkeypatch, "sys.exit(3)")
    with pytest.raises(worker.SolverFailed, match="code 3"):
        worker.solve(EMPTY, "pycolmap", tmp_path / "run", tmp_path / "cache")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run"]
    assert sorted(p.name for p in Path(tmp_path / "run").iterdir()) == ["solve.json", "solve.log"]
