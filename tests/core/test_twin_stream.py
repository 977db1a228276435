"""A twin as a stream and as a lot."""

import numpy as np
import pytest

from softcal.core import profiles
from softcal.core.errors import InputError
from softcal.core.simulated_lot import draw_lot
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, TwinStream, simulate


@pytest.mark.parametrize(
    "effects",
    [
        (),
        (EffectSetting("intermittent_contact", episodes=((3.0, 4.0), (10.0, 10.5))),),
        (EffectSetting("thermal_drift"), EffectSetting("channel_creep"), EffectSetting("clock_offset")),
    ],
    ids=["none", "episodes", "several"],
)
def test_a_stream_in_chunks_gives_the_numbers_of_one_call(effects):
    """Noise and temperature are in it; each effect alone is held to it by the properties of effects."""
    twin = Twin(effects=effects)
    t_s, stage_mm = profiles.source_profile(np.random.default_rng(1), 40.0).sample(50.0)
    temperature_C = 20.0 + 0.1 * t_s
    force, output = simulate(twin, t_s, stage_mm, np.random.default_rng(2), temperature_C)
    stream = TwinStream(twin, np.random.default_rng(2))
    cuts = [slice(k, k + 37) for k in range(0, len(t_s), 37)]
    parts = [stream.advance(t_s[c], stage_mm[c], temperature_C[c]) for c in cuts]
    np.testing.assert_allclose(np.concatenate([p[0] for p in parts]), force, atol=1e-9)
    np.testing.assert_array_equal(np.concatenate([p[1] for p in parts]), output)


def test_a_clock_that_runs_slow_streams_as_in_one_call():
    twin = Twin(effects=(EffectSetting("clock_skew", {"epsilon": -0.005}),))
    t_s, stage_mm = profiles.rate_sweep(3.0).sample(50.0)
    stream = TwinStream(twin, None)
    parts = [stream.advance(t_s[k : k + 20], stage_mm[k : k + 20])[1] for k in range(0, len(t_s), 20)]
    np.testing.assert_array_equal(np.concatenate(parts), simulate(twin, t_s, stage_mm)[1])


def test_a_new_run_starts_from_rest():
    twin = Twin(effects=(EffectSetting("stress_relaxation"), EffectSetting("mullins_softening")))
    t_s, stage_mm = profiles.ramps([3.0, 3.0], 2.0).sample(50.0)
    stream = TwinStream(twin, None)
    first = stream.advance(t_s, stage_mm)[0]
    stream.restart()
    np.testing.assert_array_equal(stream.advance(t_s, stage_mm)[0], first)


def test_time_that_does_not_go_on_is_refused():
    stream = TwinStream(Twin(), None)
    stream.advance(np.array([0.0, 0.02]), np.zeros(2))
    with pytest.raises(ValueError):
        stream.advance(np.array([0.02, 0.04]), np.zeros(2))


def test_units_of_a_lot_differ_and_use_a_good_part_of_a_ten_bit_adc():
    t_s, stage_mm = profiles.ramps([3.5], 2.0).sample(50.0)
    lot = draw_lot(np.random.default_rng(4), 20)
    assert len({twin.parameters for twin in lot}) == 20
    for twin in lot:
        force, output = simulate(twin, t_s, stage_mm)
        assert 3.0 < force.max() < 10.0
        assert np.ptp(output) / ReadoutMetadata().step_V > 80
        assert twin.parameters.kappa_per_N * force.max() < 0.8


def test_parameters_beyond_physics_are_refused():
    with pytest.raises(InputError, match="k1_N_mm .*-1"):
        BaseParameters(k1_N_mm=-1.0)
    with pytest.raises(InputError, match="adc_bits .*0"):
        ReadoutMetadata(adc_bits=0)
