"""A server that starts while its client still imports: one, whoever is quicker, and no trouble if it cannot."""

import time

import pytest
from test_forkserver import spec_in

from bagassets.errors import BagAssetsError
from bagassets.forkserver import client as client_module
from bagassets.forkserver.client import Client


def test_the_server_that_was_started_early_is_the_one_that_answers(tmp_path):
    spec = spec_in(tmp_path / "state")
    before = len(client_module._STARTERS)
    began = time.monotonic()
    Client.start_early(spec)
    assert time.monotonic() - began < 1.0, "it does not wait"
    with Client.ensure(spec) as client:
        assert client_module._STARTERS[-1].wait(60) == 0
        assert client.places.log.read_text().count(": serving ") == 1
        Client.start_early(spec)
        assert len(client_module._STARTERS) == before + 1, "one that answers is enough"
        client.shutdown(grace_s=0.0)


def test_a_server_that_cannot_start_is_reported_by_who_needs_it(tmp_path):
    spec = spec_in(tmp_path / "state", preload="forkserver_jobs:no_such_function")
    Client.start_early(spec)
    assert client_module._STARTERS[-1].wait(60) != 0
    with pytest.raises(BagAssetsError, match="the fork server cannot start"):
        Client.ensure(spec)
