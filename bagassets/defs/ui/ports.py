"""The address of the web UI: options, free ports, and whether it answers."""

import argparse
import socket
from collections.abc import Iterable
from http.client import HTTPConnection, HTTPException

from bagassets.base.errors import BagAssetsError

__all__ = [
    "ANY_HOST",
    "answers",
    "free_port",
    "listening_arguments",
    "listening_options",
    "reachable",
    "refuse_taken_port",
    "url_of",
]

ANY_HOST = frozenset({"0.0.0.0", "::"})  # noqa: S104  (compared with, not bound to)
"""A server on such a host listens at every address of this machine."""


def listening_options() -> argparse.ArgumentParser:
    """Return a parser of the options from `listening_arguments`, as a parent of the parsers of the two processes."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--host", required=True)
    parser.add_argument("--port", required=True, type=int)
    parser.add_argument("--allow-host", action="append", default=[])
    parser.add_argument("--log-level", required=True)
    return parser


def listening_arguments(host: str, port: int, allow_hosts: Iterable[str], log_level: str) -> list[str]:
    """Return the arguments for a process of the web UI: its address, its further names, and the log level."""
    names = [f"--allow-host={name}" for name in allow_hosts]
    return ["--host", host, "--port", str(port), "--log-level", log_level, *names]


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
