"""The routes of the labelling page."""

from dataclasses import asdict, dataclass

from flask import Flask, Response, jsonify, send_file
from werkzeug.exceptions import HTTPException, ServiceUnavailable

from manip.errors import UserError, one_line
from manip.preferences.clips import check_clip_id
from manip.preferences.page import page_input as sent
from manip.preferences.page.clip_videos import ClipVideos
from manip.preferences.page.label_session import LabelSession, LabelView
from manip.preferences.page.page_access import protect

WAIT = 20.0
"""Seconds that a request for a clip waits for its video."""


@dataclass(frozen=True)
class PageSettings:
    """What the page shows that is not in the folder."""

    question: str
    """What labellers decide by."""
    labeller: str | None
    """Name of the labeller; None: the page asks for it."""


def make_app(
    session: LabelSession, videos: ClipVideos, settings: PageSettings, token: str
) -> Flask:
    """Build the application: static files for all, /api/ for those with the token."""
    app = Flask(__name__)
    protect(app, token)
    app.register_error_handler(Exception, _report)
    app.add_url_rule("/", view_func=lambda: app.send_static_file("label.html"))
    app.add_url_rule("/api/settings", "settings", lambda: jsonify(asdict(settings)))
    app.add_url_rule("/api/clips/<clip>", "clip", lambda clip: _video(videos, clip))
    _add_posts(app, session)
    return app


def _add_posts(app: Flask, session: LabelSession) -> None:
    @app.post("/api/view")
    def view() -> Response:
        return _as_json(session.view(sent.sent_name()))

    @app.post("/api/answer")
    def answer() -> Response:
        name, pair = sent.sent_name(), sent.sent_pair()
        choice, seconds = sent.sent_answer(), sent.sent_seconds()
        return _as_json(session.answer(name, pair, choice, seconds))

    @app.post("/api/undo")
    def undo() -> Response:
        return _as_json(session.undo(sent.sent_name()))


def _as_json(view: LabelView) -> Response:
    """The view, without the pair's round, which would show whether it is a repeat."""
    return jsonify(asdict(view))


def _video(videos: ClipVideos, clip: str) -> Response:
    path = videos.wait_for(check_clip_id(clip), WAIT)
    if path is None:
        raise ServiceUnavailable("The clip is still being drawn.")
    return send_file(path.absolute(), mimetype="video/mp4")


def _report(error: Exception) -> tuple[Response, int]:
    """An error as JSON: the page shows its text."""
    if isinstance(error, HTTPException):
        return jsonify(error=error.description), error.code or 500
    if isinstance(error, UserError | OSError):
        return jsonify(error=one_line(error)), 400 if type(error) is UserError else 500
    raise error
