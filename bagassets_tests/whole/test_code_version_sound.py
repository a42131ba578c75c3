"""Dagster's markers may say too much, never too little: whenever what an asset's action reads changes by the recipe, its
code version changes.

Changes are generated from the model of the recipe, so that no field can be forgotten, and tried on recordings whose
artifacts upstream are the same before and after.
"""

import dataclasses
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from typing import Literal, get_args, get_origin

import pytest
from pydantic import BaseModel

from bagassets.assets.asset import as_json
from bagassets.assets.selection import choose_rig, skip_reason
from bagassets.assets.track import TRACK
from bagassets.base.errors import BagAssetsError
from bagassets.formats.catalogue import known_assets, recording_assets
from bagassets_tests.asset_matrix import recipes, recordings, write_files
from bagassets_tests.recipe_changes import all_fields, changes

pytestmark = pytest.mark.once

ASSETS = {asset.name: asset for asset in known_assets()}
# What decides whether a recording takes part, and nothing about what is made of it.
PARTICIPATION = ("Rig.required", "Bags.min_duration_s")


@dataclass(frozen=True)
class Step:
    """A recipe, the same with one change, and what that did.

    Attributes:
        recipe: name of the recipe in the matrix.
        field: what was changed, `Class.field`.
        change: the same for people.
        versions: asset -> whether its code version changed.
        actions: asset -> whether any recording's actions changed.
    """

    recipe: str
    field: str
    change: str
    versions: Mapping[str, bool]
    actions: Mapping[str, bool]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    write_files(folder)
    return folder


@pytest.fixture(scope="module")
def bases(folder):
    return recipes(folder)


@pytest.fixture(scope="module")
def drives():
    return recordings()


@pytest.fixture(scope="module")
def changed(bases):
    """Name of a recipe -> its changes: of all fields in the full one, of what differs among recipes in the others."""
    sections = ("clock", "rigs", "scenes", "vision", "lerobot", "preview")
    return {
        name: list(changes(recipe, None if name == "full" else sections)) for name, recipe in bases.items()
    }


@pytest.fixture(scope="module")
def steps(bases, changed, drives):
    return [step for name, recipe in bases.items() for step in _steps(name, recipe, changed[name], drives)]


def _steps(name, recipe, changed, drives):
    before = recording_assets(recipe)
    known = _door(before)
    actions = {
        (asset, drive.path): _actions(asset, before, drive) for asset in before.names for drive in drives
    }
    for change in changed:
        after = recording_assets(change.recipe)
        now = _door(after)
        altered = {}
        for asset in set(before.names) & set(after.names):
            # An asset looks through no other door: where it is shown the same, it does the same.
            unseen = known[asset] == now[asset] and known["rigs"] == now["rigs"]
            altered[asset] = not unseen and any(
                (new := _actions(asset, after, drive)) != actions[asset, drive.path]
                and None not in (new, actions[asset, drive.path])
                for drive in drives
            )
        versions = {asset: before.versions[asset] != after.versions[asset] for asset in altered}
        yield Step(name, change.field, change.name, versions, altered)


def _door(assets):
    """Return what each asset may know of a recipe, and which recordings it is of, to the last detail."""
    rigs = assets.recipe.rigs
    known = {asset.name: repr([assets.params(asset, rig) for rig in rigs]) for asset in assets}
    return {**known, "rigs": [rig.match for rig in rigs]}


def _actions(name, assets, drive):
    """Return channel -> digest of the action; `refused` if there can be none; None if the recording takes no part."""
    recipe, asset = assets.recipe, assets[name]
    rig = choose_rig(recipe, drive.path)
    if name != "inventory" and skip_reason(recipe, rig, drive.facts.inventory) is not None:
        return None
    try:
        uses = asset.use(assets.params(asset, rig or recipe.rigs[0]), drive.facts)
    except BagAssetsError:
        return "refused"
    return {channel: _digest(asset, use, drive) for channel, use in uses.items()}


def _digest(asset, use, drive):
    """Return the digest of an action and of what is tried where it failed, or `refused` if it cannot be."""
    if isinstance(use, BagAssetsError):
        return "refused"
    instead = None if asset.fallback is None else asset.fallback(use, "it is damaged.")
    return [asset.action(one, drive.facts.inventory).digest for one in (use, instead) if one is not None]


def test_every_field_of_the_recipe_is_changed(steps):
    assert all_fields() - {step.field for step in steps} == set()


def test_where_actions_differ_code_versions_differ(steps):
    silent = {
        (asset, step.field): f"{asset} in {step.recipe}: {step.change}"
        for step in steps
        for asset, differ in step.actions.items()
        if differ and not step.versions[asset]
    }
    assert not silent, "\n".join(silent[each] for each in sorted(silent))


def test_every_asset_is_changed_by_something(steps):
    """Else the test above would say nothing of it."""
    changed = {asset for step in steps for asset, differ in step.actions.items() if differ}
    assert changed == set(ASSETS)


def test_fields_of_participation_are_in_no_version(steps):
    marked = {
        (asset, step.field)
        for step in steps
        if step.field in PARTICIPATION
        for asset, differ in step.versions.items()
        if differ
    }
    assert marked == set()
    assert {step.field for step in steps} >= set(PARTICIPATION)


def test_match_counts_only_where_rigs_differ(bases):
    """Swapped among rigs that an asset cannot tell apart, it changes nothing; else it does."""
    for name, known in (
        ("alike", {"nuscenes_tables", "vision_sequences"}),
        (
            "full",
            {"calibration", "ego_poses", "annotations", "frames", "sweeps", "nuscenes_tables", "preview"},
        ),
    ):
        recipe = bases[name]
        one, other = recipe.rigs
        differing = {
            asset.name
            for asset in recording_assets(recipe)
            if as_json(asset.params(recipe, one)) != as_json(asset.params(recipe, other))
        }
        assert differing >= known, name
        swapped = recipe.model_copy(
            update={
                "rigs": (
                    one.model_copy(update={"match": other.match}),
                    other.model_copy(update={"match": one.match}),
                )
            }
        )
        before, after = recording_assets(recipe).versions, recording_assets(swapped).versions
        assert {asset for asset in before if before[asset] != after[asset]} == differing, name
    alone = bases["clouds"]
    (rig,) = alone.rigs
    matched = alone.model_copy(update={"rigs": (rig.model_copy(update={"match": ("car/**",)}),)})
    before, after = recording_assets(alone).versions, recording_assets(matched).versions
    assert {asset for asset in before if before[asset] != after[asset]} == set()


# --- no dead weight -----------------------------------------------------------------------


@pytest.mark.parametrize("asset", [*ASSETS.values(), TRACK], ids=lambda asset: asset.name)
def test_every_parameter_changes_what_is_read_of_some_recording(asset, bases, changed, drives):
    """A parameter that changes no action marks for nothing."""
    seen = {}
    for name, recipe in bases.items():
        for each in (recipe, *(change.recipe for change in changed[name])):
            if asset.enabled(each):
                seen |= {repr(params): params for params in (asset.params(each, rig) for rig in each.rigs)}
    values = defaultdict(dict)
    for params in seen.values():
        for owner, name, value, _ in _leaves(params):
            values[owner, name][repr(value)] = value
    # What no change of a recipe changes marks for nothing.
    dead = {field for field, found in values.items() if len(found) > 1}
    for params in seen.values():
        if not dead:
            break
        before = None
        for owner, name, value, replaced in _leaves(params):
            if (owner, name) not in dead:
                continue
            if before is None:
                before = _used(asset, params, drives)
            others = [other for text, other in values[owner, name].items() if text != repr(value)]
            if any(_used(asset, replaced(other), drives, instead=before) != before for other in others):
                dead.discard((owner, name))
    assert dead == set()


def _used(asset, params, drives, instead=None):
    """Return the actions of each recording; where there can be none, those of `instead`."""
    digests = []
    for number, drive in enumerate(drives):
        before = None if instead is None else instead[number]
        try:
            uses = asset.use(params, drive.facts)
        except (BagAssetsError, LookupError):  # values that never go together
            digests.append(before)
            continue
        digests.append(
            {
                name: (before or {}).get(name)
                if isinstance(use, BagAssetsError)
                else _digest(asset, use, drive)
                for name, use in uses.items()
            }
        )
    return digests


def _leaves(value, replaced=lambda new: new):
    """Yield the fields of parameters down to what has none: owner, name, value, and what puts another value there."""
    for name, item in _fields_of(value):

        def put(new, value=value, name=name):
            return replaced(_with(value, name, new))

        yield type(value).__name__, name, item, put
        yield from _below(item, put)


def _below(value, replaced):
    if is_dataclass(value) or isinstance(value, BaseModel):
        yield from _leaves(value, replaced)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _below(item, lambda new, key=key: replaced({**value, key: new}))
    elif isinstance(value, tuple):
        for at, item in enumerate(value):
            yield from _below(item, lambda new, at=at: replaced((*value[:at], new, *value[at + 1 :])))


def _fields_of(value):
    if isinstance(value, BaseModel):
        # What only tells one model from another has no other value.
        own = type(value).model_fields
        return [
            (name, getattr(value, name))
            for name, field in own.items()
            if get_origin(field.annotation) is not Literal or len(get_args(field.annotation)) > 1
        ]
    return [(own.name, getattr(value, own.name)) for own in dataclasses.fields(value)]


def _with(value, name, new):
    if isinstance(value, BaseModel):
        return value.model_copy(update={name: new})
    return dataclasses.replace(value, **{name: new})
