"""What a run may have of its own, and a cause of the same direction: it is not named. Simulators are drawn."""

import pytest

from tests.drawn_plants import ALIASES, TUNED, blind, diagnosed, likely_causes


def only_for(seed: int) -> object:
    return seed if seed == 4 else pytest.param(seed, marks=pytest.mark.long)


@pytest.mark.parametrize("hidden", ["none", "cubic", "late"])
@pytest.mark.parametrize("seed", [only_for(seed) for seed in range(TUNED.stop, 14)])
def test_what_runs_may_have_of_their_own_is_no_cause_and_hides_no_other(seed: int, hidden: str) -> None:
    diagnosis = diagnosed(seed, 0.004, False, hidden)
    true = {hidden} - {"none", *ALIASES}
    assert (likely_causes(diagnosis), diagnosis.verdict) == (true, "explained" if true else "no_gap")


@pytest.mark.parametrize("hidden", ["none", "cubic", "slow_part", "late"])
@pytest.mark.parametrize("seed", [only_for(seed) for seed in range(TUNED.stop, 10)])
def test_a_clock_that_is_late_along_linear_segments_is_no_cause_and_hides_no_other(seed: int, hidden: str) -> None:
    """Straight lines between samples are off a curve by many times this noise."""
    diagnosis = diagnosed(seed, 0.0005, True, hidden)
    assert not any(diagnosis.identifiability[alias].is_identifiable for alias in ALIASES)
    true = {hidden} - {"none", *ALIASES}
    assert (likely_causes(diagnosis), diagnosis.verdict) == (true, "explained" if true else "no_gap")


@pytest.mark.parametrize(
    "seed", [304, *(pytest.param(seed, marks=pytest.mark.long) for seed in (300, 301, 302, 303, 305))]
)
def test_a_gap_that_no_candidate_takes_down_to_the_noise_is_unknown(seed: int) -> None:
    diagnosis = blind(seed)
    assert (diagnosis.verdict, likely_causes(diagnosis)) == ("unknown", set())


@pytest.mark.long
def test_a_delay_beyond_what_runs_may_have_is_a_cause() -> None:
    diagnosis = diagnosed(9, 0.004, False, "long_delay")
    assert not diagnosis.identifiability["late"].is_run_nuisance and likely_causes(diagnosis) & {"late", "early_input"}
