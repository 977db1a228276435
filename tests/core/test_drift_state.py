"""The method of long use, and states kept by declared fields."""

import json
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.operation.method import DriftTracking
from softcal.core.operation.stored_state import array_field, from_state, not_stored, to_state
from softcal.core.recording import Array


@dataclass(frozen=True)
class Inner:
    mean: Array = field(metadata=array_field("n"))
    covariance: Array = field(metadata=array_field("n", "n"))


@dataclass
class Outer:
    inner: Inner
    many: list[Inner]
    samples: list[float]
    last_s: float | None = None
    threshold: float = not_stored(1.0)


def outer(n: int = 2) -> Outer:
    inner = Inner(np.arange(n) / 3, np.eye(n) / 7)
    return Outer(inner, [inner, inner], [0.1, 0.2], threshold=5.0)


def through_json(value: object) -> dict[str, object]:
    state: dict[str, object] = json.loads(json.dumps(to_state(value)))
    return state


def test_declared_fields_come_back_to_the_last_bit_and_others_are_given() -> None:
    state = from_state(Outer, through_json(outer()), threshold=9.0)

    np.testing.assert_array_equal(state.inner.covariance, outer().inner.covariance)
    np.testing.assert_array_equal(state.many[1].mean, outer().many[1].mean)
    assert (state.samples, state.last_s, state.threshold) == ([0.1, 0.2], None, 9.0)


def test_only_declared_fields_are_kept() -> None:
    value = outer()
    value.cache = {1: 2}  # type: ignore[attr-defined]

    assert set(to_state(value)) == {"inner", "many", "samples", "last_s"}


def test_a_state_shares_nothing_with_what_it_was_taken_of() -> None:
    value = outer()
    state = to_state(value)
    value.samples.append(7.0)
    assert state["samples"] == [0.1, 0.2]


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda state: state.pop("last_s"), "Outer.last_s"),
        (lambda state: state.update(more=1), "Outer.more"),
        (lambda state: state["inner"].update(mean=[[1.0, 2.0]]), "Inner.mean"),
        (lambda state: state["inner"].update(mean=[1.0, 2.0, 3.0]), "Inner.covariance"),
        (lambda state: state["inner"].update(mean="none"), "Inner.mean"),
        (lambda state: state["many"][1].pop("mean"), "Inner.mean"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(change: object, name: str) -> None:
    state = through_json(outer())
    change(state)  # type: ignore[operator]

    with pytest.raises(InputError, match=name) as refusal:
        from_state(Outer, state)
    assert "\n" not in str(refusal.value)


def test_the_method_of_use_comes_back_from_what_was_kept() -> None:
    method = replace(DriftTracking(), drift=replace(DriftTracking().drift, pace=13.0))

    assert DriftTracking.from_json(json.loads(json.dumps(method.to_json()))) == method
    assert method.id != DriftTracking().id
    assert method.changes(DriftTracking()) == ["drift.pace: 12.0, now 13.0"]
    assert DriftTracking().changes(DriftTracking()) == []


def test_every_number_has_a_name_of_its_own() -> None:
    names = Counter(name for name, _, _ in DriftTracking().numbers())
    assert len(names) > 40 and max(names.values()) == 1
