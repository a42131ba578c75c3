"""Code versions of assets: version, libraries, decoder plug-ins, and what of the recipe an asset may know.

Dagster cannot see parameters; through this string a changed recipe shows in its UI as a
changed code version.
"""

from bagassets.assets.asset import AnyAsset, as_json
from bagassets.plugins import installed_decoders
from bagassets.recipe.model import Recipe
from bagassets.store.canonical import digest_json

__all__ = ["code_version"]


def code_version(recipe: Recipe, asset: AnyAsset) -> str:
    """Return `<version>-<digest>` of an asset of recordings: of what it may know of every rig.

    Which rig a recording belongs to is decided by `match`, in order: that counts where rigs differ.
    """
    params = [as_json(asset.params(recipe, rig)) for rig in recipe.rigs]
    alike = all(one == params[0] for one in params)
    rigs = (
        params[:1]
        if alike
        else [[list(rig.match), one] for rig, one in zip(recipe.rigs, params, strict=True)]
    )
    plugins = [
        [plugin.name, plugin.as_json()]
        for family in asset.families
        for plugin in installed_decoders().of_family(family)
    ]
    package = [asset.distribution] if asset.distribution else []
    digest = digest_json([rigs, list(asset.libraries), plugins, *package])
    return f"{asset.version}-{digest[:12]}"
