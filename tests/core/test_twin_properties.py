"""Every effect of the catalogue, each of its sides, and plug-ins satisfy the properties; broken ones do not."""

from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.gap.case import KINDS, Case, Run
from softcal.core.gap.twin_reach import menu
from softcal.core.twin import properties
from softcal.core.twin.catalogue import BUILTIN_EFFECTS, EFFECTS, PLUGINS
from softcal.core.twin.effects import Effect, Hook, Parameter
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.core.twin.properties import PROPERTIES, Violation

SIDES = [side for effect in EFFECTS.values() for side in (effect, *effect.sides)]


@pytest.mark.parametrize("holds", PROPERTIES, ids=lambda holds: holds.__name__)
@pytest.mark.parametrize("effect", SIDES, ids=lambda effect: f"{effect.id}-{effect.parameters[0].name}")
def test_effects_satisfy_the_properties(effect, holds):
    holds(effect)


def test_confounders_and_runs_that_an_entry_names_exist():
    t_s = np.arange(200) / 50.0
    run = Run("1", t_s, ReadoutMetadata(), stage_mm=t_s, force_N=t_s, output_V=t_s)
    menu_names = {entry.name for entry in menu(Case("A", (run,)), properties.RANGE)}
    for effect in EFFECTS.values():
        assert set(effect.signs.confounders) <= set(EFFECTS) - {effect.id}
        assert set(effect.signs.best_experiments) <= menu_names, effect.id
        if effect.signs.alias is not None:
            assert effect.signs.alias.distinguished_by in KINDS


def idle(flow, values, memory):
    pass


GOOD = Effect(
    "wear", "mechanics", Hook.FORCE, "F·(1 − w)", "test", (Parameter("w", "", 0.0, 0.9, 0.1, neutral=0.0),), idle
)


def weaker(flow, values, memory):
    flow.force_N = flow.force_N * (1.0 - values[0])


def in_pieces(flow, values, memory):
    flow.force_N = flow.force_N - values[0] * flow.force_N.mean()


@pytest.mark.parametrize(
    ("holds", "broken"),
    [
        (properties.at_its_usual_size_it_shows, GOOD),
        (properties.chunks_of_a_stream_give_the_same, replace(GOOD, step=in_pieces)),
        (properties.it_acts_where_it_says, replace(GOOD, step=weaker, stage="load_cell")),
        (properties.it_acts_where_it_says, replace(GOOD, step=weaker, stage="transduction", hook=Hook.CHANNEL)),
        (
            properties.switched_off_it_changes_nothing,
            replace(GOOD, step=weaker, parameters=(Parameter("w", "", 0.0, 0.9, 0.1, neutral=0.05),)),
        ),
        (properties.a_search_finds_where_to_begin, replace(GOOD, is_episodic=True)),
        (
            properties.it_stays_finite_within_its_bounds,
            replace(GOOD, step=weaker, parameters=(Parameter("w", "", 0.0, np.inf, 0.1, neutral=0.0),)),
        ),
    ],
)
def test_a_broken_effect_is_reported(holds, broken):
    with pytest.raises(Violation, match="wear"):
        holds(broken)


def test_plug_ins_stand_behind_the_own_effects(monkeypatch):
    monkeypatch.setattr("softcal.core.twin.properties.GOOD_FOR_TEST", GOOD, raising=False)
    point = EntryPoint("wear", "softcal.core.twin.properties:GOOD_FOR_TEST", "softcal.effects")
    assert list(PLUGINS.merge_plugins(BUILTIN_EFFECTS, [point]))[-1] == "wear"
    with pytest.raises(InputError, match="wear"):
        PLUGINS.merge_plugins({"wear": GOOD}, [point])


@pytest.mark.parametrize("value", ["no_such_module:EFFECT", "softcal.core.twin.properties:RATE_Hz"])
def test_a_plug_in_that_is_none_is_refused_in_one_line(value):
    with pytest.raises(InputError, match="'wear'"):
        PLUGINS.merge_plugins(BUILTIN_EFFECTS, [EntryPoint("wear", value, "softcal.effects")])
