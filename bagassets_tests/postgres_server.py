"""A real PostgreSQL on this machine, for tests."""

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

PORT = 5439  # of a socket in a folder of its own: nobody listens on it
PROGRAMS = next(
    (folder for folder in sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)), None
) or (Path(found).parent if (found := shutil.which("initdb")) else None)


class Postgres:
    """A server.

    Attributes:
        folder: its data, log and socket.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def url(self) -> str:
        """URL of its database `dagster`."""
        return self.url_of("dagster")

    def url_of(self, database: str) -> str:
        """Return the URL of a database."""
        # Without a driver in the URL SQLAlchemy takes psycopg 3, with which dagster-postgres cannot work.
        return f"postgresql+psycopg2://postgres@/{database}?host={self.folder}&port={PORT}"

    def create_database(self, name: str) -> None:
        """Create an empty database."""
        _run("createdb", *self._client(), name)

    def database_bytes(self, name: str) -> int:
        """Return the size of a database on the disk."""
        query = f"SELECT pg_database_size('{name}')"
        return int(_run("psql", *self._client(), "--no-align", "--tuples-only", "--command", query, name))

    def vacuum(self, name: str) -> None:
        """Let the room of rows that were replaced be used again, as autovacuum does before long."""
        _run("psql", *self._client(), "--quiet", "--command", "VACUUM", name)

    def start(self) -> None:
        """Start it, and wait until it answers."""
        options = f"-c listen_addresses= -c unix_socket_directories={self.folder} -c fsync=off -p {PORT}"
        self._control("--wait", "--options", options, "--log", str(self.folder / "log"), "start")

    def stop(self, mode: str = "immediate") -> None:
        """Stop it, as with a power loss unless `mode` says otherwise."""
        self._control("--mode", mode, "stop")

    def _client(self) -> list[str]:
        return ["--host", str(self.folder), "--port", str(PORT), "--username", "postgres"]

    def _control(self, *arguments: str) -> None:
        _run("pg_ctl", "--pgdata", str(self.folder / "data"), *arguments)


@contextmanager
def running_postgres() -> Iterator[Postgres]:
    """Run a new server with an empty database `dagster`."""
    # A short path without spaces that another user may enter, whatever TMPDIR says.
    folder = Path(tempfile.mkdtemp(prefix="bagassets-postgres-", dir="/tmp"))
    if os.getuid() == 0:
        os.chown(folder, pwd.getpwnam("postgres").pw_uid, -1)
    server = Postgres(folder)
    _run("initdb", "--pgdata", str(folder / "data"), "--auth", "trust", "--username", "postgres", "--no-sync")
    server.start()
    try:
        server.create_database("dagster")
        yield server
    finally:
        server.stop()
        shutil.rmtree(folder, ignore_errors=True)


def use_postgres(recipe_file: Path, url: str) -> None:
    """Have a project keep its records there."""
    file = recipe_file.with_name("dagster.yaml")
    config = yaml.safe_load(file.read_text())
    config["storage"] = {"postgres": {"postgres_url": url}}
    file.write_text(yaml.safe_dump(config))


def _run(program: str, *arguments: str) -> str:
    """Run a program of PostgreSQL, which refuses to run as root; return what it prints."""
    user = {"user": "postgres"} if os.getuid() == 0 else {}
    command = [str(PROGRAMS and PROGRAMS / program), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd="/", **user)
    assert done.returncode == 0, done.stderr
    return done.stdout
