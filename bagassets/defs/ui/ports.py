"""The address of the web UI: free ports, and whether it answers."""

import socket
from http.client import HTTPConnection, HTTPException

from bagassets.base.errors import BagAssetsError

ANY_HOST = frozenset({"0.0.0.0", "::"})  # noqa: S104  (compared with, not bound to)
"""A server on such a host listens at every address of this machine."""


def reachable(host: str) -> str:
    """Return the address at which this machine reaches a server that listens on `host`."""
    return "127.0.0.1" if host in ANY_HOST else host


def free_port(host: str, start: int) -> int:
    """Return the first free port from `start` on.

    Raises:
        BagAssetsError: a hundred ports in a row are taken.
    """
    for port in range(start, min(start + 100, 65536)):
        if not _is_taken(host, port):
            return port
    raise BagAssetsError(f"no free port of {host} from {start} on; end a program that holds one.")


def url_of(host: str, port: int) -> str:
    """Return where a browser on this machine finds the web UI."""
    name = reachable(host)
    return f"http://[{name}]:{port}" if ":" in name else f"http://{name}:{port}"


def refuse_taken_port(host: str, port: int) -> None:
    """Raise if the port is taken, and name a free one.

    Raises:
        BagAssetsError: the port is taken, or the host is not one of this machine's.
    """
    if _is_taken(host, port):
        raise BagAssetsError(
            f"port {port} of {host} is taken, perhaps by another web UI; see {url_of(host, port)}, or choose "
            f"another port: --port {free_port(host, port + 1)}."
        )


def _is_taken(host: str, port: int) -> bool:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as err:
        raise BagAssetsError(
            f"{host}: no such address on this machine ({err.strerror}); --host 127.0.0.1 is for this machine only, "
            "--host 0.0.0.0 for all that reach it."
        ) from err
    with socket.socket(family, kind, protocol) as probe:
        # As the web server does, so that a port in TIME_WAIT counts as free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except OSError:
            return True
    return False


def answers(host: str, port: int) -> bool:
    """Return whether Dagster's web server answers."""
    connection = HTTPConnection(host, port, timeout=5.0)
    try:
        connection.request("GET", "/server_info")
        return connection.getresponse().status == 200
    except (OSError, HTTPException):
        return False
    finally:
        connection.close()
