"""Models of the settings of formats that installed packages add."""

from bagassets.base.errors import PluginError
from bagassets.base.plugins import FORMATS, Extension, installed_extensions
from bagassets.recipe.model_base import DatasetSettings

__all__ = ["section_model", "settings_model"]


def section_model(name: str) -> type[DatasetSettings] | None:
    """Return the model of the section `formats.<name>`; None if no installed package adds such a format.

    Raises:
        PluginError: the package cannot be used, or several packages add the format.
    """
    found = [extension for extension in installed_extensions(FORMATS) if extension.name == name]
    if not found:
        return None
    if len(found) > 1:
        owners = " and ".join(extension.distribution for extension in found)
        raise PluginError(f"format {name}: {owners} both add it, so neither is used; uninstall all but one.")
    return settings_model(found[0], found[0].load())


def settings_model(extension: Extension, found: object) -> type[DatasetSettings]:
    """Return the model of the settings of a format.

    Raises:
        PluginError: the format has no such model.
    """
    model = getattr(found, "settings", None)
    if not (isinstance(model, type) and issubclass(model, DatasetSettings)):
        raise extension.problem(
            f"its settings are {model!r}, not a model derived from bagassets.recipe.model_base.DatasetSettings"
        )
    return model
