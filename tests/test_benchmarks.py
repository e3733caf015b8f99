"""The one table of the benchmarks: ratios over ours, in the page's place for it."""

from __future__ import annotations

import pytest

pytest.importorskip("cv2")

from benchmarks import run_all
from benchmarks.run_all import BEGIN, END, PAGE, Line, table, written


def test_each_job_is_over_its_own_contender_of_ours():
    lines = [
        Line("gate", "exiftool", 2.0, "ms/frame", False),
        Line("gate", "ours", 0.5, "ms/frame", True),
        Line("align", "ours", 3.0, "s/frame", True, "20/20 placed"),
        Line("align", "COLMAP", 30.0, "s/frame", False),
    ]
    rows = [[c.strip() for c in row.split("|")[1:-1]] for row in table(lines).splitlines()[2:]]
    assert [r[0] for r in rows] == ["gate", "", "align", ""], "a job is named once"
    assert [r[3] for r in rows] == ["4.00", "1.00", "1.00", "10.00"]
    assert rows[1][1] == "**ours**" and rows[2][4] == "20/20 placed"


def test_the_table_replaces_the_one_before_and_nothing_else():
    page = PAGE.read_text(encoding="utf-8")
    once = written(page, "first")
    assert written(once, "second") == written(page, "second")
    assert written(page, "x").replace(f"{BEGIN}\nx\n{END}", "") == page.split(BEGIN)[0] + page.split(END)[1]
    with pytest.raises(SystemExit):
        written("no place", "x")


def test_the_machine_is_told_with_the_versions_that_decide():
    said = run_all.machine()
    assert all(name in said for name in ("cores", "sensorgate", "Python", "numpy", "Pillow"))


def test_an_unknown_job_is_a_usage_error(capsys):
    with pytest.raises(SystemExit) as ended:
        run_all.main(["--only", "gate,lunch"])
    assert ended.value.code == 2 and "lunch" in capsys.readouterr().err
