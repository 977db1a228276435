# %% [markdown]
# # A map family of your own
#
# A map turns windows of the unit into windows as the source would have given them. `examples/softcal-example-map` is a
# package with a family of 20 lines: it matches mean and standard deviation of the two outputs. Install it first:
#
#     pip install examples/softcal-example-map
#
# softcal then knows the family by its name, in Python and in every command.

# %%
import inspect

import pandas as pd
from softcal_example_map import Moments

import softcal
from softcal.core.maps.conformance import faults
from softcal.core.simulated_lot import LotDesign, simulate_lot

print(inspect.getsource(Moments))

# %% [markdown]
# ## Does it keep the rules?
#
# The conformance kit tries what every family must do: keep its input, repeat itself, be stored and read again.

# %%
wrong = faults(Moments())
print(wrong or "the family conforms")

# %% [markdown]
# ## How good is it?
#
# Against softcal's choice, on units that were pressed like the source and on units that were only pressed to half the
# depth. Matching moments takes a lighter load for a smaller gain. No look at the numbers of one programme shows that.

# %%
rows = []
for shift in ("none", "half range"):
    lot = simulate_lot(seed=4, design=LotDesign(good=2, shift=shift))
    source = softcal.Recording(lot.source.unlabelled.output, lot.source.reference, t_s=lot.source.unlabelled.t_s)
    network = softcal.fit_network(source, hidden=(32, 16))
    for unit in lot.units:
        target = softcal.Recording(unit.recording.output, t_s=unit.recording.t_s, serial=unit.serial)
        audit = softcal.Recording(unit.audit.unlabelled.output, unit.audit.reference, t_s=unit.audit.unlabelled.t_s)
        for family in ("moments", "affine", "auto"):
            fitted = softcal.fit_map(network, target, family=family)
            rows.append((shift, unit.serial, family, fitted.rmse(audit), fitted.verdict))
errors = pd.DataFrame(rows, columns=["load", "unit", "family", "after_N", "verdict"])
print(errors.pivot_table(index=["load", "unit"], columns="family", values="after_N").round(3))
