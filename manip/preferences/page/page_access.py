"""Who may use the page: this machine's browser, with the token of this start."""

import hmac

from flask import Flask, Response, abort, request

HOSTS = ["127.0.0.1", "localhost"]
"""Names of this machine. Another one in a request is an attack by DNS rebinding."""

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
        "media-src blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
"""The page loads and runs its own files only; no other page can show or read it."""

LARGEST = 2**14
"""Bytes of the largest request."""


def protect(app: Flask, token: str) -> None:
    """Answer only requests to this machine's name; those to /api/ need the token.

    The token is sent in a header, which the page of another site cannot do. The page
    reads it from its address after the #, which browsers do not send.
    """
    app.config.update(TRUSTED_HOSTS=HOSTS, MAX_CONTENT_LENGTH=LARGEST)
    expected = f"Bearer {token}".encode()

    @app.before_request
    def check_token() -> None:
        given = request.headers.get("Authorization", "").encode()
        if request.path.startswith("/api/") and not hmac.compare_digest(
            given, expected
        ):
            abort(401)

    @app.after_request
    def add_headers(response: Response) -> Response:
        response.headers.update(HEADERS)
        return response
