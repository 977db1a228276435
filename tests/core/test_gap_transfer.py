"""Calibration results foretold by the twin, before and after a cause is in it."""

import numpy as np
import pytest

from softcal.core import profiles
from softcal.core.errors import InputError
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.transfer import LotUnit, PressedLot, transfer
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

BASE = Twin(BaseParameters(kappa_per_N=0.06), (), ReadoutMetadata(3.3, 14, 10.0, 50.0))
LATE = Twin(BASE.parameters, (EffectSetting("clock_offset", {"delta": 0.08}),), BASE.metadata)


def press_unit(twin, seed, seconds, has_stage=True):
    rng = np.random.default_rng(seed)
    t_s, stage_mm = profiles.random_presses(rng, seconds, 3.0).sample(50.0)
    force_N, output_V = simulate(twin, t_s, stage_mm, rng)
    raw = OutputRecording(f"R{seed}", t_s, output_V, 50.0, stage_mm=stage_mm if has_stage else None)
    return LabelledRecording(raw, force_N)


@pytest.mark.long
def test_the_explained_twin_foretells_the_rigs_errors_and_the_base_does_not():
    rig = PressedLot(
        press_unit(LATE, 1, 60.0), (LotUnit(press_unit(LATE, 2, 40.0).unlabelled, press_unit(LATE, 3, 60.0)),)
    )
    comparison = transfer(rig, BASE, LATE)
    errors = {name: (base, explained) for name, _, _, _, base, explained in comparison.rows()}
    assert errors["own"][1] < 0.25 < errors["own"][0]
    assert errors["after"][1] < errors["after"][0]
    record = comparison.to_record()
    assert record["units"] == 1
    for errors_of_twin in (record["rig"], record["base"], record["explained"]):
        assert errors_of_twin["after_by_own"] * errors_of_twin["own"] == pytest.approx(errors_of_twin["after"])


def test_a_lot_without_stage_positions_cannot_be_followed():
    blind = press_unit(LATE, 1, 20.0, has_stage=False)
    with pytest.raises(InputError, match="stage_mm"):
        PressedLot(blind, (LotUnit(blind.unlabelled, blind),))
