"""`manip label`: compare pairs of clips on a page in the browser."""

import secrets
import threading
import time
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from werkzeug.serving import BaseWSGIServer

from manip.errors import UserError
from manip.io.printable import printable
from manip.preferences.clips import clip_ids, load_clip
from manip.preferences.page.clip_drawing import ClipDrawing
from manip.preferences.page.clip_videos import ClipVideos
from manip.preferences.page.drawn_pairs import fill_queue
from manip.preferences.page.label_app import PageSettings, make_app
from manip.preferences.page.label_session import LabelSession
from manip.preferences.page.page_input import check_name
from manip.preferences.page.page_server import listen, make_page_server
from manip.preferences.tastes import load_taste
from manip.programs import cli
from manip.sim.renderer import CLOSEUP

MOST_PAIRS = 100_000

MOST_REPEATED = 0.5
"""Largest share of repeated pairs: what is repeated must have been new once."""

LARGEST_PORT = 65_535

UNDO_SECONDS = 10
"""Time after the last answer in which it can be undone, with --once."""


@dataclass(frozen=True)
class Label:
    """Compare pairs of clips of a robot, on a page in the browser.

    The page shows two clips side by side; keys or buttons answer which is better. Each
    answer is added to DIR/comparisons.jsonl at once. Stop with Ctrl-C at any time: the
    same command goes on where it stopped. The page is served to this machine only and
    needs no network.
    """

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Folder of preferences, with the clips: `--preferences` of the training run."""
    labeller: str | None = None
    """Name of the person who compares. Without it, the page asks; several people can
    then work at once, each in a tab of their own, on different pairs."""
    taste: str | None = None
    """Name or file of a taste (see `manip list`) whose words are the question."""
    question: str | None = None
    """What to decide by, shown above the clips, in words of your own."""
    pairs: int | None = None
    """Draw random pairs of the folder's clips until its queue holds this number. Unless
    given, only the pairs that a training run waits for are shown."""
    repeats: float = 0.1
    """Share of the pairs shown that were answered before, 0 to 0.5, with their sides
    swapped. More of them measure more precisely how repeatable the answers are, and
    cost time."""
    seed: int = 0
    """Seed of the pairs that --pairs draws."""
    once: bool = False
    """End soon after the last pair is answered, instead of waiting for new pairs."""
    camera: str = CLOSEUP
    """Camera of the clips: closeup, workspace, or one of the model's own (frontview,
    ...)."""
    port: int | None = None
    """Port of the page on this machine. Unless given, 8321, or a free one."""
    browser: bool = True
    """Open the page in the browser. On a machine with other users, --no-browser keeps
    the address from the list of processes, where they could read it."""


def main(arguments: Sequence[str]) -> int:
    """Serve the page until Ctrl-C."""
    options = cli.parse(Label, arguments, "manip label")
    serve(options)
    return 0


def serve(options: Label) -> None:
    """Check the options, start to draw the clips, and serve the page until Ctrl-C.

    Raises:
        UserError: an option is out of range, there is no such folder, or nothing can
            draw here.
    """
    check(options)
    settings = settings_of(options)
    if options.pairs is not None:
        fill_queue(options.folder, options.pairs, options.seed)
    session = LabelSession(options.folder, options.repeats)
    drawing = ClipDrawing(options.folder, options.camera)
    videos = ClipVideos(drawing.videos, drawing.draw, session.clips_needed)
    print("Drawing the first clip ...", flush=True)
    videos.draw_first()
    opened = listen(options.port)
    token = secrets.token_urlsafe(16)
    server = make_page_server(make_app(session, videos, settings, token), opened)
    videos.start()
    if options.once:
        ending = threading.Thread(target=_end, args=(session, server), daemon=True)
        ending.start()
    try:
        _announce(f"http://127.0.0.1:{server.port}/#{token}", options.browser)
        server.serve_forever()
    finally:
        videos.close()


def _end(session: LabelSession, server: BaseWSGIServer) -> None:
    """Stop the server when no pair has waited for an answer for a while."""
    waited = 0
    while waited < UNDO_SECONDS:
        time.sleep(1)
        waited = 0 if session.open_count() else waited + 1
    server.shutdown()


def _announce(address: str, browser: bool) -> None:
    print(f"The page: {address}", flush=True)
    print("Stop with Ctrl-C. Every answer is saved at once.", flush=True)
    if browser and not webbrowser.open(address):
        print("No browser was opened: open the address in one.", flush=True)


def check(options: Label) -> None:
    """Raise `UserError` for an option that is out of range, or a missing folder."""
    if options.labeller is not None:
        check_name(options.labeller)
    if not options.folder.is_dir():
        raise UserError(f"there is no folder {printable(str(options.folder))}")
    if options.pairs is not None:
        cli.check_range("--pairs", options.pairs, 1, MOST_PAIRS)
    if options.port is not None:
        cli.check_range("--port", options.port, 1, LARGEST_PORT)
    if not 0 <= options.repeats <= MOST_REPEATED:
        raise UserError(
            f"--repeats must be from 0 to {MOST_REPEATED}, not {options.repeats}"
        )


def settings_of(options: Label) -> PageSettings:
    """What the page shows: labeller and question."""
    name = options.labeller and check_name(options.labeller)
    return PageSettings(question=_question(options), labeller=name)


def _question(options: Label) -> str:
    """The question that was given, or one about the clips' task and the taste.

    Raises:
        UserError: the task has no such taste, or its clip is damaged.
    """
    clips = clip_ids(options.folder)
    if options.question is not None or not clips:
        return options.question or "Which clip is better?"
    task = load_clip(options.folder, clips[0]).header.task
    words = f" {load_taste(task, options.taste).words}" if options.taste else ""
    return f"Which is the better {task}?{words}"
