"""The pages of documentation that come with an installation: those of the checkout, or those that the wheel brought."""

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import bagassets
from bagassets.errors import BagAssetsError

__all__ = ["find_pages", "page_title"]

_CHECKOUT = Path(bagassets.__file__).parents[1]
_INSTALLED = "share/doc/bagassets/docs"  # as pyproject.toml has it


def find_pages() -> dict[str, Path]:
    """Return the pages by name.

    Raises:
        BagAssetsError: there are none.
    """
    found = {path.stem: path for path in sorted(_in_checkout() or _in_wheel())}
    if not found:
        raise BagAssetsError(
            "documentation: its pages are not there; they lie in docs/ of a checkout, and pip installs them with a wheel of bagassets."
        )
    return found


def page_title(page: Path) -> str:
    """Return the first heading of a page."""
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("# "):
            return line.removeprefix("# ")
    return page.stem


def _in_checkout() -> list[Path]:
    # Beside an installed package may lie folders of others.
    return list((_CHECKOUT / "docs").glob("*.md")) if (_CHECKOUT / "pyproject.toml").is_file() else []


def _in_wheel() -> Iterator[Path]:
    try:
        installed = files("bagassets") or []
    except PackageNotFoundError:
        return
    for file in installed:
        if file.parent.as_posix().endswith(_INSTALLED) and file.suffix == ".md":
            path = Path(str(file.locate())).resolve()
            if path.is_file():
                yield path
