"""Formats and assets of installed packages that are wrong cost just themselves, and a sentence names the package."""

import json

import pytest
from click.testing import CliRunner

from bagassets.base.errors import DatasetError, PluginError, RecipeError
from bagassets.base.plugins import ASSETS, FORMATS
from bagassets.cli.main import root
from bagassets.defs.graph.checks import recording_checks
from bagassets.defs.records.naming import Naming
from bagassets.engine.run_action import run_action
from bagassets.formats.assembly import assemble
from bagassets.formats.catalogue import (
    catalogue,
    format_of,
    formats,
    installed_format,
    problems_of,
    recording_assets,
)
from bagassets.formats.checking import render_checks
from bagassets.formats.dataset_build import datasets_of
from bagassets.formats.dataset_lock import read_lock
from bagassets.formats.format import Part
from bagassets.recipe import load_recipe
from bagassets.recipe.format_settings import OUR_FORMATS
from bagassets.store.action import Step
from bagassets.store.store import Store
from bagassets_tests import in_process
from bagassets_tests.plugin_install import Site

HEAD = """
from pathlib import Path

from pydantic import Field

from bagassets.assets.asset import Asset, Use
from bagassets.formats.format import DatasetCheck, Format, Joined
from bagassets.recipe.model_base import DatasetSettings


class Settings(DatasetSettings):
    size: int = Field(3, ge=1, description="How large.")


def make(use, inputs, out):
    out.write_json("facts.json", {})
    return {}


PART = Asset(name="acme_part", version=1, title="ACME's part.", kinds=frozenset({"json"}),
             params=lambda recipe, rig: {}, use=lambda params, facts: {"": Use({})}, make=make,
             enabled=lambda recipe: "acme" in recipe.formats)
FIELDS = dict(
    name="acme", version=1, description="ACME's dataset.", kinds=frozenset({"acme"}), settings=Settings,
    part="acme_part", join=lambda members, settings, shares, out: Joined({}), links=lambda entry: iter(()),
    counts=lambda facts: {}, duration_s=lambda facts: 0.0, folder=lambda settings: "data", assets=(PART,),
)
"""
GOOD = HEAD + "ACME = Format(**FIELDS)\n"


def with_check(section):
    """The package, with a check of its asset that raises."""
    check = f'RecordingCheck("acme_sound", {section}, "Sound.", "it is not", lambda evidence: 1 / 0)'
    return "from bagassets.assets.quality.check import RecordingCheck\n" + GOOD.replace(
        "make=make,", f"make=make, checks=({check},),"
    )


def with_count(name):
    """The package, whose asset counts something."""
    face = f"face=Face(counts={{'{name}': len}})"
    return "from bagassets.assets.face import Face\n" + GOOD.replace("make=make,", f"make=make, {face},")


RECIPE = """
name: test
bags: {{root: bags}}
rigs:
  - name: car
    ego_pose: {{source: fixed}}
    channels: {{CAM: {{modality: camera, topic: /c}}}}
formats: {formats}
nuscenes: {{}}
"""


@pytest.fixture
def site(tmp_path, monkeypatch):
    site = Site(monkeypatch, tmp_path / "site")
    yield site
    site.close()


def recipe(folder, text="{acme: {output: acme}}"):
    (folder / "recipe.yaml").write_text(RECIPE.format(formats=text))
    return load_recipe(folder / "recipe.yaml")


def problem(site, code, name="acme", value="ACME", version="1.2"):
    """Install a package, and return the one sentence about it."""
    site.install("acme_package", version, code, group=FORMATS, **{name: value})
    (sentence,) = catalogue().problems
    assert formats() == catalogue().formats
    assert [kind.name for kind in formats()] == [*OUR_FORMATS]
    assert catalogue().assets == {}
    assert sentence.count("\n") == 0
    return sentence


class TestGood:
    def test_it_is_one_of_the_formats_and_its_section_is_read(self, site, tmp_path):
        site.install("acme_package", "1.2", GOOD, group=FORMATS, acme="ACME")
        assert catalogue().problems == ()
        kind = installed_format("acme")
        assert (kind.distribution, kind.section, kind.asset) == (
            "acme_package 1.2",
            "formats.acme",
            "acme_dataset",
        )
        assert catalogue().assets["acme_part"].libraries == ("acme_package",)
        found = recipe(tmp_path, "{acme: {output: out, size: 5}}")
        assert (found.formats["acme"].size, found.formats["acme"].output) == (5, tmp_path / "out")
        assert list(datasets_of(found)) == ["nuscenes_dataset", "acme_dataset"]
        assert list(problems_of(found)) == []

    def test_a_check_of_its_asset_is_one_of_the_checks_and_its_surprise_names_it(self, site, tmp_path):
        site.install("acme_package", "1.2", with_check("'files_match'"), group=FORMATS, acme="ACME")
        assert "| `acme_sound` | `acme_part` | it is not | error |" in render_checks()
        (operation,) = (
            one
            for one in recording_checks(recipe(tmp_path), Naming("test"))
            if one.node_def.name == "acme_part_checks"
        )
        assert [key.name for key in operation.check_keys] == ["acme_sound"]
        (check,) = catalogue().assets["acme_part"].checks
        with pytest.raises(
            PluginError, match=r"acme_package 1\.2.*the check acme_sound of its asset acme_part raised Zero"
        ):
            check.rule(None)

    def test_another_version_of_the_package_is_another_code_version(self, site, tmp_path):
        versions = set()
        for version in ("1.2", "1.3"):
            site.install("acme_package", version, GOOD, group=FORMATS, acme="ACME")
            found = recipe(tmp_path)
            versions.add(datasets_of(found)["acme_dataset"].code_version(found.splits))
        assert len(versions) == 2

    @pytest.mark.parametrize(
        ("section", "words"),
        [
            (
                "{acme: {output: out, sise: 5}}",
                r"recipe\.yaml:8: formats\.acme\.sise: no such field here; did you mean size",
            ),
            (
                "{acme: {output: out, size: 0}}",
                r"formats\.acme\.size: must not be smaller than 1; found the number 0",
            ),
            ("{acme: {size: 2}}", r"formats\.acme\.output: this field is required: folder of the dataset"),
            ("{acme: 3}", r"formats\.acme: expected a mapping; found the number 3"),
            ("{acme: {output: ~/out}}", r"formats\.acme\.output: `~` is not expanded"),
            (
                "{acme: {output: dataset/nuscenes/x}}",
                r"formats\.acme\.output: .* must be different, and neither may contain the other",
            ),
            (
                "{acne: {output: out}}",
                r"formats\.acne: no installed package adds a format acne; did you mean acme\?",
            ),
        ],
    )
    def test_what_is_wrong_in_the_section_is_named(self, site, tmp_path, section, words):
        site.install("acme_package", "1.2", GOOD, group=FORMATS, acme="ACME")
        with pytest.raises(RecipeError, match=words):
            recipe(tmp_path, section)

    def test_without_the_package_the_recipe_names_what_is_missing(self, tmp_path):
        with pytest.raises(
            RecipeError, match="no installed package adds a format acme; install the one that does"
        ):
            recipe(tmp_path)

    def test_the_command_lists_it(self, site):
        site.install("acme_package", "1.2", GOOD, group=FORMATS, acme="ACME")
        result = CliRunner().invoke(root, ["formats"])
        assert result.exit_code == 0
        assert (
            "format acme 1: `formats.acme` in the recipe, made from acme_part, from acme_package 1.2"
            in result.stdout
        )
        assert "asset acme_part 1: from acme_package 1.2" in result.stdout


class TestBad:
    @pytest.mark.parametrize(
        ("code", "words"),
        [
            ("import nothing_of_this_name\n", "importing acme_package:ACME raised ModuleNotFoundError"),
            ("import sys; sys.exit(3)\n", "raised SystemExit: 3"),
            ("1 / 0\n", "raised ZeroDivisionError"),
            ("X = 1\n", "raised AttributeError"),
            ("ACME = {}\n", "is not a bagassets.formats.format.Format"),
            (
                HEAD + "del FIELDS['join']\nACME = Format(**FIELDS)\n",
                "missing 1 required positional argument: 'join'",
            ),
            (HEAD + "ACME = Format(**FIELDS | {'join': None})\n", "its join must be a function"),
            (HEAD + "ACME = Format(**FIELDS | {'samples': 3})\n", "its samples must be a function or None"),
            (
                HEAD + "ACME = Format(**FIELDS | {'settings': dict})\n",
                "its settings are <class 'dict'>, not a model",
            ),
            (HEAD + "ACME = Format(**FIELDS | {'name': 'other'})\n", "the format calls itself 'other'"),
            (
                HEAD + "ACME = Format(**FIELDS | {'assets': ()})\n",
                "its part 'acme_part' is not one of its assets",
            ),
            (
                HEAD + "ACME = Format(**FIELDS | {'assets': ('acme_part', PART)})\n",
                "'acme_part' is not a bagassets",
            ),
            (HEAD + "ACME = Format(**FIELDS | {'version': '1'})\n", "its version must be a whole number"),
            (
                HEAD
                + "ACME = Format(**FIELDS | {'checks': (DatasetCheck('x', 'y', ''),), 'check': print})\n",
                "the section 'y'",
            ),
            (
                HEAD + "ACME = Format(**FIELDS | {'check': print})\n",
                "it must have both checks and check, or neither",
            ),
            (with_check("'y'"), "its check acme_sound has the section 'y'"),
            (with_check("'enabled'"), "its check acme_sound has the section 'enabled'"),
            (GOOD.replace("make=make,", "make=make, checks=(print,),"), "is not a RecordingCheck"),
            (
                GOOD.replace("make=make,", "make=make, face=print,"),
                "has a face that is not a bagassets.assets.face.Face",
            ),
            (with_count("boxes"), "its asset acme_part counts boxes, a name that is taken"),
            (with_count("result"), "its asset acme_part counts result, a name that is taken"),
            (
                HEAD.replace("acme_part", "frames") + "ACME = Format(**FIELDS)\n",
                "'frames' is not a valid name for an asset",
            ),
            (
                HEAD.replace("make=make,", "") + "ACME = Format(**FIELDS)\n",
                "must have either make or extract",
            ),
        ],
    )
    def test_what_cannot_be_used_is_left_out_and_named(self, site, tmp_path, code, words):
        sentence = problem(site, code)
        assert "acme of acme_package 1.2 cannot be used" in sentence
        assert words in sentence
        # Everything else goes on, also where the recipe asks for it.
        found = recipe(tmp_path)
        assert list(datasets_of(found)) == ["nuscenes_dataset"]
        assert list(problems_of(found)) == [sentence]
        result = CliRunner().invoke(root, ["formats", "--json"])
        assert (result.exit_code, json.loads(result.stdout)["problems"]) == (1, [sentence])

    def test_two_of_one_name(self, site, tmp_path):
        site.install("one", "1", GOOD, group=FORMATS, acme="ACME")
        site.install("two", "2", GOOD, group=FORMATS, acme="ACME")
        (sentence,) = catalogue().problems
        assert "one 1 and two 2 both add it, so neither is used" in sentence
        assert list(datasets_of(recipe(tmp_path))) == ["nuscenes_dataset"]

    def test_one_that_calls_itself_as_ours(self, site):
        code = GOOD.replace('name="acme"', 'name="nuscenes"')
        sentence = problem(site, code, name="nuscenes")
        assert "acme_package 1.2 would replace that of bagassets" in sentence
        assert formats()[0].name == "nuscenes"

    def test_an_asset_that_another_package_has_too(self, site):
        site.install("one", "1", GOOD, group=FORMATS, acme="ACME")
        site.install("two", "2", GOOD.replace('name="acme"', 'name="other"'), group=FORMATS, other="ACME")
        (sentence,) = catalogue().problems
        assert "other of two 2 cannot be used: one 1 has an asset acme_part, too" in sentence
        assert [kind.name for kind in formats()] == [*OUR_FORMATS, "acme"]

    @pytest.mark.parametrize(
        ("was", "now", "words"),
        [
            (
                "params=lambda recipe, rig: {}",
                "params=lambda recipe, rig: recipe.nothing",
                "params of its asset acme_part raised AttributeError",
            ),
            (
                "params=lambda recipe, rig: {}",
                "params=lambda recipe, rig: object()",
                "object cannot be a parameter",
            ),
            ('"acme" in recipe.formats', "1 / 0", "enabled of its asset acme_part raised ZeroDivisionError"),
        ],
    )
    def test_an_asset_that_cannot_be_planned_is_none_of_the_recipe(self, site, tmp_path, was, now, words):
        assert was in GOOD
        site.install("acme_package", "1.2", GOOD.replace(was, now), group=FORMATS, acme="ACME")
        found = recipe(tmp_path)
        assert catalogue().problems == ()
        (sentence,) = problems_of(found)
        assert "acme of acme_package 1.2 cannot be used" in sentence
        assert words in sentence
        assert not catalogue().assets["acme_part"].enabled(found)

    def test_a_lock_of_a_format_that_is_not_there_says_so(self, tmp_path):
        from bagassets.formats.dataset_lock import load_lock

        value = {"format": 2, "dataset": "acme", "acme": {}, "files": {}, "bags": []}
        (tmp_path / "x.json").write_text(json.dumps(value))
        with pytest.raises(
            DatasetError, match=r"x\.json: this dataset has the format acme, which is not installed"
        ):
            format_of(load_lock(tmp_path / "x.json"))


BROKEN = "lambda *args: {}['nothing']"


class TestAtWork:
    """Whatever a function of a format raises becomes a sentence that names the package, whoever calls it."""

    @pytest.fixture
    def lock(self, site, tmp_path):
        """The lock of a dataset that was put together while the format was sound."""
        self.install(site, "")
        loaded = recipe(tmp_path)
        outcome = run_action(Store(loaded.store_path), Step("acme_part", 1).action({}, {}), made_part)
        output, settings = loaded.formats["acme"].output, loaded.formats["acme"]
        part = Part("a.bag", "content", outcome.artifact.digest)
        assemble(installed_format("acme"), [part], settings, Store(loaded.store_path), output)
        return output / "data" / "dataset.lock.json"

    @staticmethod
    def install(site, fields):
        code = HEAD + f"ACME = Format(**FIELDS | {{{fields}}})\n"
        site.install("acme_package", "1.2", code, group=FORMATS, acme="ACME")
        assert catalogue().problems == ()

    @pytest.mark.parametrize(
        "name", ["join", "links", "counts", "duration_s", "folder", "row", "fills_split", "samples", "select"]
    )
    def test_every_function(self, site, name):
        self.install(site, f"'{name}': {BROKEN}")
        with pytest.raises(
            DatasetError, match=rf"{name} of the format acme of acme_package 1\.2 raised KeyError"
        ):
            list(getattr(installed_format("acme"), name)(None))

    def test_what_is_raised_on_the_way_through_its_links(self, site):
        self.install(site, "'links': lambda entry: (1 / number for number in (1, 0))")
        links = installed_format("acme").links(None)
        assert next(links) == 1
        with pytest.raises(DatasetError, match="links of the format acme of acme_package"):
            next(links)

    @pytest.mark.parametrize(
        ("places", "what", "call"),
        [
            (f"UnitFolders('runs', {BROKEN})", "places.name", lambda places: places.unit(None)),
            (f"LooseFiles({BROKEN}, print)", "places.named_in", lambda places: list(places.named_in(None))),
            (f"LooseFiles(print, {BROKEN})", "places.recording_of", lambda places: places.recording_of("x")),
        ],
    )
    def test_where_its_links_lie(self, site, places, what, call):
        code = HEAD + f"from bagassets.formats.format import LooseFiles, UnitFolders\nPLACES = {places}\n"
        code += "ACME = Format(**FIELDS | {'places': PLACES})\n"
        site.install("acme_package", "1.2", code, group=FORMATS, acme="ACME")
        with pytest.raises(
            DatasetError, match=f"{what} of the format acme of acme_package 1.2 raised KeyError"
        ):
            call(installed_format("acme").places)

    def test_verify_reports_it_and_goes_on(self, site, lock, tmp_path):
        self.install(site, f"'links': {BROKEN}")
        result = CliRunner().invoke(root, ["verify", "--recipe", str(tmp_path / "recipe.yaml"), "--json"])
        (damage,) = json.loads(result.stdout)["datasets"]
        assert damage["path"] == str(lock)
        assert "links of the format acme of acme_package 1.2 raised KeyError" in damage["reason"]
        assert lock.exists()

    def test_restore_leaves_what_is_there(self, site, lock, tmp_path):
        before = lock.read_bytes()
        self.install(site, f"'join': {BROKEN}")
        command = ["dataset", "restore", "--recipe", str(tmp_path / "recipe.yaml"), str(lock)]
        result = CliRunner().invoke(root, command)
        assert isinstance(result.exception, DatasetError)
        assert "join of the format acme of acme_package 1.2 raised KeyError" in str(result.exception)
        assert lock.read_bytes() == before

    def test_diff(self, site, lock, tmp_path):
        self.install(site, f"'samples': {BROKEN}")
        empty = tmp_path / "empty.json"
        empty.write_text(json.dumps(json.loads(lock.read_text()) | {"bags": []}))
        command = ["dataset", "diff", "--recipe", str(tmp_path / "recipe.yaml"), str(lock), str(empty)]
        result = CliRunner().invoke(root, command)
        assert isinstance(result.exception, DatasetError)
        assert "samples of the format acme of acme_package 1.2 raised KeyError" in str(result.exception)


def made_part(out):
    out.write_json("facts.json", {})
    return {}


ALONE = HEAD.split("FIELDS = dict(", maxsplit=1)[0].replace('"acme" in recipe.formats', "True")


class TestAssets:
    """An asset that no dataset is made from."""

    def test_it_is_one_of_every_recording_whose_recipe_it_says_so_to(self, site, tmp_path):
        site.install("acme_package", "1.2", ALONE, group=ASSETS, acme_part="PART")
        found = recipe(tmp_path, "{}")
        assert recording_assets(found).names[-1] == "acme_part"
        assert recording_assets(found)["acme_part"].distribution == "acme_package 1.2"
        assert (catalogue().problems, list(problems_of(found))) == ((), [])
        site.install("acme_package", "1.2", ALONE.replace("True", "False"), group=ASSETS, acme_part="PART")
        assert "acme_part" not in recording_assets(found).names

    @pytest.mark.parametrize(
        ("name", "code", "words"),
        [
            ("acme_part", ALONE + "PART = {}\n", "acme_package:PART is not an asset of that name"),
            ("other", ALONE, "acme_package:PART is not an asset of that name"),
            ("acme_part", ALONE.replace("version=1,", ""), "missing 1 required keyword-only argument: 'version'"),
            ("acme_part", ALONE.replace("make=make,", "make=make, reads=(Asset(name='b', version=1, title='', kinds=frozenset(), params=print, use=print, make=print),),"),
             "asset acme_part of acme_package 1.2 cannot be used: it reads b"),
        ],
    )  # fmt: skip
    def test_what_cannot_be_used_is_left_out_and_named(self, site, tmp_path, name, code, words):
        site.install("acme_package", "1.2", code, group=ASSETS, **{name: "PART"})
        (sentence,) = catalogue().problems
        assert "acme_package 1.2" in sentence
        assert words in sentence
        assert recording_assets(recipe(tmp_path, "{}")).names[-1] != "acme_part"


def test_what_its_channels_raise_while_they_are_planned_names_the_package(site):
    code = ALONE.replace("import Asset, Use", "import Asset, Use, uses_of").replace(
        '{"": Use({})}', 'uses_of({"CAM": 0, "TOP": 1}, lambda name, one: Use(1 // one))'
    )
    site.install("acme_package", "1.2", code, group=ASSETS, acme_part="PART")
    uses = catalogue().assets["acme_part"].use({}, None)
    assert uses["TOP"].params == 1
    assert isinstance(uses["CAM"], PluginError)
    assert "acme_package 1.2 cannot be used: use of its asset acme_part raised ZeroDiv" in str(uses["CAM"])


def test_what_a_package_raises_at_work_costs_its_own_asset_and_dataset(site, tmp_path, monkeypatch):
    code = GOOD.replace('params, facts: {"": Use({})}', "params, facts: facts.nothing") + (
        "OTHER = Format(**FIELDS | dict(name='other', part='nuscenes_tables', assets=(),\n"
        "    join=lambda members, settings, shares, out: 1 / 0))\n"
    )
    assert "facts.nothing" in code
    site.install("acme_package", "1.2", code, group=FORMATS, acme="ACME", other="OTHER")
    text = in_process.QUICK + "formats: {{acme: {{output: acme}}, other: {{output: other}}}}\n"
    recipe_file = in_process.make_project(tmp_path / "p", ["a.bag"], text=text)
    report, _ = in_process.build(recipe_file, monkeypatch)
    assert "use of its asset acme_part raised AttributeError" in report.outcomes["a.bag"].reason
    assert "acme of acme_package 1.2 cannot be used" in report.outcomes["a.bag"].reason
    assert "join of the format other of acme_package 1.2 raised ZeroDivisionError" in report.dataset_problem
    found = load_recipe(recipe_file)
    assert list(read_lock(found.nuscenes.output / "v1.0-test").bags) == ["a.bag"]
    acme = read_lock(found.formats["acme"].output / "data")
    assert (list(acme.bags), "raised AttributeError" in acme.value["failed"]["a.bag"]) == ([], True)
