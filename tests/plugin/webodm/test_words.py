"""What a pilot reads in WebODM: cameras as a pilot counts them, reasons first, remedies that exist there."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any, Dict, Iterator, List, Sequence, Tuple

import pytest
from sensorgate.plugin.inspection import Settings, inspect_scan
from sensorgate.plugin.webodm.proposal import SPLIT, Choices, propose
from sensorgate.plugin.webodm.remedies import FOREIGN, HARMONIZED, REMEDIES, remedy_here
from sensorgate.plugin.webodm.verdict import words_for
from sensorgate.stages.finding import Finding
from sensorgate.stages.read import scan

ROOT = Path(__file__).resolve().parents[3]
REAL = ROOT.parent / "shared/data/real_frames"
AS_SUGGESTED = Choices()
# What these find comes out of harmonizing and alignment, whose report is a page of its own.
LATER = ("plugin/advice.py", "plugin/harmonizing.py", "plugin/odm/cameras.py", "stages/harmonize/bands_findings.py")
needs_real = pytest.mark.skipif(not REAL.is_dir(), reason="the real frames are not on this machine")


class Numbers(Dict[str, int]):
    """An id for every path that is asked for."""

    def __missing__(self, path: str) -> int:
        self[path] = len(self)
        return self[path]


def told(folders: Sequence[Path], choices: Choices = AS_SUGGESTED, engine: str = "worker") -> Dict[str, Any]:
    found = scan([str(f) for f in folders])
    inspection = inspect_scan(found, ("chosen",), Settings(), open_path=lambda path: Path("/dev/null/none"), masks={})
    return words_for(inspection, propose(inspection, choices), choices, Numbers(), None, (engine, "said"))


def texts(words: Dict[str, Any]) -> List[str]:
    found = [words["headline"], *words["odm"], *words["ours"], *(r["message"] for r in words["left_out"])]
    return found + [f[k] for f in words["findings"] for k in ("message", "remedy")]


@needs_real
def test_a_rig_is_one_camera() -> None:
    words = told([REAL / "micasense_rededge_capture", REAL / "brighton_p3_rgb"])
    assert words["headline"].startswith("23 frames of 2 cameras: 2 tasks")
    assert len({c["camera"] for c in words["cameras"]}) == 2 and len(words["cameras"]) == 6
    # The colour lens of a rig flies along as a camera of its own, and can be told from the rig.
    names = {p["name"] for p in told([REAL / "garfield_sequoia_rgb_ms"])["payloads"]}
    assert names == {"Parrot Sequoia", "Parrot Sequoia (multispectral)"}


@needs_real
def test_the_reason_comes_before_the_number() -> None:
    words = told([REAL])
    assert words["odm"][0].startswith("ODM would stop") and "11 cameras" in words["odm"][0]
    assert words["odm"][1] == "So none of the 48 frames would be processed."
    fine = told([REAL / "brighton_p3_rgb"])
    assert fine["odm"] == ["ODM would use all 18 frames."]


@needs_real
def test_no_text_has_an_id_or_a_command_in_it() -> None:
    for words in (told([REAL]), told([REAL], Choices(frozenset([SPLIT]))), told([REAL], engine="gate")):
        ids = {p["id"] for p in words["payloads"]} | {c["id"] for c in words["cameras"]}
        for text in texts(words):
            assert not any(f" {i} " in f" {text} " for i in ids), text
            assert not any(sign in text for sign in FOREIGN), text
            assert "keep these apart" not in text


@needs_real
def test_what_is_found_of_many_cameras_is_said_once() -> None:
    few = [f for f in told([REAL])["findings"] if f["code"] == "too-few-frames"]
    assert len(few) == 1 and "The same holds for 9 more:" in few[0]["message"]


@needs_real
def test_no_remedy_promises_what_was_unticked_or_cannot_be_done_here() -> None:
    parted = {f["code"]: f["remedy"] for f in told([REAL])["findings"]}
    whole = {f["code"]: f["remedy"] for f in told([REAL], Choices(frozenset([SPLIT])))["findings"]}
    assert "apart" in parted["mixed-spectra"] and whole["mixed-spectra"] != parted["mixed-spectra"]
    found = Finding("gsd-mixed", "error", (), "x", "sensorgate run resamples them.")
    assert "Harmonizing puts that right" in remedy_here(found, "worker")
    assert "not possible here" in remedy_here(found, "gate") and "node" in remedy_here(found, "node")


def _text(node: Any) -> str:
    return "".join(n.value for n in ast.walk(node) if isinstance(n, ast.Constant) and isinstance(n.value, str))


def said_in_sources() -> Iterator[Tuple[str, str]]:
    """(code, remedy) of all findings that are made in the sources, with constants of the module put in."""
    for folder in ("stages", "plugin"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            if file.relative_to(ROOT).as_posix() in LATER:
                continue
            for call in (n for n in ast.walk(ast.parse(file.read_text("utf-8"))) if isinstance(n, ast.Call)):
                name = getattr(call.func, "id", getattr(call.func, "attr", ""))
                named = {k.arg: k.value for k in call.keywords}
                if name == "Finding" and "code" in named and "remedy" in named:
                    yield _text(named["code"]), _text(named["remedy"])
                elif name == "finding" and len(call.args) >= 5:
                    yield _text(call.args[0]), _text(call.args[4])


def test_every_remedy_of_the_command_line_has_one_here() -> None:
    found = list(said_in_sources())
    assert len(found) > 80
    lacking = {
        code
        for code, remedy in found
        if any(sign in remedy for sign in FOREIGN)
        and code not in {*REMEDIES, *HARMONIZED}
        and not remedy_here(Finding(code, "error", (), "", remedy))
    }
    # The code of ground control that is too little stands in a variable; the other is said of a wish nobody has here.
    assert all(code.startswith("gcp-") or code in ("", "not-reflectance") for code in lacking), lacking


def test_every_code_here_is_a_finding() -> None:
    pages = {p.stem for p in (ROOT / "docs/findings").glob("*.md")}
    assert (set(REMEDIES) | HARMONIZED) <= pages
