"""The page: whole, harmless, small, and really shown by a browser."""

from __future__ import annotations

import base64
import builtins
import copy
import hashlib
import re
import sys
import time
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple

import pytest
from sensorgate.plugin.report import previews
from sensorgate.plugin.report.html import DARK_STYLE, render, themed
from sensorgate.stages.errors import MissingDependency

from tests.plugin.report.sample import empty, sample

VOID = {"meta", "img", "input", "br", "link", "hr"}
HOSTILE = "<script>alert(1)</script>\"'><img src=x onerror=alert(2)> ]]> {{ 7*7 }} \u202e\x00 --> </style></svg>"


class Page(HTMLParser):
    """Collects elements and text; every element that is opened must be closed in order."""

    def __init__(self, markup: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: List[str] = []
        self.tags: List[Tuple[str, Dict[str, Optional[str]]]] = []
        self.ids: List[str] = []
        self.words: List[str] = []
        self.feed(markup)
        self.close()

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        found = dict(attrs)
        self.tags.append((tag, found))
        if found.get("id"):
            self.ids.append(found["id"])
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: Any) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-3:]}"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


@pytest.fixture(scope="module")
def page() -> str:
    return render(sample())


def test_is_well_formed(page: str) -> None:
    parsed = Page(page)
    assert parsed.open == []
    assert len(parsed.ids) == len(set(parsed.ids))
    targets = {a["href"][1:] for t, a in parsed.tags if t == "a" and a.get("href", "").startswith("#")}
    assert targets <= set(parsed.ids)


def test_shows_every_project_payload_and_finding(page: str) -> None:
    text = Page(page).text
    report = sample()
    for project in report["subprojects"]:
        assert project["name"] in text
        for option in project["options"]:
            assert option["name"] in text and option["reason"] in text
        for reason in project["reasons"]:
            assert reason in text
        for row in project["calibration"]:
            assert row["camera_id"] in text
    for payload in report["payloads"]:
        assert payload["id"] in text
    for finding in report["findings"]:
        assert finding["code"] in text and finding["message"] in text and finding["remedy"] in text
        if finding["odm_message"]:
            assert finding["odm_message"] in text
    for frame in report["frames"]:
        if frame["reason"]:
            assert frame["path"] in text
    assert report["inputs"]["digest"] in text and "min_inliers = 25" in text


def test_needs_nothing_from_outside(page: str) -> None:
    parsed = Page(page)
    for tag, attributes in parsed.tags:
        assert tag not in ("link", "iframe", "object", "embed")
        for name in ("src", "href", "xlink:href", "action"):
            value = attributes.get(name) or ""
            assert value == "" or value.startswith(("#", "data:image/jpeg;base64,")), value
        assert not any(name.startswith("on") for name in attributes)
    assert "@import" not in page and "url(" not in page and "http:" not in page and "https:" not in page


def test_only_its_own_script_may_run(page: str) -> None:
    scripts = re.findall(r"<script>(.*?)</script>", page, re.S)
    assert len(scripts) == 1
    digest = base64.b64encode(hashlib.sha256(scripts[0].encode("utf-8")).digest()).decode("ascii")
    assert f"script-src &#39;sha256-{digest}&#39;" in page or f"script-src 'sha256-{digest}'" in page


def test_drawings_are_xml_with_a_title(page: str) -> None:
    drawings = re.findall(r"<svg.*?</svg>", page, re.S)
    assert len(drawings) > 8
    for drawing in drawings:
        root = ElementTree.fromstring(drawing)
        assert root.get("aria-hidden") == "true" or (root[0].tag == "title" and root[0].text)


def test_pictures_have_words_and_controls_have_labels(page: str) -> None:
    parsed = Page(page)
    assert all(a.get("alt") for t, a in parsed.tags if t == "img")
    assert all(a.get("aria-label") for _, a in parsed.tags if a.get("role") == "group")
    assert parsed.tags[0][1] == {"lang": "en"}


def poisoned(value: Any, key: str = "") -> Any:
    """Every free text of the report replaced by something hostile, ids made hostile alike."""
    fixed = {"schema_version", "verdict", "spectrum", "role", "route", "severity", "how", "code", "primary_band"}
    if isinstance(value, dict):
        return {k: poisoned(v, k) for k, v in value.items()}
    if isinstance(value, list):
        return [poisoned(v, key) for v in value]
    if isinstance(value, str) and key not in fixed:
        return f"{value}{HOSTILE}"
    return value


def test_hostile_text_stays_text() -> None:
    parsed = Page(render(poisoned(sample(12))))
    assert parsed.open == []
    tags = [t for t, _ in parsed.tags]
    assert tags.count("script") == 1 and tags.count("style") == 1 and "img" not in tags
    assert "alert(1)" in parsed.text and "{{ 7*7 }}" in parsed.text
    assert "\x00" not in parsed.text and "\u202e" not in parsed.text


def test_a_page_around_it_can_choose_dark_or_light(page: str) -> None:
    assert page.count(DARK_STYLE) == 1
    dark, light = themed(page, "dark"), themed(page, "light")
    assert "prefers-color-scheme" not in dark + light and dark != light
    assert len(page) - len(dark) == len(DARK_STYLE) - len("@media screen")
    assert themed(page, "") == page == themed(page, "</style><script>")


def test_same_report_same_bytes() -> None:
    assert render(sample()) == render(copy.deepcopy(sample()))


def test_ten_thousand_frames_stay_small_and_quick() -> None:
    report = sample(1500)
    assert len(report["frames"]) >= 10_000
    for index, frame in enumerate(report["frames"]):
        if index % 3 == 0:
            frame.update(reason="transit", subproject=None)
    report["findings"] += [
        {**report["findings"][0], "code": "odd-frame", "subjects": [f["path"]], "message": f"{f['path']} is odd."}
        for f in report["frames"]
    ]
    start = time.process_time()
    page = render(report)
    assert time.process_time() - start < 10.0
    assert len(page.encode("utf-8")) < 3_000_000
    assert Page(page).open == []


@pytest.mark.parametrize("verdict", ["blocked", "consistent"])
def test_nothing_to_show(verdict: str) -> None:
    assert Page(render(empty(verdict))).open == []


def test_without_gps_alignment_or_figures() -> None:
    report = sample(10)
    for frame in report["frames"]:
        frame.update(
            latitude=None, longitude=None, gps=None, gsd_cm=None, gsd_after_cm=None, height_m=None, focal_mm=None
        )
    for project in report["subprojects"][:2]:
        project["alignment"] = None
    bare = {"registered": 0, "frames": 9, "components": 0, "engine": "colmap 3.8"}
    names = ("mean_reproj_error_px", "gps_rmse_m", "height_m", "bowing_m", "bowing_se_m")
    report["subprojects"][2]["alignment"] = {**bare, **dict.fromkeys(names)}
    for profile in report["profiles"]:
        profile["intrinsics"] = {**profile["intrinsics"], "focal_mm": None, "focal_ratio": None}
        profile.update(focal_mm_min=None, focal_mm_max=None)
    parsed = Page(render(report))
    assert parsed.open == [] and 'class="map"' not in render(report)
    assert "No model could be built." in parsed.text


def test_a_replay_says_what_differs() -> None:
    report = sample(10)
    report["replay"] = {"plan_sha256": "ab" * 32, "same": True, "differences": []}
    assert "Nothing differs from the plan" in Page(render(report)).text
    change = {"about": "version", "subjects": ["numpy"], "message": "numpy is another", "then": "2.0", "now": "2.1"}
    report["replay"].update(same=False, differences=[change])
    text = Page(render(report)).text
    assert "1 difference from the plan" in text and "numpy is another" in text and "ab" * 32 in text


def test_without_profiles() -> None:
    report = sample(10)
    report.update(profiles=[], payloads=[], flights=[], subprojects=[], actions=[])
    for frame in report["frames"]:
        frame.update(profile=None, payload=None, flight=None, subproject=None)
    assert Page(render(report)).open == []


def test_one_frame_and_one_far_away() -> None:
    report = sample(10)
    placed = [f for f in report["frames"] if f["latitude"] and not f["reason"]]
    placed[0].update(latitude=-33.0, longitude=179.999)
    placed[1].update(latitude=-33.0, longitude=-179.9995)
    text = render(report)
    assert Page(text).open == [] and "Not drawn: 2 frames " in text


def test_previews_are_shown_and_bounded(tmp_path: Path) -> None:
    from PIL import Image

    image = tmp_path / "a.jpg"
    Image.effect_noise((900, 600), 60).save(image)
    small = previews.thumbnail(image, 120)
    assert small is not None
    report = sample(10)
    paths = [f["path"] for f in report["frames"] if f["output"]][:30]
    shown = {previews.preview_key(p, w): small for p in paths for w in (previews.BEFORE, previews.AFTER)}
    shown[previews.preview_key(paths[0], previews.AFTER)] = b"<svg onload=alert(1)>"
    page = Page(render(report, shown))
    pictures = [a for t, a in page.tags if t == "img"]
    assert len(pictures) == 2 * previews.MOST_PREVIEWS
    assert all((a["src"] or "").startswith("data:image/jpeg;base64,") for a in pictures)


def test_without_jinja_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def refuse(name: str, *rest: Any, **more: Any) -> Any:
        if name.split(".")[0] == "jinja2":
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.delitem(sys.modules, "jinja2", raising=False)
    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(MissingDependency, match=r"sensorgate\[report\]"):
        render(empty())
