"""Start of the workbench's server and of the browser."""

from __future__ import annotations

import secrets
import socket
import threading
import webbrowser
from collections.abc import Callable
from contextlib import suppress

import uvicorn
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import Progress

from .app import build_app
from .workbench import Workbench

__all__ = ["serve"]

#: Host names of this computer.
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
#: Addresses that stand for all addresses of this computer.
_EVERYWHERE = ("0.0.0.0", "::")


def serve(
    bench: Workbench,
    begin: Callable[[Progress], None] | None,
    announce: Callable[[str], object],
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    token: bool = True,
    browser: bool = True,
) -> None:
    """Serve the workbench until it is interrupted.

    Parameters
    ----------
    bench
        The workbench.
    begin
        Computation to start with; None for none.
    announce
        Function that receives the page's address.
    host
        Address to listen on. Only this computer can connect to the default.
    port
        Port; 0 for any free port.
    token
        Whether the page's address contains a secret, without which requests are refused.
    browser
        Whether to open the page in the browser.

    Raises
    ------
    InputError
        If the address or port is not available.
    """
    secret = secrets.token_urlsafe(16) if token else ""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
    except (OSError, OverflowError) as error:
        listening.close()
        raise InputError(
            "studio", f"{host}, port {port} ({error})", "an address of this computer and a free port"
        ) from None
    name = f"[{host}]" if ":" in host else host
    hosts = None if host in _EVERYWHERE else frozenset({name, *_LOOPBACK})
    reachable = "127.0.0.1" if host in _EVERYWHERE else name
    address = f"http://{reachable}:{listening.getsockname()[1]}/{secret + '/' if secret else ''}"
    announce(address)
    settings = uvicorn.Config(
        build_app(bench, secret, hosts, begin=begin),
        log_level="warning",
        access_log=False,
        timeout_graceful_shutdown=1,
    )
    if browser:
        threading.Timer(0.5, webbrowser.open, [address]).start()
    with listening, suppress(KeyboardInterrupt):
        uvicorn.Server(settings).run(sockets=[listening])
