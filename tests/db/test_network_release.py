"""Which network of a lot the line uses: the first, until somebody releases another one with a reason."""

import pytest

from softcal.core.errors import InputError
from softcal.core.network.network import Network
from softcal.db.repositories.networks import DRAFT, RELEASED, WITHDRAWN


@pytest.fixture
def trial(factory, network) -> str:
    """A second network of the lot, trained on trial."""
    other = Network(network.weights, network.biases, 0.6, 0.1, 1.0, 2.0)
    return factory.registry.networks.add("L1", other, {}, {}, "b" * 64, actor="Erin")


def released_network_id(factory) -> str | None:
    state = factory.registry.networks.released("L1")
    return state and state.network.id


def states(factory) -> list[str]:
    return [state.state for state in factory.registry.networks.states("L1")]


def test_the_first_network_of_a_lot_is_in_use_and_a_trial_is_not(factory, trial):
    assert (released_network_id(factory), states(factory)) == (factory.network_id, [RELEASED, DRAFT])


def test_a_released_network_is_used_and_a_withdrawn_one_gives_way_to_the_one_before(factory, trial):
    factory.registry.networks.release(trial, reason="half the error", actor="Quinn")
    state = factory.registry.networks.released("L1")
    assert (state.network.id, state.actor, state.reason) == (trial, "Quinn", "half the error")
    factory.registry.networks.withdraw(trial, reason="drifts")
    assert (released_network_id(factory), states(factory)) == (factory.network_id, [RELEASED, WITHDRAWN])
    factory.registry.networks.withdraw(factory.network_id, reason="so does this")
    assert released_network_id(factory) is None


def test_an_earlier_network_can_be_released_again(factory, trial):
    factory.registry.networks.release(trial, reason="better")
    factory.registry.networks.release(factory.network_id, reason="it was not")
    assert released_network_id(factory) == factory.network_id


def test_nothing_is_decided_without_a_reason_or_twice(factory, trial):
    for decide, network_id, reason in (
        (factory.registry.networks.release, trial, " "),
        (factory.registry.networks.release, factory.network_id, "so"),
        (factory.registry.networks.withdraw, trial, "so"),
        (factory.registry.networks.release, "f" * 64, "so"),
    ):
        with pytest.raises(InputError, match=network_id[:12]):
            decide(network_id, reason=reason)
    assert states(factory) == [RELEASED, DRAFT]


def test_a_decision_is_in_the_audit_trail_and_changes_the_marker(factory, trial):
    before = factory.registry.pages.change_marker("L1")
    factory.registry.networks.release(trial, reason="half the error", actor="Quinn")
    row = factory.registry.trail.rows()[-1]
    assert (row.action, row.entity, row.actor, row.reason) == ("release", "network_releases", "Quinn", "half the error")
    assert factory.registry.pages.change_marker("L1") != before and factory.registry.verify() == []


def test_of_two_screens_that_change_a_line_at_once_one_is_refused(registry):
    sessions = registry.line_sessions
    assert sessions.read("line-1") == (0, {})
    assert [sessions.write("line-1", 0, {"serial": "A1"}), sessions.write("line-1", 0, {"serial": "A2"})] == [
        True,
        False,
    ]
    assert sessions.read("line-1") == (1, {"serial": "A1"})
    assert [sessions.write("line-1", 1, {}), sessions.write("line-1", 1, {"serial": "A3"})] == [True, False]
