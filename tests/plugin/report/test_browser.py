"""The page in a real Chromium: filters, copying, the keyboard, contrast, a phone, ten thousand frames."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Dict, Iterator, List, Sequence

import pytest
from sensorgate.plugin.report.html import render

from tests.plugin.report.sample import sample
from tests.plugin.webodm.panel_browser import CHROMIUM, Browser

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")

SHOWN = "(s) => [...document.querySelectorAll(s)].filter(e => e.offsetParent !== null)"
# Every text of the page with its colour and the colours that lie behind it, down to the page.
TEXTS = """(() => {
  const found = new Map();
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (!walker.currentNode.textContent.trim() || element.closest('script, style, title, .away')) continue;
    const style = getComputedStyle(element);
    const inside = element.closest('svg');
    const behind = [];
    for (let e = inside ? inside.parentElement : element; e; e = e.parentElement)
      behind.push(getComputedStyle(e).backgroundColor);
    const colour = inside ? style.fill : style.color;
    const key = colour + behind.join();
    if (!found.has(key)) found.set(key, {colour, behind, text: walker.currentNode.textContent.trim().slice(0, 60)});
  }
  return [...found.values()];
})()"""


def parsed(colour: str) -> List[float]:
    """Red, green, blue (0-255) and opacity of what a browser computes."""
    values = [float(v) for v in colour[colour.index("(") + 1 : colour.index(")")].replace("/", ",").split(",")]
    return values if len(values) == 4 else [*values, 1.0]


def luminance(colour: Sequence[float]) -> float:
    """Relative luminance as WCAG 2 defines it."""
    parts = [v / 255.0 for v in colour[:3]]
    linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def ratio(one: Sequence[float], other: Sequence[float]) -> float:
    """Contrast of two colours, 1 to 21."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def contrast(text: Dict[str, Any]) -> float:
    """WCAG 2 contrast ratio of a text on the first opaque colour behind it."""
    behind = next((b for b in map(parsed, text["behind"]) if b[3] == 1.0), [255.0, 255.0, 255.0, 1.0])
    return ratio(parsed(text["colour"]), behind)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("chromium")) as browser:
        yield browser


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("page") / "report.html"
    file.write_text(render(sample(20)), encoding="utf-8")
    return file


@pytest.fixture
def page(browser: Browser, file: Path) -> Iterator[Browser]:
    browser.resize(1366, 768)
    browser.open("about:blank#")
    browser.errors.clear()
    browser.open(file.as_uri())
    yield browser
    assert browser.errors == []


def shown(page: Browser, selector: str) -> int:
    return int(page.run(f"({SHOWN})({selector!r}).length"))


def test_findings_are_filtered_by_severity_and_payload(page: Browser) -> None:
    everything = shown(page, "article.finding")
    assert everything > 5 and shown(page, "article.finding.error") > 0
    page.run("document.querySelector('#show-error').click()")
    assert shown(page, "article.finding.error") == 0 and shown(page, "article.finding.warning") > 0
    page.run("document.querySelector('#show-error').click()")
    thermal = page.run(
        "[...document.querySelectorAll('[name=about]')].find(e => e.parentElement.innerText.includes('xt2-thermal')).id"
    )
    page.run(f"document.querySelector('#{thermal}').click()")
    left = page.run(f"({SHOWN})('article.finding code:first-of-type').map(e => e.innerText)")
    assert {"mixed-spectra", "not-temperature", "silent-default-focal"} <= set(left)
    assert not {"focal-variance", "transit", "gsd-mismatch"} & set(left)
    page.run("document.querySelector('#about-all').click()")
    assert shown(page, "article.finding") == everything


def test_the_map_hides_a_payload(page: Browser) -> None:
    before = shown(page, ".map g[class^=layer] path.dots")
    page.run("document.querySelector('#show-0').click()")
    drawn = "[...document.querySelectorAll('.map .layer-0')].map(e => getComputedStyle(e).display)"
    assert before > 0 and set(page.run(drawn)) == {"none"}


def test_options_are_copied(page: Browser) -> None:
    page.run("window.copied = []; document.execCommand = () => (copied.push(document.activeElement.value), true); 0")
    page.run("Object.defineProperty(navigator, 'clipboard', {value: undefined}); 0")
    page.run("document.querySelector('button[data-from=line-1]').click()")
    page.wait("document.querySelector('button[data-from=line-1]').textContent === 'Copied'")
    assert page.run("copied") == ["--use-fixed-camera-params --feature-quality high --dem-resolution 2.6"]


def test_the_keyboard_reaches_everything_and_shows_where_it_is(page: Browser) -> None:
    page.press("Tab")
    assert page.run("document.activeElement.textContent") == "Skip to the report"
    seen = set()
    for _ in range(400):
        page.press("Tab")
        state = page.run(
            "(e => e === document.body ? null : [e.id || e.dataset.from || e.getAttribute('href') || e.tagName, "
            "getComputedStyle(e).outlineStyle])(document.activeElement)"
        )
        if state is None:
            break
        assert state[1] == "solid", state
        seen.add(state[0])
    assert {"show-error", "about-all", "show-0", "line-1", "#project-rgb", "SUMMARY", "#decided"} <= seen
    page.run("document.querySelector('#show-info').focus()")
    page.press(" ")
    assert page.run("document.querySelector('#show-info').checked") is False


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_has_contrast(page: Browser, scheme: str) -> None:
    page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    page.run("document.querySelectorAll('details').forEach(d => d.open = true)")
    texts = page.run(TEXTS)
    names = [f"--c{i}" for i in range(12)] + ["--ground", "--card"]
    values = page.run(f"{names}.map(n => getComputedStyle(document.documentElement).getPropertyValue(n))")
    page.call("Emulation.setEmulatedMedia", features=[])
    *palette, ground, card = ([int(v.strip()[i : i + 2], 16) for i in (1, 3, 5)] for v in values)
    for colour in palette:  # WCAG asks 3:1 of what is no text
        assert min(ratio(colour, ground), ratio(colour, card)) >= 3.0, colour
    assert len(texts) > 10
    faint = {t["text"]: round(contrast(t), 2) for t in texts if contrast(t) < 4.5}
    assert faint == {}


@pytest.mark.parametrize("width", [390, 820, 1366])
def test_nothing_hangs_over_the_edge(page: Browser, width: int) -> None:
    page.resize(width, 844)
    page.run("document.querySelectorAll('details').forEach(d => d.open = true)")
    assert page.run("document.documentElement.scrollWidth") == width
    over = page.run(
        "[...document.querySelectorAll('main *')].filter(e => !e.closest('.scroll, svg') && "
        "e.getBoundingClientRect().right > innerWidth + 1).map(e => e.outerHTML.slice(0, 80))"
    )
    assert over == []


def test_all_is_there_without_scripts(browser: Browser, file: Path) -> None:
    browser.resize(1366, 768)
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.call("Page.navigate", url="about:blank")
        browser.call("Page.navigate", url=file.as_uri())
        browser.wait("document.querySelector('footer') && document.querySelectorAll('svg.map').length > 0")
        assert shown(browser, "button.copy") == 0 and shown(browser, "article.finding") > 5
        browser.run("document.querySelector('#show-error').click()")
        assert shown(browser, "article.finding.error") == 0
    finally:
        browser.call("Emulation.setScriptExecutionDisabled", value=False)


def test_a_print_shows_what_is_folded(page: Browser) -> None:
    page.resize(718, 1046)  # A4 within its margins
    page.call("Emulation.setEmulatedMedia", media="print")
    assert page.run("document.documentElement.scrollWidth") == 718
    heights = page.run(
        "[...document.querySelectorAll('details.print:not([open])')].map(d => d.getBoundingClientRect().height - "
        "d.querySelector('summary').getBoundingClientRect().height)"
    )
    page.call("Emulation.setEmulatedMedia", media="")
    assert heights and min(heights) > 20


def test_ten_thousand_frames_open_at_once(browser: Browser, tmp_path: Path) -> None:
    report = sample(1500)
    assert len(report["frames"]) >= 10_000
    file = tmp_path / "large.html"
    file.write_text(render(report), encoding="utf-8")
    assert file.stat().st_size < 15_000_000
    start = time.perf_counter()
    browser.open(file.as_uri())
    browser.run("new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))")
    assert time.perf_counter() - start < 3.0
