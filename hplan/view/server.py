"""The process of the live view: meshcat's server on 127.0.0.1, for as long as whoever started it lives.

It says its two addresses on standard output, `zmq_url=...` and `web_url=...`, and nothing from then on, so that nobody
has to read its pipes. It ends when its standard input does: that is a pipe whose other end closes with the process
that holds it, however that process ends.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

#: The one address that other machines do not reach.
HOST = "127.0.0.1"


def main() -> None:
    """Serve until standard input ends."""
    from meshcat.servers.zmqserver import ZMQWebSocketBridge

    class LocalBridge(ZMQWebSocketBridge):  # type: ignore[misc]
        """Meshcat's server, whose web part would listen on all interfaces."""

        def make_app(self) -> Any:
            app = super().make_app()
            listen = app.listen
            app.listen = lambda port, **more: listen(port, **{**more, "address": HOST})
            return app

    # An interrupt at the terminal is for the process that started this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    bridge = LocalBridge(host=HOST)
    sys.stdout.write(f"zmq_url={bridge.zmq_url}\nweb_url={bridge.web_url}\n")
    sys.stdout.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        os.dup2(nowhere, stream.fileno())
    bridge.ioloop.add_handler(sys.stdin.fileno(), lambda *_: bridge.ioloop.stop(), bridge.ioloop.READ)
    bridge.run()


if __name__ == "__main__":
    main()
