"""Start of the workbench's server and of the browser."""

from __future__ import annotations

import secrets
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import uvicorn
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import temporary_folder
from cboxlab.utils.progress import Progress

from .app import ANY_ADDRESS, build_app
from .workbench import Workbench

__all__ = ["serve"]

#: Host names of this computer.
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
#: Time after which the browser opens: the server has started by then, s.
_BROWSER_DELAY_S = 0.5
#: Signals at which the program ends: of ``kill`` and of a closed terminal, which Windows does not have.
_ENDING_SIGNALS = (signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else []))
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
    page: str = "",
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
    page
        Page to open, relative to the address; "" for the workbench.

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
    everywhere = {ANY_ADDRESS, socket.gethostname(), socket.getfqdn()} if host in _EVERYWHERE else {name}
    reachable = "127.0.0.1" if host in _EVERYWHERE else name
    address = f"http://{reachable}:{listening.getsockname()[1]}/{secret + '/' if secret else ''}{page}"
    announce(address)
    settings = uvicorn.Config(
        build_app(bench, secret, frozenset({*everywhere, *_LOOPBACK}), begin=begin),
        log_level="warning",
        access_log=False,
        timeout_graceful_shutdown=1,
    )
    _end_blocks_at_signals()
    with listening, ExitStack() as until_end, suppress(KeyboardInterrupt):
        if browser:
            file = _redirection(until_end.enter_context(temporary_folder()), address)
            threading.Timer(_BROWSER_DELAY_S, webbrowser.open, [file]).start()
        uvicorn.Server(settings).run(sockets=[listening])


def _end_blocks_at_signals() -> None:
    """Make the signals of ``kill`` and of a closed terminal end blocks, which remove files."""
    if threading.current_thread() is threading.main_thread():
        for number in _ENDING_SIGNALS:
            signal.signal(number, lambda received, _: sys.exit(128 + received))


def _redirection(folder: Path, address: str) -> str:
    """Address of a file, readable by this user only, that leads to a page.

    Other users of the computer can read the browser's command line. The page's secret therefore stands in the file.
    """
    path = folder / "open.html"
    path.touch(mode=0o600)
    path.write_text(f'<meta charset="utf-8"><meta http-equiv="refresh" content="0; url={address}">', encoding="utf-8")
    return path.as_uri()
