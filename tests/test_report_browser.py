"""The report in a real browser, from the disk, without a network."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from report_pages import EPISODES, page, played

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.browser

PATIENCE = 120_000
"""Time [ms] for a step: scenes are drawn in software, maybe on a busy machine."""


@pytest.fixture(scope="module")
def report(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    record, episodes, replays = played(still=True)
    mixed = [replace(e, success_held=e.index == 2) for e in episodes.episodes]
    first = record, replace(episodes, episodes=mixed), replays
    path.write_text(page(first, played()), encoding="utf-8")
    return path


class Reader:
    """Opens the report and records what the page complains about and requests."""

    def __init__(self, browser: "Browser", report: Path, width: int) -> None:
        size = {"width": width, "height": 800}
        self.tab: Page = browser.new_context(viewport=size, offline=True).new_page()
        self.tab.set_default_timeout(PATIENCE)
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.tab.on("console", self._note)
        self.tab.on("pageerror", lambda e: self.errors.append(str(e)))
        self.tab.on("request", lambda r: self.requests.append(r.url.split(":")[0]))
        self.tab.goto(report.as_uri())
        self.panel = self.tab.locator(".replay").first
        self.panel.scroll_into_view_if_needed()
        self.tab.locator(".replay[data-ready]").first.wait_for()

    def _note(self, message) -> None:
        if message.type == "error":
            self.errors.append(message.text)

    def time(self) -> float:
        return self.tab.evaluate("document.querySelector('model-viewer').currentTime")

    def scrub(self, share: float) -> None:
        self.panel.locator("input[type=range]").evaluate(
            "(r, s) => { r.value = r.max * s; r.dispatchEvent(new Event('input')); }",
            share,
        )


@pytest.mark.parametrize("width", [1280, 375])
def test_a_failure_is_replayed_and_scrubbed(
    browser: "Browser", report: Path, width: int
) -> None:
    reader = Reader(browser, report, width)
    tab, panel = reader.tab, reader.panel
    assert tab.evaluate("document.documentElement.scrollWidth") == width
    panel.locator("tr.failed.playable").nth(1).click()
    assert panel.locator(".tag").inner_text() == "episode 1: failed"
    panel.get_by_role("button", name="Pause").click()
    length = float(panel.locator("input[type=range]").get_attribute("max"))
    panel.locator(".speed select").select_option("0.25")
    for share in (0.75, 1.0, 0.25):
        reader.scrub(share)
        assert reader.time() == pytest.approx(share * length, abs=0.03)
    panel.get_by_role("button", name="Play").click()
    start = reader.time()
    moved = (
        reader.time() != start for _ in range(100) if not tab.wait_for_timeout(100)
    )
    assert any(moved)
    rows = panel.locator("tbody tr:visible")
    assert rows.count() == EPISODES
    panel.locator(".only-failed").check()
    assert rows.count() == EPISODES - 1
    assert reader.errors == []
    assert set(reader.requests) <= {"file", "blob"}
