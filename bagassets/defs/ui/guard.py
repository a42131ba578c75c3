"""Protection of the web UI against requests that other sites make with the user's browser.

There is no password, and a browser sends any page's requests to any address. So the `Host` must be a name of this UI,
since a foreign name could be pointed at this machine; a request that changes something must come from the UI's own
pages; and one that only reads must not change anything, since an image in any page can trigger it.
"""

import re
import socket
from collections.abc import Iterable
from ipaddress import ip_address

from graphql import GraphQLError, OperationDefinitionNode, OperationType, parse
from starlette.datastructures import QueryParams
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from bagassets.defs.ui.ports import ANY_HOST

_HOST = re.compile(r"(?:\[(?P<v6>[0-9a-f:.]+)\]|(?P<name>[^\[\]:/@?#\s]+))(?P<port>:\d*)?", re.IGNORECASE)
_ORIGIN = re.compile(r"(?P<scheme>https?)://(?P<netloc>[^/@?#\s]+)", re.IGNORECASE)
_DEFAULT_PORTS = {"http": ":80", "https": ":443"}
_READING = frozenset({"GET", "HEAD", "OPTIONS"})


def own_names(host: str, more: Iterable[str] = ()) -> frozenset[str]:
    """Return the names of a UI that listens on `host`: lower case, addresses without brackets.

    Args:
        host: name or address that it listens on.
        more: names by which others reach it.
    """
    names = {"localhost", "127.0.0.1", "::1", host, *more}
    if host in ANY_HOST:
        here = socket.gethostname()
        names |= {here, f"{here}.local", socket.getfqdn()}
    return frozenset(name.strip("[]").lower() for name in names)


class Guard:
    """Middleware around the web server.

    Args:
        app: the web server.
        names: from `own_names`.
    """

    def __init__(self, app: ASGIApp, names: frozenset[str]) -> None:
        self._app = app
        self._names = names

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer why it is refused."""
        refusal = self._refusal(scope) if scope["type"] in {"http", "websocket"} else None
        if refusal is None:
            await self._app(scope, receive, send)
        else:
            status, why = refusal
            await PlainTextResponse(f"{why}\n", status)(scope, receive, send)

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        """Return status and reason, or None for a request that is in order."""
        hosts = _values(scope, b"host")
        if len(hosts) != 1 or not self._is_own(hosts[0]):
            return 421, (
                "This web UI does not answer to that name. Open the address that `bagassets ui` printed, or start it with "
                "--allow-host NAME."
            )
        if scope["type"] == "websocket" or scope["method"] not in _READING:
            # Programs other than browsers send no origin.
            origins = _values(scope, b"origin")
            if not all(_is_same(origin, hosts[0]) for origin in origins):
                return 403, "This request comes from a page of another site."
        elif scope["path"].rstrip("/") == "/graphql" and _changes_something(scope):
            return 405, "Requests that change something must be sent with POST."
        return None

    def _is_own(self, host: str) -> bool:
        found = _HOST.fullmatch(host)
        if found is None:
            return False
        name = (found["v6"] or found["name"]).lower()
        if name in self._names:
            return True
        # An address, unlike a name, cannot be pointed at another machine.
        return bool(ANY_HOST & self._names) and _is_address(name)


def _values(scope: Scope, header: bytes) -> list[str]:
    return [value.decode("latin-1") for name, value in scope["headers"] if name == header]


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def _is_same(origin: str, host: str) -> bool:
    found = _ORIGIN.fullmatch(origin)
    if found is None:
        return False  # a sandboxed page sends `null`
    port = _DEFAULT_PORTS[found["scheme"].lower()]
    return found["netloc"].lower().removesuffix(port) == host.lower().removesuffix(port)


def _changes_something(scope: Scope) -> bool:
    """Return whether the URL of a request holds a GraphQL operation other than a query."""
    for text in QueryParams(scope["query_string"]).getlist("query"):
        try:
            document = parse(text)
        except (GraphQLError, RecursionError):
            continue  # the web server reports what is wrong with it
        operations = [one for one in document.definitions if isinstance(one, OperationDefinitionNode)]
        if any(one.operation != OperationType.QUERY for one in operations):
            return True
    return False
