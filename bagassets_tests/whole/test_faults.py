"""Every fault of the table has the outcome that the table says, in every format."""

from collections import Counter

import pytest

from bagassets.store.store import Store
from bagassets_tests.faults import FAULTS, KINDS, OUTCOMES, Place
from bagassets_tests.store_check import check_store

pytestmark = pytest.mark.once
ROWS = [
    pytest.param(
        fault,
        kind,
        id=f"{fault.area}: {fault.what} ({kind})",
        marks=pytest.mark.long if fault.is_slow or number % len(fault.kinds) != place else (),
    )
    for number, fault in enumerate(FAULTS)
    for place, kind in enumerate(fault.kinds)
]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Format -> files of the dataset of a drive without a fault."""
    datasets = {}
    for kind in KINDS:
        place = Place(tmp_path_factory.mktemp(kind), kind)
        place.write()
        result = place.build()
        assert not result.errors
        datasets[kind] = result.dataset
    return datasets


def test_the_table_is_as_long_as_it_should_be_and_names_each_fault_once():
    assert len(FAULTS) >= 80
    assert {fault.outcome for fault in FAULTS} == set(OUTCOMES)
    assert all(fault.says for fault in FAULTS if fault.outcome != "identical")
    names = Counter((fault.area, fault.what) for fault in FAULTS if not fault.what.startswith("the same"))
    assert max(names.values()) == 1


@pytest.mark.parametrize(("fault", "kind"), ROWS)
def test_a_fault_has_its_outcome(tmp_path, sound, fault, kind):
    place = Place(tmp_path, kind, fault.outcome)
    result = fault.do(place)
    for sentence in (*result.errors, *result.findings):
        assert "\n" not in sentence
        assert "Traceback" not in sentence
    for counts in result.counts:
        assert counts["read"] == counts["written"] + counts.get("merged", 0) + sum(counts["lost"].values())
    if place.store_path.is_dir():
        assert list(check_store(Store(place.store_path))) == []
    if fault.outcome == "sentence":
        assert any(fault.says in sentence for sentence in result.errors), result
        return
    assert result.errors == []
    if fault.outcome == "identical":
        assert result.dataset == sound[kind]
    elif fault.outcome == "counted":
        assert any(fault.says in loss.reason for loss in result.losses), result.losses
    else:
        assert any(fault.says in sentence for sentence in result.findings), result.findings
