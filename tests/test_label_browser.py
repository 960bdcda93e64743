"""The labelling page in a real browser: `make test-browser`."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from label_program import Address, make_folder, program, served_here

from manip.io.video import save_animation
from manip.preferences.comparisons import valid_comparisons

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.browser

SETTLED = 400
"""Time [ms] after which the page takes an answer to a new pair."""

KEYS = {
    "left": "ArrowLeft",
    "right": "ArrowRight",
    "equal": "ArrowDown",
    "skip": "s",
}


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """One second of a moving bar."""
    path = tmp_path_factory.mktemp("video") / "video.mp4"
    frames = np.full((20, 120, 160, 3), 40, np.uint8)
    for step, frame in enumerate(frames):
        frame[40:80, 5 * step : 5 * step + 30] = 200
    save_animation(path, frames, 20)
    return path.read_bytes()


class Labeller:
    """A person at the page, in a browser window of their own."""

    def __init__(self, browser: "Browser", address: Address, name: str) -> None:
        self.name, self.address = name, address
        self.context = browser.new_context()
        self.tab: Page = self.context.new_page()
        self.errors: list[str] = []
        self.urls: list[str] = []
        self.tab.on("console", lambda m: self.errors.append(m.text))
        self.tab.on("pageerror", lambda e: self.errors.append(str(e)))
        self.tab.on("request", lambda r: self.urls.append(r.url))
        self.open(address)
        self.tab.fill("#name", name)
        self.tab.keyboard.press("Enter")
        self.settle()

    def open(self, address: Address) -> None:
        self.tab.goto(address.url)

    def settle(self) -> None:
        """Wait until the page takes an answer."""
        self.tab.locator("[data-answer=left]:enabled").wait_for()
        self.tab.wait_for_timeout(SETTLED)

    def press(self, answer: str) -> None:
        self._change(lambda: self.tab.keyboard.press(KEYS[answer]))

    def click(self, answer: str) -> None:
        self._change(lambda: self.tab.click(f"[data-answer={answer}]"))

    def undo(self) -> None:
        self._change(lambda: self.tab.keyboard.press("u"))

    def _change(self, act: Callable[[], None]) -> None:
        """Act, and wait until the number of answers has changed."""
        before = self.count
        act()
        self.tab.locator("#count", has_not_text=before).wait_for(state="attached")
        if not self.tab.is_visible("#end"):
            self.settle()

    @property
    def pair(self) -> tuple[str, ...]:
        """The clips on the screen."""
        return tuple((self.tab.get_attribute("body", "data-pair") or "").split())

    @property
    def count(self) -> str:
        return self.tab.inner_text("#count")


def given(folder: Path, name: str) -> list[str]:
    """A labeller's answers that are stored."""
    valid = valid_comparisons(folder)
    return [each.answer for each in valid if each.labeller == name]


def test_twenty_pairs_with_undo_reload_and_a_killed_server(
    browser: "Browser", video: bytes, tmp_path: Path
) -> None:
    folder = make_folder(tmp_path, 20, video)
    answers = ["left", "right", "equal", "skip"] * 5
    with program(folder, "--repeats", "0", "--question", "Which one?") as page:
        ana = Labeller(browser, page, "Ana <b>")
        assert ana.tab.inner_text("#question") == "Which one?"
        for answer in answers[:4]:
            ana.press(answer)
        for answer in answers[4:8]:
            ana.click(answer)
        shown = ana.pair
        ana.press("left")
        ana.tab.keyboard.press("u")
        ana.tab.wait_for_timeout(SETTLED)
        assert ana.pair == shown
        ana.tab.reload()
        ana.settle()
        assert ana.pair == shown
        assert ana.count == "8 of 20 pairs answered"
        assert given(folder, "Ana <b>") == answers[:8]
        assert ana.errors == []
    ana.tab.keyboard.press(KEYS["right"])
    ana.tab.locator("#message", has_text="Not saved. No connection").wait_for()
    assert ana.pair == shown
    with program(folder, "--repeats", "0") as page:
        ana.open(page)
        ana.tab.reload()  # from another address of the same page to its start
        ana.settle()
        assert ana.pair == shown
        ana.errors.clear()
        for answer in answers[8:]:
            ana.press(answer)
        assert ana.tab.is_visible("#end")
    assert given(folder, "Ana <b>") == answers
    assert ana.errors == []


def test_two_labellers_share_the_pairs(
    browser: "Browser", video: bytes, tmp_path: Path
) -> None:
    folder = make_folder(tmp_path, 8, video)
    with served_here(folder) as page:
        ana, bo = (Labeller(browser, page, name) for name in ("Ana", "Bo"))
        for _ in range(4):
            assert ana.pair != bo.pair
            ana.press("left")
            bo.press("right")
        assert bo.tab.is_visible("#end")
        ana.press("left")  # the last pair was shown to both: Bo could have left
        assert ana.tab.is_visible("#end")
        assert "people agree on 0 of 1" in ana.tab.inner_text("#end")
        assert given(folder, "Ana") == ["left"] * 5
        assert given(folder, "Bo") == ["right"] * 4
        assert ana.errors == bo.errors == []


def test_it_works_without_a_network(
    browser: "Browser", video: bytes, tmp_path: Path
) -> None:
    """Everything that the page loads comes from its own server."""
    with served_here(make_folder(tmp_path, 3, video)) as page:
        ana = Labeller(browser, page, "Ana")
        ana.press("left")
        places = {
            url.partition("#")[0].split("/")[2] for url in ana.urls if "//" in url
        }
    assert places == {f"127.0.0.1:{page.port}"}
    assert len(ana.urls) > 8
