"""The labelling page through HTTP: a real process serves it."""

import contextlib
import http.client
import json
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random
from urllib.parse import quote

import pytest
from label_program import (
    QUESTION,
    Address,
    clip_id,
    make_folder,
    program,
    served_here,
)

from manip.errors import UserError
from manip.preferences.comparisons import COMPARISONS, valid_comparisons
from manip.preferences.page.clip_drawing import ClipDrawing
from manip.preferences.page.page_input import LONGEST
from manip.preferences.page.page_server import listen

VIDEO = b"a video"
API = ("/api/settings", f"/api/clips/{clip_id(0)}")
POSTS = ("/api/view", "/api/answer", "/api/undo")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = make_folder(tmp_path_factory.mktemp("preferences"), 12, VIDEO)
    (folder.parent / "secret.mp4").write_text("not for the page")
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> Iterator[Address]:
    with served_here(folder) as page:
        yield page


def test_the_page_loads_its_own_files_only(page: Address) -> None:
    status, text, headers = page.request("/", Authorization="")
    assert status == 200
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert b"http" not in text  # no address of another machine


@pytest.mark.parametrize("given", ["", "Bearer ", "Bearer wrong", "Basic é"])
def test_data_need_the_token(page: Address, given: str) -> None:
    header = {"Authorization": given.encode("utf-8").decode("latin-1")}
    for path in API:
        assert page.request(path, **header)[0] == 401
    for path in POSTS:
        assert page.request(path, {"labeller": "Ana"}, **header)[0] == 401


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", ""])
def test_requests_to_another_name_are_refused(page: Address, host: str) -> None:
    for path in ("/", "/static/label.js", *API):
        assert page.request(path, Host=host)[0] == 400


def test_it_listens_on_this_machine_only(page: Address) -> None:
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", page.port), timeout=5)


@pytest.mark.parametrize(
    "path",
    [
        "../secret", "../../secret", "..%2F..%2Fsecret", "%2e%2e%2f%2e%2e%2fsecret",
        "....//secret", quote(clip_id(0) + "\0"), clip_id(0) + ".mp4", clip_id(0)[:-1],
    ],
)  # fmt: skip
def test_clips_are_read_from_their_folder_only(page: Address, path: str) -> None:
    status, text, _ = page.request(f"/api/clips/{path}")
    assert status in (400, 404)
    assert b"not for" not in json.dumps(text).encode()


def test_clips_are_sent_as_videos(page: Address) -> None:
    status, video, headers = page.request(f"/api/clips/{clip_id(0)}")
    assert (status, video) == (200, VIDEO)
    assert headers.get_content_type() == "video/mp4"


def test_names_are_sent_as_data(page: Address) -> None:
    name = '<img src=x onerror="alert(1)">'
    status, view, headers = page.request("/api/view", {"labeller": name})
    assert status == 200
    assert view["pair"]
    assert headers.get_content_type() == "application/json"
    assert page.request("/api/settings")[1]["question"] == QUESTION


@pytest.mark.parametrize(
    "change",
    [
        {"labeller": ""}, {"labeller": "a" * 81}, {"labeller": "a\n"+ "b"},
        {"labeller": "\x1b[31m"}, {"labeller": None}, {"labeller": ["Ana"]},
        {"answer": "both"}, {"answer": None}, {"answer": ["left"]},
        {"seconds": -1}, {"seconds": "2"}, {"seconds": None}, {"seconds": float("nan")},
        {"left": "../../secret"}, {"left": None}, {"right": 3},
    ],
)  # fmt: skip
def test_a_wrong_answer_is_refused(page: Address, folder: Path, change: dict) -> None:
    body = {"labeller": "Eve", "answer": "left", "seconds": 1.0}
    body |= page.view("Eve")["pair"]
    status, reply, _ = page.request("/api/answer", body | change)
    assert status == 400
    assert reply["error"]
    assert not page.view("Eve")["can_undo"]


@pytest.mark.parametrize("body", [[], "text", 1, None])
def test_a_body_of_another_form_is_refused(page: Address, body: object) -> None:
    headers = {"Content-Type": "application/json"}
    assert page.request("/api/view", body or [], **headers)[0] == 400


def test_a_form_of_another_site_is_refused(page: Address) -> None:
    form = {"Content-Type": "text/plain"}  # what a form can send
    assert page.request("/api/undo", {"labeller": "Ana"}, **form)[0] == 415


def test_a_large_request_is_refused(page: Address) -> None:
    assert page.request("/api/view", {"labeller": "a" * 100_000})[0] == 413


def test_an_answer_to_a_pair_that_is_not_shown_is_ignored(page: Address) -> None:
    before = page.view("Mia")
    other = {"left": clip_id(0xABC), "right": clip_id(0xDEF)}
    body = {"labeller": "Mia", "answer": "left", "seconds": 1.0, **other}
    assert page.request("/api/answer", body)[1] == before


def test_labellers_see_different_pairs_until_one_is_left(tmp_path: Path) -> None:
    with served_here(make_folder(tmp_path, 3, VIDEO), repeats=0) as page:
        first, second = page.view("Ana")["pair"], page.view("Bo")["pair"]
        assert first != second
        third = page.answer("left", "Ana")["pair"]
        assert third not in (first, second)
        last = page.answer("left", "Ana")["pair"]
        assert last == second  # Bo may have gone
        assert page.answer("right", "Ana")["pair"] is None
        progress = page.answer("right", "Bo")["progress"]
        assert progress["answered"] == progress["total"] == 3
        assert progress["own"] == {"same": 0, "total": 0}
        assert progress["between"] == {"same": 1, "total": 1}


def test_undo_goes_back_to_the_first_answer(tmp_path: Path) -> None:
    with served_here(make_folder(tmp_path, 4, VIDEO)) as page:
        shown = [page.view()["pair"]]
        shown += [page.answer(answer)["pair"] for answer in ("left", "skip", "equal")]
        undone = [page.undo() for _ in range(3)]
        assert [view["pair"] for view in undone] == shown[-2::-1]
        assert not undone[-1]["can_undo"]
        view = page.undo()
        assert view == undone[-1]
        assert view["progress"]["answered"] == 0


@pytest.mark.slow
def test_no_answer_is_lost_when_it_is_killed(tmp_path: Path) -> None:
    folder = make_folder(tmp_path, 9, VIDEO)
    answers = ["left", "right", "equal", "skip"]
    with program(folder) as page:
        for answer in answers:
            after = page.answer(answer)
    with program(folder) as again:
        assert again.view() == after
        assert again.token != page.token
    assert [each.answer for each in valid_comparisons(folder)] == answers


@pytest.mark.slow
def test_killed_twenty_times_while_labelling_no_answer_is_lost(tmp_path: Path) -> None:
    folder, random = make_folder(tmp_path, 2000, VIDEO), Random(0)
    confirmed: list[frozenset[str]] = []
    for kills in range(1, 21):
        with program(folder, "--repeats", "0") as page:
            killer = threading.Timer(random.uniform(0, 0.2), page.kill)
            with contextlib.suppress(OSError, http.client.HTTPException):
                while True:
                    pair = page.view()["pair"]
                    page.answer("left")
                    confirmed.append(frozenset((pair["left"], pair["right"])))
                    if len(confirmed) >= 2 * kills and not killer.ident:
                        killer.start()
    stored = [each.pair for each in valid_comparisons(folder)]
    assert len(confirmed) >= 40
    assert set(confirmed) <= set(stored)
    assert len(stored) == len(set(stored))
    assert len(stored) - len(confirmed) <= 20  # written, and killed before the reply


@pytest.mark.slow
def test_with_once_it_ends_after_the_last_answer(tmp_path: Path) -> None:
    folder = make_folder(tmp_path, 1, VIDEO)
    with program(folder, "--once") as page:
        page.answer("left")
        for _ in range(600):
            time.sleep(0.1)
            with contextlib.suppress(OSError):
                socket.create_connection(("127.0.0.1", page.port), 1).close()
                continue
            break
        with pytest.raises(OSError, match="refused"):
            page.view()
    assert len(valid_comparisons(folder)) == 1


def test_an_answer_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    folder = make_folder(tmp_path, 2, VIDEO)
    with served_here(folder) as page:
        pair = page.view()["pair"]
        (folder / COMPARISONS).symlink_to(tmp_path / "missing" / "file")
        body = {**pair, "labeller": "Ana", "answer": "left", "seconds": 2.5}
        assert "error" in page.request("/api/answer", body)[1]
        assert "error" in page.view()
        (folder / COMPARISONS).unlink()
        assert page.view()["pair"] == pair


def test_a_port_in_use() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(UserError, match=f"--port {port} cannot be opened"):
            listen(port)
    listen(port).close()


def test_another_port_where_the_usual_one_is_in_use() -> None:
    with listen(None) as first, listen(None) as second:
        assert first.getsockname() != second.getsockname()
        assert second.getsockname()[0] == "127.0.0.1"


def test_videos_are_not_written_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "videos").symlink_to(tmp_path / "elsewhere")
    drawing = ClipDrawing(tmp_path, "frontview")
    with pytest.raises(UserError, match="is a link"):
        drawing.draw("a" * 24, drawing.videos / "clip.mp4")


def test_a_time_of_many_digits_is_cut(page: Address, folder: Path) -> None:
    body = page.view("Max")["pair"] | {"labeller": "Max", "answer": "skip"}
    status, _, _ = page.request("/api/answer", body | {"seconds": 10**400})
    assert status == 200
    assert valid_comparisons(folder)[-1].seconds == LONGEST
