"""The projects that use a store: garbage is only what none of them needs.

Each project registers in the store when it first uses it, so that collecting garbage for one of them spares
what the others need.
"""

import json
import socket
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bagassets.base.errors import StoreError
from bagassets.base.files import remove, write_atomically
from bagassets.store.canonical import digest_json

_FOLDER = "users"


@dataclass(frozen=True, order=True)
class User:
    """A project that uses a store.

    Attributes:
        recipe: its recipe file.
        host: its machine.
        store: path of the store on that machine, at the time of registration.
    """

    recipe: Path
    host: str
    store: Path = Path()

    @property
    def has_moved(self) -> bool:
        """True if the project was moved together with the store inside it, which makes this note obsolete."""
        return self.is_here and not self.recipe.exists() and not self.store.exists()

    @property
    def is_here(self) -> bool:
        """True if the project is on this machine, by its host name."""
        return self.host == socket.gethostname()


def note_user(root: Path, recipe_file: Path) -> None:
    """Register the project of a recipe as a user of the store in `root`; cheap if it is registered already.

    A store that cannot be written is only read, and needs no note.
    """
    user = User(recipe_file.absolute(), socket.gethostname(), root.absolute())
    path = _file(root, user)
    content = json.dumps(vars(user), sort_keys=True, default=str).encode()
    with suppress(OSError):
        if not path.exists() or path.read_bytes() != content:  # a power loss may have torn it
            write_atomically(path, content, folders=True)


def users_of(root: Path) -> list[User]:
    """Return the projects that use the store in `root`, in order.

    Raises:
        StoreError: a note cannot be read, so some user of the store is unknown.
    """
    users = []
    for path in sorted((root / _FOLDER).glob("*.json")):
        try:
            value = json.loads(path.read_bytes())
            users.append(User(Path(value["recipe"]), str(value["host"]), Path(value["store"])))
        except FileNotFoundError:
            continue  # another `gc` has just found that the project is gone
        except (OSError, ValueError, KeyError, TypeError) as err:
            mend = (
                "check its disk, and try again"
                if isinstance(err, OSError)
                else "remove it, and build that project once, which writes it again"
            )
            raise StoreError(
                f"{path}: this note of a project that uses the store cannot be read ({err}); {mend}."
            ) from err
    return sorted(users)


def forget_user(root: Path, user: User) -> None:
    """Remove the note of a project that no longer exists."""
    remove(_file(root, user))


def _file(root: Path, user: User) -> Path:
    return root / _FOLDER / f"{digest_json([str(user.recipe), user.host, str(user.store)])[:32]}.json"
