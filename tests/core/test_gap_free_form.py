"""A cause that follows another equation than the catalogue's does not bring a second cause with it."""

from collections.abc import Callable

import pytest

from softcal.core.challenge.case_generator import LINES, SIZES
from softcal.core.challenge.rig import Cause
from softcal.core.gap.case import Case
from softcal.core.gap.diagnosis import Diagnosis
from softcal.core.gap.twin import diagnose
from tests.layers import layered

CONFIDENT = 0.8


@pytest.fixture
def draw_rig(drawn_case: Callable[..., Case], monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str, int], Case]:
    """`drawn(effect, form, seed)`: a rig with one cause that follows this equation of the second implementation."""

    def draw(effect: str, form: str, seed: int) -> Case:
        def causes(rng, scope):  # type: ignore[no-untyped-def]
            return (Cause(effect, form, SIZES[effect](rng, scope, 1.0)),)

        monkeypatch.setitem(LINES, "form", causes)  # type: ignore[arg-type]
        return drawn_case(seed, f"{effect}-{seed}", "form")

    return draw


def _confident(diagnosis: Diagnosis) -> set[str]:
    return {c.effect for c in diagnosis.causes if c.probability >= CONFIDENT}


@pytest.mark.parametrize("seed", layered((940000, 940001, 940002), (940002,)))
def test_a_tilted_pad_with_a_rounded_edge_is_named_alone(seed: int, draw_rig: Callable[..., Case]) -> None:
    diagnosis = diagnose(draw_rig("misaligned_contact", "rounded_edge", seed))
    assert diagnosis.verdict == "explained"
    assert _confident(diagnosis) == {"misaligned_contact"}


@pytest.mark.long
@pytest.mark.parametrize(("effect", "form"), [("channel_creep", "three_times"), ("stress_relaxation", "three_times")])
def test_what_another_equation_leaves_is_no_second_cause(effect: str, form: str, draw_rig: Callable[..., Case]) -> None:
    diagnosis = diagnose(draw_rig(effect, form, 940000))
    assert _confident(diagnosis) == {effect}
    assert diagnosis.best.hypothesis.ids == (effect,) and diagnosis.verdict in ("explained", "ambiguous")


@pytest.mark.parametrize("seed", layered([1400000, 1400001], (1400001,)))
def test_a_hum_that_swells_and_fades_is_a_hum(seed: int, draw_rig: Callable[..., Case]) -> None:
    diagnosis = diagnose(draw_rig("mains_hum", "beating", seed))
    assert diagnosis.verdict == "explained" and diagnosis.best.hypothesis.ids == ("mains_hum",)
