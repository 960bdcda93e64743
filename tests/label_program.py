"""The labelling page, served here or by `manip label`, and requests to it."""

import http.client
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from manip.preferences.page.clip_drawing import VIDEOS
from manip.preferences.page.clip_videos import ClipVideos
from manip.preferences.page.label_app import PageSettings, make_app
from manip.preferences.page.label_session import LabelSession
from manip.preferences.page.page_server import listen, make_page_server
from manip.preferences.pair_queue import Pair, append_pairs
from manip.sim.renderer import CLOSEUP

QUESTION = "Which is <b>gentler</b>?"


def clip_id(number: int) -> str:
    return f"{number:024x}"


def make_folder(folder: Path, pairs: int, video: bytes) -> Path:
    """A folder of preferences whose clips are drawn already, all with one video."""
    videos = folder / VIDEOS / CLOSEUP
    videos.mkdir(parents=True)
    for number in range(2 * pairs):
        (videos / f"{clip_id(number)}.mp4").write_bytes(video)
    numbers = range(0, 2 * pairs, 2)
    append_pairs(folder, [Pair(0, clip_id(n), clip_id(n + 1)) for n in numbers])
    return folder


@dataclass(frozen=True)
class Address:
    """Where a page is served, its token, and what kills its program."""

    port: int
    token: str
    kill: Callable[[], None] | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/#{self.token}"

    def request(
        self, path: str, body: object = None, **headers: str
    ) -> tuple[int, Any, http.client.HTTPMessage]:
        """Status, body and headers of a GET, or of a POST with a JSON body."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        sent = {"Authorization": f"Bearer {self.token}", **headers}
        data = None if body is None else json.dumps(body)
        if data is not None:
            sent.setdefault("Content-Type", "application/json")
        connection.request("GET" if data is None else "POST", path, data, sent)
        response = connection.getresponse()
        content = response.read()
        connection.close()
        kind = response.headers.get_content_type()
        parsed = json.loads(content) if kind == "application/json" else content
        return response.status, parsed, response.headers

    def view(self, labeller: str = "Ana") -> dict[str, Any]:
        return self.request("/api/view", {"labeller": labeller})[1]

    def answer(self, answer: str, labeller: str = "Ana") -> dict[str, Any]:
        """Answer the pair on the labeller's screen."""
        pair = self.view(labeller)["pair"]
        body = {"labeller": labeller, "answer": answer, "seconds": 2.5}
        return self.request("/api/answer", {**pair, **body})[1]

    def undo(self, labeller: str = "Ana") -> dict[str, Any]:
        return self.request("/api/undo", {"labeller": labeller})[1]


def refuse(clip: str, path: Path) -> None:
    """Draw nothing: the videos of `make_folder` are there."""
    raise AssertionError(f"{clip} is to be drawn to {path}")


@contextmanager
def served_here(folder: Path, repeats: float = 0.1) -> Iterator[Address]:
    """Serve a folder's page from a thread."""
    session = LabelSession(folder, repeats)
    videos = ClipVideos(folder / VIDEOS / CLOSEUP, refuse, session.clips_needed)
    app = make_app(session, videos, PageSettings(QUESTION, None), "a-token")
    server = make_page_server(app, listen(None))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield Address(server.port, "a-token")
    finally:
        server.shutdown()
        thread.join()


def command(folder: Path, *options: str) -> list[str]:
    program = "from manip.programs.main import main; main()"
    return [sys.executable, "-c", program, "label", str(folder), *options]


@contextmanager
def program(folder: Path, *options: str) -> Iterator[Address]:
    """Run `manip label` as a process, which is killed (SIGKILL) at the end."""
    process = subprocess.Popen(
        command(folder, "--no-browser", *options), stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        lines = (line.strip() for line in process.stdout)
        place, _, token = next(line for line in lines if "/#" in line).partition("/#")
        yield Address(int(place.rpartition(":")[2]), token, process.kill)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
