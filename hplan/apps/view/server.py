"""Local web server for pages, in a thread of this process."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from contextlib import AbstractContextManager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import MappingProxyType
from typing import Any

from hplan.errors import HplanError


class LiveView(AbstractContextManager["LiveView"]):
    """A running server of a page and the pages it links to.

    It listens on 127.0.0.1. `close`, or the end of a `with` block, stops it.

    Attributes:
        url: Address of the page, accessible from this machine only.
    """

    def __init__(self, page: bytes, others: Mapping[str, bytes] = MappingProxyType({})) -> None:
        """Serve a page at a free port.

        Args:
            page: HTML of the page.
            others: HTML of the pages that it links to, by file name.

        Raises:
            HplanError: The server cannot start, for example if no port is free.
        """
        try:
            self._server = ThreadingHTTPServer(("127.0.0.1", 0), _handler({"": page, **others}))
        except OSError as error:
            raise HplanError(f"the page's server does not start: {error}") from error
        self.url = f"http://127.0.0.1:{self._server.server_port}/"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def is_running(self) -> bool:
        """True until the server has stopped."""
        return self._thread.is_alive()

    def wait(self, timeout_s: float | None = None) -> None:
        """Wait until the server stops, or at most `timeout_s` seconds.

        Without a timeout, and unless another thread calls `close`, it waits until interrupted.
        """
        self._thread.join(timeout_s)

    def close(self) -> None:
        """Stop the server and its thread."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def __exit__(self, *_: object) -> None:
        self.close()


def _handler(pages: Mapping[str, bytes]) -> type[BaseHTTPRequestHandler]:
    """Create a request handler that serves pages by name.

    The name of the main page is empty; other addresses give 404.
    """

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            content = pages.get(self.path.split("?")[0].removeprefix("/"))
            self.send_response(HTTPStatus.NOT_FOUND if content is None else HTTPStatus.OK)
            content = content or b""
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
            pass

    return Handler
