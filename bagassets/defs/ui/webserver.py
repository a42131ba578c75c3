"""Dagster's web server behind `Guard`, with our pictures and pages."""

import asyncio
from collections.abc import AsyncIterator, Iterable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress

import uvicorn
from dagster import DagsterInstance
from dagster_webserver.version import __version__
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

from bagassets.base.errors import BagAssetsError
from bagassets.defs.dagster_private import (
    WorkspaceFileTarget,
    WorkspaceProcessContext,
    create_app_from_workspace_process_context,
)
from bagassets.defs.records.artifact_files import PAGES, PICTURES, page_file, picture_file
from bagassets.defs.ui.guard import Guard, own_names

# The defaults of `dagster-webserver`.
_STATEMENT_TIMEOUT_MS, _POOL_RECYCLE_S, _POOL_MAX_OVERFLOW = 15_000, 3600, 20
_POLL_MS = 2000
_NOT_MADE = {
    "map": "There is no map yet; `bagassets build` makes it, unless the recipe switches it off.\n",
    "report": "There is no report yet; `bagassets build` writes it, and `bagassets report` at any time.\n",
}
# The pages name what recordings contain. Their scripts run, but as those of no site: to this server their requests are
# those of a stranger, which `Guard` refuses, and they see nothing of the UI.
_PAGE_HEADERS = {
    "Content-Security-Policy": "sandbox allow-scripts allow-popups; frame-ancestors 'none'",
    "Cache-Control": "no-cache",
    "Referrer-Policy": "strict-origin-when-cross-origin",  # the servers of map tiles ask for one
    "X-Content-Type-Options": "nosniff",
}
# Dagster's tables of metadata are as wide as their longest word, a path or a digest, and a window shows the left of them: so
# words may break there, and pictures shrink. The third cell has the value if the second one has the time.
_ROWS = "[class*=etadataEntr] td"
_STYLE = f"""<style>{_ROWS}:not(:first-child){{overflow-wrap:anywhere}}{_ROWS}:nth-child(3):has(*){{width:100%}}
{_ROWS} td:nth-child(n){{min-width:7ch;width:auto;overflow-wrap:anywhere}}{_ROWS} th{{overflow-wrap:normal}}
{_ROWS} img{{max-width:100%}}a[href^="{PAGES}/"]:empty::before{{content:attr(title)}}</style></head>""".encode()


@contextmanager
def web_server(
    instance: DagsterInstance, workspace: str, host: str, port: int, allow_hosts: Iterable[str]
) -> Iterator[uvicorn.Server]:
    """Yield Dagster's web server, which is yet to be run.

    Args:
        instance: the instance that it shows.
        workspace: a workspace.yaml.
        host: address to listen on.
        port: port to listen on.
        allow_hosts: further names by which browsers reach it.
    """
    instance.optimize_for_webserver(_STATEMENT_TIMEOUT_MS, _POOL_RECYCLE_S, _POOL_MAX_OVERFLOW)
    with WorkspaceProcessContext(
        instance,
        version=__version__,
        read_only=False,
        workspace_load_target=WorkspaceFileTarget(paths=[workspace]),
        code_server_log_level="warning",
    ) as context:
        app = create_app_from_workspace_process_context(
            context, live_data_poll_rate=_POLL_MS, lifespan=_until_cancelled
        )
        # Before the page of the UI, which answers to every address.
        app.router.routes.insert(0, Route(f"{PICTURES}/{{digest}}/{{name:path}}", _picture))
        app.router.routes.insert(0, Route(f"{PAGES}/{{name}}", page))
        app.router.routes[:] = map(styled, app.router.routes)
        app.add_middleware(Guard, names=own_names(host, allow_hosts))
        yield uvicorn.Server(uvicorn.Config(app, host, port, log_level="warning"))


def styled(route: BaseRoute) -> BaseRoute:
    """Return a route that adds our style to the page of the UI; any other route as it is."""
    if not isinstance(route, Route) or route.path not in {"/", "/{path:path}"}:
        return route

    def index(request: Request) -> Response:
        answer: Response = route.endpoint(request)
        headers = {name: value for name, value in answer.headers.items() if name != "content-length"}
        return HTMLResponse(bytes(answer.body).replace(b"</head>", _STYLE, 1), answer.status_code, headers)

    return Route(route.path, index)


def _picture(request: Request) -> Response:
    try:
        file = picture_file(request.path_params["digest"], request.path_params["name"])
    except BagAssetsError as err:
        return PlainTextResponse(f"{err}\n", 404)
    if file is None:
        return PlainTextResponse("There is no such picture in the store.\n", 404)
    # An artifact never changes.
    headers = {"Cache-Control": "private, max-age=31536000, immutable", "X-Content-Type-Options": "nosniff"}
    return FileResponse(file, headers=headers)


def page(request: Request) -> Response:
    """Answer with the map or the report of the project."""
    name = request.path_params["name"]
    try:
        file = page_file(name)
    except BagAssetsError as err:
        return PlainTextResponse(f"{err}\n", 404)
    if file is None or not file.is_file():
        return PlainTextResponse(_NOT_MADE.get(name, "There is no such page.\n"), 404)
    return FileResponse(file, media_type="text/html", headers=_PAGE_HEADERS)


@asynccontextmanager
async def _until_cancelled(_app: Starlette) -> AsyncIterator[None]:
    with suppress(asyncio.CancelledError):  # uvicorn cancels this on Ctrl-C
        yield
