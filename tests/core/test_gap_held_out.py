"""The shrink on a part held back is of the causes that would have been chosen without that part."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from softcal.core.gap.case import Case
from softcal.core.gap.fit import fit, log_evidences
from softcal.core.gap.hypothesis import start_coordinates
from softcal.core.gap.model import Fit
from softcal.core.gap.residual import unsupported
from softcal.core.gap.search import Search
from softcal.core.gap.twin import TWIN, diagnose
from softcal.core.twin.catalogue import EFFECTS


@pytest.fixture
def faint(drawn_case: Callable[..., Case]) -> Case:
    """A cause so faint that one of its runs decides which of two is chosen."""
    return drawn_case(1300002, "faint", "tenth")


TIE = 0.3
"""Log evidence within which two hypotheses are chosen by rounding."""


def _chosen_without(case: Case, run: int) -> list[tuple[str, ...]]:
    """The causes that a search finds to which the run was never shown; several only where they tie."""
    case = replace(case, runs=tuple(r for k, r in enumerate(case.runs) if k != run))
    search = Search(TWIN.base_fit(case), TWIN.visible(case))
    search.run()
    logs = log_evidences(search.fits)
    return [ids for ids, log in logs.items() if log > max(logs.values()) - TIE]


def test_causes_are_chosen_as_by_who_has_never_seen_the_part(faint: Case) -> None:
    diagnosis = diagnose(faint)
    assert len(diagnosis.chosen) == len(faint.runs)
    for run in (0, 1):
        assert diagnosis.chosen[run] in _chosen_without(faint, run)
    assert len(set(diagnosis.chosen)) > 1  # Else the test shows nothing.


@pytest.mark.long
def test_a_strong_cause_is_chosen_whatever_is_held_back(drawn_case: Callable[..., Case]) -> None:
    diagnosis = diagnose(drawn_case(1300002, "strong", "usual"))
    cause = diagnosis.best.hypothesis.ids
    assert cause and diagnosis.chosen == (cause,) * len(diagnosis.chosen)
    assert diagnosis.report()["shrink"]["chosen"] == [list(cause)] * len(diagnosis.chosen)


def test_nothing_is_chosen_where_nothing_is_left(drawn_case: Callable[..., Case]) -> None:
    assert diagnose(drawn_case(1300000, "sound", "none")).chosen == ()


def _with(base: Fit, effect_id: str) -> Fit:
    effect = EFFECTS[effect_id]
    first = start_coordinates([effect], [[0.2 * effect.parameters[0].usual, *(p.usual for p in effect.parameters[1:])]])
    return fit(base.problem, base.hypothesis.adding(effect), np.append(base.coordinates, first), steps=30)


@pytest.mark.parametrize("effect_id", ["channel_creep", "loadcell_creep", "mechanical_hysteresis", "ageing_drift"])
def test_a_cause_that_lowers_nothing_on_samples_held_back_has_no_support(
    drawn_case: Callable[..., Case], effect_id: str
) -> None:
    base = TWIN.base_fit(drawn_case(1300003, "sound", "none"))
    assert unsupported(_with(base, effect_id), {effect_id: base}) == [effect_id]


@pytest.mark.long
def test_a_cause_that_is_there_has_support(drawn_case: Callable[..., Case]) -> None:
    case = drawn_case(1300002, "strong", "usual")
    base, (cause,) = TWIN.base_fit(case), diagnose(case).best.hypothesis.ids
    assert unsupported(_with(base, cause), {cause: base}) == []
