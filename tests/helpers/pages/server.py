"""The workbench on a server in a thread, for tests in a browser."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn
from cboxlab.validation.app.studio import Workbench, build_app

__all__ = ["served"]


@contextmanager
def served(bench: Workbench, token: str = "secret") -> Iterator[str]:
    """Address of the workbench's page; the server ends with the block. token : "" for none."""
    listening = socket.create_server(("127.0.0.1", 0))
    app = build_app(bench, token, frozenset({"127.0.0.1", "localhost"}), idle_s=1e9)
    server = uvicorn.Server(uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=1))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
    thread.start()
    try:
        yield f"http://127.0.0.1:{listening.getsockname()[1]}/{token}{'/' if token else ''}"
    finally:
        server.should_exit = True
        thread.join(20)
        listening.close()
