"""The web server of a view: viser, on the own machine unless told otherwise."""

import contextlib
import ipaddress
import logging
import socket
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from jaxplore import _checks
from jaxplore._optional import import_optional

if TYPE_CHECKING:
    import viser

HOST = "127.0.0.1"
"""Address of the own machine."""
LARGEST_PORT = 65535


def open_server(host: str = HOST, port: int = 0, *, label: str) -> "viser.ViserServer":
    """Start a server; port 0 takes a free one, and `label` is the title of the page's panel.

    Pages of other web sites, which run in the same browser, are turned away. No page can ask the
    server to publish itself through viser's relay.
    """
    package = import_optional("viser", "view")
    number = _checks.whole_number("port", port, at_least=0)
    if number > LARGEST_PORT:
        raise ValueError(f"port is {number}; accepted: at most {LARGEST_PORT}")
    # viser waits for ever at an address that it cannot use, and takes another port if one is taken.
    _check_address(host, number)
    # Of a class made here, because viser is imported at its first use.
    private = type("PrivateServer", (package.ViserServer,), {"request_share_url": _refuse_to_share})
    with _silence():
        server: viser.ViserServer = private(host=host, port=number, label=label, verbose=False)
    if number not in (0, server.get_port()):
        close_server(server)
        raise ValueError(f"port is {number}, which is in use; accepted: a free one, or 0 for any")
    _turn_away_other_sites(server)
    for name in ("websockets.server", "asyncio"):
        logger = logging.getLogger(name)
        if not any(isinstance(each, _NoTracebacks) for each in logger.filters):
            logger.addFilter(_NoTracebacks())
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
    server.gui.main_panel.dock_right()
    return server


def close_server(server: "viser.ViserServer") -> None:
    """Stop a server; pages that show it lose their connection."""
    with _silence():
        server.stop()


def link(server: "viser.ViserServer") -> str:
    """Return the address to open in a browser."""
    host = server.get_host()
    with contextlib.suppress(ValueError):
        address = ipaddress.ip_address(host)
        # No browser opens the address that stands for all of this machine's.
        if address.is_unspecified:
            host = socket.gethostname()
        elif address.version == 6:
            host = f"[{host}]"
    return f"http://{host}:{server.get_port()}"


def is_public(host: str) -> bool:
    """Return whether other machines may reach a server at an address."""
    if host == "localhost":
        return False
    try:
        return not ipaddress.ip_address(host).is_loopback
    except ValueError:
        return True


def _check_address(host: str, port: int) -> None:
    try:
        where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or "not an address"
        raise ValueError(
            f"host is {host!r} ({reason}); accepted: an address of this machine"
        ) from None
    with socket.socket(where[0], where[1]) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(where[4])
        except OSError as error:
            if port:
                raise ValueError(
                    f"port is {port} at {host} ({error.strerror}); accepted: a free one, or 0 for "
                    "any"
                ) from None
            raise ValueError(
                f"host is {host!r} ({error.strerror}); accepted: an address of this machine"
            ) from None


class _NoTracebacks(logging.Filter):
    """Leaves out what viser could not make of what came over a connection.

    Anyone who reaches the port can send bytes that are none of its messages. Errors of our own
    callbacks are kept.
    """

    def filter(self, record: logging.LogRecord) -> bool:
        modules, trace = [], record.exc_info[2] if record.exc_info else None
        while trace is not None:
            modules.append(str(trace.tb_frame.f_globals.get("__name__", "")).partition(".")[0])
            trace = trace.tb_next
        return "viser" not in modules or "jaxplore" in modules


@contextlib.contextmanager
def _silence() -> Any:
    """Let viser print nothing: the command prints the link itself."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def _refuse_to_share(_: Any, verbose: bool = True) -> None:
    """Stand in for the method that publishes the server; a page can ask for it."""


def _turn_away_other_sites(server: Any) -> None:
    """Close connections that a page of another web site opened.

    Browsers let every page open a WebSocket to this machine, and name the page's site.
    """
    from websockets.exceptions import ConnectionClosed

    connections = server._websock_server

    async def check(opened: Any) -> None:
        connection = connections._live_connections[opened.client_id]
        headers = connection.request.headers
        origin = headers.get("Origin")
        # Programs that are no browser send none.
        if origin is None or urlsplit(origin).netloc == headers.get("Host"):
            return
        await connection.close(1008, "another web site")
        # What was received before the end of the connection must not be read by viser.
        with contextlib.suppress(ConnectionClosed):
            while True:
                await connection.recv()

    connections.on_client_connect(check)
