"""Serve the page on this machine only, until Ctrl-C."""

import socket

from flask import Flask
from werkzeug.serving import BaseWSGIServer, WSGIRequestHandler, make_server

from manip.errors import UserError, one_line

HOST = "127.0.0.1"

PORT = 8321
"""The port unless another is named; any free one where a program uses it."""


class _QuietHandler(WSGIRequestHandler):
    """Reports errors, and not each request."""

    def log_request(self, code: int | str = "-", size: int | str = "-") -> None:
        """Print nothing."""


def listen(port: int | None) -> socket.socket:
    """Open the port on this machine; by default `PORT`, or another if it is in use.

    Raises:
        UserError: the port that was named cannot be opened.
    """
    try:
        return socket.create_server((HOST, PORT if port is None else port))
    except OSError as error:
        if port is None:
            return socket.create_server((HOST, 0))
        raise UserError(
            f"--port {port} cannot be opened ({one_line(error)}): name another one, or "
            "leave --port out for one that is free"
        ) from None


def make_page_server(app: Flask, opened: socket.socket) -> BaseWSGIServer:
    """A server with a thread for each connection; `serve_forever` runs it."""
    host, port = opened.getsockname()
    server = make_server(
        host, port, app, True, request_handler=_QuietHandler, fd=opened.fileno()
    )
    opened.close()
    return server
