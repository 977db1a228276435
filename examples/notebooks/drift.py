# %% [markdown]
# # Drift in use
#
# A unit is calibrated once. Then it is used, and its zero and gain drift. `Adapter` follows the drift without
# any reference, and says when it cannot.

# %%
import numpy as np
import pandas as pd

import softcal
from softcal.core.operation.adapter import AdaptConfig, Adapter
from softcal.core.profiles import ramps
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, simulate

rng = np.random.default_rng(5)
readout = ReadoutMetadata(adc_bits=14)
lag = (EffectSetting("readout_lag", {"tau": 0.04}),)
source_twin = softcal.Twin(BaseParameters(), lag, readout)
unit_twin = softcal.Twin(BaseParameters(r0_ohm=4.6, kappa_per_N=0.065), lag, readout)


def press_unit(twin, presses):
    """Press a unit by hand, so to say: depth and speed differ a little from press to press."""
    parts = [ramps([depth_mm], speed_mm_s, rest_s=0.5) for depth_mm, speed_mm_s in presses]
    profile = parts[0]
    for part in parts[1:]:
        profile = profile.then(part, "presses")
    t_s, stage_mm = profile.sample(readout.sample_rate_Hz)
    force_N, output_V = simulate(twin, t_s, stage_mm, rng)
    return t_s, force_N, output_V


def presses(count):
    """Draw depth [mm] and speed [mm/s] of each press."""
    return zip(3.0 + rng.normal(0, 0.15, count), 2.5 + rng.normal(0, 0.15, count), strict=True)


# %% [markdown]
# ## Calibrate

# %%
t_s, force_N, output_V = press_unit(source_twin, presses(40))
network = softcal.fit_network(softcal.Recording(output_V, force_N, t_s=t_s), hidden=(32, 16))
t_s, _, output_V = press_unit(unit_twin, presses(40))
target = softcal.Recording(output_V, t_s=t_s, serial="A1")
unit = softcal.fit_map(network, target, limit_rmse=0.3)
print(unit.verdict, f"error expected: {unit.predicted_rmse:.3f} N")

# %% [markdown]
# ## Use it, while it drifts
#
# After a fifth of the time the output begins to rise: by a tenth of its span, and 5 % in gain.

# %%
t_s, force_N, output_V = press_unit(unit_twin, presses(300))
late = np.clip((np.linspace(0, 1, len(t_s)) - 0.2) / 0.8, 0, 1)
zero_V, span_V = output_V.min(), np.ptp(output_V)
drifted_V = zero_V + (1 + 0.05 * late) * (output_V - zero_V) + 0.1 * span_V * late

estimates = {}
for mode in ("none", "improved"):
    adapter = Adapter(unit.network, unit.calibration, target.unlabelled, AdaptConfig(mode=mode))
    estimates[mode] = adapter.advance(t_s, drifted_V)
    last = adapter.current

# %% [markdown]
# ## Error by fifths of the time, in N

# %%
fifths = np.array_split(np.arange(len(t_s)), 5)
errors = pd.DataFrame(
    {
        mode: [float(np.sqrt(np.nanmean((course.estimate[rows] - force_N[rows]) ** 2))) for rows in fifths]
        for mode, course in estimates.items()
    },
    index=[f"{k} of 5" for k in range(1, 6)],
)
print(errors.round(3))
print(f"zero moved by {last.shift:.2f} scales, verdict {last.verdict}, alarm: {last.alarm or 'none'}")
