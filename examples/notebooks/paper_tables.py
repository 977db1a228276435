# %% [markdown]
# # The paper's Tables 1 to 3, on a simulated lot
#
# Kim, Kwon, Jeon and Park (Adv. Intell. Syst. 2020, 1900178) calibrate six units with one labelled source. Here the
# source and the units are simulated. The network is smaller than the paper's, so that all of it takes seconds.

# %%
import time

import numpy as np
import pandas as pd

import softcal
from softcal.core.simulated_lot import LotDesign, simulate_lot

SMALL = {"hidden": (32, 16)}
lot = simulate_lot(seed=1, design=LotDesign(good=3, has_stage=True))


def recording(run, serial, labelled=True):
    """Turn a simulated run into a recording as the Python API takes it."""
    output = run.unlabelled if labelled else run
    reference = run.reference if labelled else None
    return softcal.Recording(output.output, reference, t_s=output.t_s, serial=serial, stage_mm=output.stage_mm)


source = recording(lot.source, "S0")
units = {unit.serial: recording(unit.recording, unit.serial, labelled=False) for unit in lot.units}
audits = {unit.serial: recording(unit.audit, unit.serial) for unit in lot.units}

# %% [markdown]
# ## Table 1: error before and after the map, and of a calibration of the unit's own
#
# *Before* is f on the unit without a map. *After* is f with the map. *Own* is a network trained on labels of the unit
# itself: on the first half of its audit. All three are measured on the second half. Only *own* has seen labels.


# %%
def halves(whole):
    """Return the first and the second half of a labelled recording."""
    parts = whole.labelled.part(0, len(whole) // 2), whole.labelled.part(len(whole) // 2, len(whole))
    return [recording(part, whole.serial) for part in parts]


def error(network, test):
    """Return the RMSE of a network on the windows of a recording, without a map, in N."""
    labelled = test.labelled
    return float(np.sqrt(np.mean((network.predict(labelled.windows) - labelled.window_reference) ** 2)))


started_s = time.process_time()
network = softcal.fit_network(source, **SMALL)
training_s = time.process_time() - started_s

rows, fitted, maps_s = {}, {}, []
for serial, target in units.items():
    train, test = halves(audits[serial])
    started_s = time.process_time()
    fitted[serial] = softcal.fit_map(network, target)
    maps_s.append(time.process_time() - started_s)
    before, after = error(network, test), fitted[serial].rmse(test)
    own = error(softcal.fit_network(train, **SMALL), test)
    rows[serial] = {"before_N": before, "after_N": after, "own_N": own, "after_own": after / own}
table_1 = pd.DataFrame(rows).T
print(table_1.round(4))

# %% [markdown]
# ## Table 2: fewer samples
#
# The map of one unit, made from the first part of its recording. A part that allows no map is refused.

# %%
serial, target = next(iter(units.items()))
test = halves(audits[serial])[1]
table_2 = {}
for share in (1.0, 0.5, 0.25, 0.1):
    part = recording(target.unlabelled.part(0, round(share * len(target))), serial, labelled=False)
    try:
        table_2[f"{share:.0%}"] = softcal.fit_map(network, part).rmse(test)
    except softcal.UnitRefused as refused:
        table_2[f"{share:.0%}"] = np.nan
        print(f"{share:.0%}: {refused}")
table_2 = pd.Series(table_2, name="after_N")
print(table_2.round(4))

# %% [markdown]
# ## Table 3: seconds
#
# Processor time. A unit costs a map, not a training.

# %%
started_s = time.process_time()
fitted[serial].estimate(target)
estimate_us = 1e6 * (time.process_time() - started_s) / len(target)
table_3 = pd.Series(
    {"training f [s]": training_s, "a map [s]": float(np.median(maps_s)), "an estimate [µs]": estimate_us}
)
print(table_3.round(3))
