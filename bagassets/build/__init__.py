"""The engine: it derives the actions of a recording and runs those whose results are not in the store.

It knows the assets by name, and nothing about Dagster.

`bagassets.build(recipe)` brings the datasets of a recipe up to date and returns a report; see `bagassets.notebook.build`.
"""

import sys
from importlib import import_module
from types import ModuleType


class _Callable(ModuleType):
    """Package and function share the name `bagassets.build`: importing anything of the one would hide the other."""

    def __call__(self, *arguments: object, **options: object) -> object:
        return import_module("bagassets.notebook").build(*arguments, **options)


sys.modules[__name__].__class__ = _Callable
