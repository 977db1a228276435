# %% [markdown]
# # Where the simulator differs from the rig
#
# A rig whose channel creeps, which the base twin does not know. The diagnosis sees four recordings and is not told.
#
# The rig is made by softcal's own twin here, so this shows how it works, not how good it is. For that there is the
# blind check (`docs/gap-method.md`).

# %%
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd

import softcal
from softcal.core.profiles import ramps, random_presses, steps_with_holds
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, simulate

rng = np.random.default_rng(7)
readout = ReadoutMetadata(vref_V=3.3, adc_bits=14)
rig = softcal.Twin(BaseParameters(k1_N_mm=1.2), (EffectSetting("channel_creep", {"c": 0.05, "tau": 4.0}),), readout)

# %% [markdown]
# ## Four runs
#
# Slow ramps, fast ramps, steps with holds, a random path: a good case. Each run is a folder with a table and a few
# facts.

# %%
case = Path("rig-7")
runs = (
    ramps([2.0, 3.0], 0.4),
    ramps([1.5, 2.5, 3.0] * 3, 3.0),
    steps_with_holds([1.0, 2.0, 3.0]),
    random_presses(rng, 40.0, 3.0),
)
for k, profile in enumerate(runs, start=1):
    t_s, stage_mm = profile.sample(readout.sample_rate_Hz)
    force_N, output_V = simulate(rig, t_s, stage_mm, rng)
    folder = case / "runs" / str(k)
    folder.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame({"t_s": t_s, "stage_mm": stage_mm, "force_N": force_N, "output_V": output_V})
    table.to_csv(folder / "recording.csv", index=False)
    metadata = {"serial": "A17", "profile": profile.name, **asdict(readout)}
    (folder / "recording.json").write_text(json.dumps(metadata), encoding="utf-8")

# %% [markdown]
# ## Diagnose

# %%
report = softcal.diagnose(case).report()
print(report["verdict"])
for cause in report["causes"][:3]:
    sizes = {name: round(fit["value"], 3) for name, fit in cause["parameters"].items()}
    print(f"{cause['effect']}: probability {cause['probability']:.2f}, {sizes}")
print(f"shrink: forecast {report['shrink']['predicted']:.3f}, on runs held back {report['shrink']['held_out']:.3f}")

# %% [markdown]
# ## Where
#
# The stage of the chain, and the regimes in which the gap stands out.

# %%
print(pd.DataFrame(report["where"])[["stage", "channel", "regime", "share"]].head())
