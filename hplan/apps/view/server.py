"""The process of the live view: it serves one page on 127.0.0.1, for as long as whoever started it lives.

It reads the page from standard input, its length in a line of its own before it, says its address on standard output,
`web_url=...`, and nothing from then on, so that nobody has to read its pipes. It ends when its standard input does:
that is a pipe whose other end closes with the process that holds it, however that process ends.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

#: The one address that other machines do not reach.
HOST = "127.0.0.1"


def main() -> None:
    """Serve until standard input ends."""
    # An interrupt at the terminal is for the process that started this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    page = sys.stdin.buffer.read(int(sys.stdin.buffer.readline()))
    server = ThreadingHTTPServer((HOST, 0), _handler(page))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    sys.stdout.write(f"web_url=http://{HOST}:{server.server_port}/\n")
    sys.stdout.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        os.dup2(nowhere, stream.fileno())
    while sys.stdin.buffer.read(1):
        pass


def _handler(page: bytes) -> type[BaseHTTPRequestHandler]:
    """Answers with the page at `/`, and with nothing elsewhere."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            found = self.path.split("?")[0] == "/"
            content = page if found else b""
            self.send_response(HTTPStatus.OK if found else HTTPStatus.NOT_FOUND)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
            pass

    return Handler


if __name__ == "__main__":
    main()
