# %% [markdown]
# # Your own two sensors, from CSV files
#
# `source.csv` was pressed under a load cell: it has the columns `t_s, output_V, force_N`. `unit.csv` was only pressed:
# it has `t_s, output_V`. Put your files into the working folder under these names. Where there are none, the next cell
# writes simulated ones, and an `audit.csv` with a force that no fit sees.

# %%
from pathlib import Path

import numpy as np
import pandas as pd

import softcal

if not Path("source.csv").exists():
    from softcal.core.simulated_lot import LotDesign, simulate_lot

    lot = simulate_lot(seed=3, design=LotDesign(good=1))
    unit = lot.units[0]
    for name, run, force_N in (
        ("source", lot.source.unlabelled, lot.source.reference),
        ("unit", unit.recording, None),
        ("audit", unit.audit.unlabelled, unit.audit.reference),
    ):
        table = pd.DataFrame({"t_s": run.t_s, "output_V": run.output})
        (table if force_N is None else table.assign(force_N=force_N)).to_csv(f"{name}.csv", index=False)

# %% [markdown]
# ## Read
#
# Without a column of time give `sample_rate_Hz=50` in place of `time_s`. A column that is not there, a time that goes
# back or a value that is no number ends in one line that says so.

# %%
source = softcal.Recording.read("source.csv", output="output_V", reference="force_N", time_s="t_s")
target = softcal.Recording.read("unit.csv", output="output_V", time_s="t_s")
print(source.to_frame().describe().round(3))

# %% [markdown]
# ## Train f on the source, fit the map of the unit
#
# `hidden` is small here for speed. Leave it out for the paper's network. `limit_rmse` is the largest error that you
# accept, in N.

# %%
network = softcal.fit_network(source, hidden=(32, 16))
unit = softcal.fit_map(network, target, limit_rmse=0.3)
print(unit.verdict, unit.family, f"error expected: {unit.predicted_rmse:.3f} N")
for reason in unit.reasons:
    print("-", reason)

# %% [markdown]
# ## Estimate
#
# `lower` and `upper` hold 90 % of the true loads. Rows with a `flag` are not to be trusted.

# %%
estimates = unit.estimate(target)
print(estimates[estimates.flag == ""].head())
estimates.to_csv("estimates.csv", index=False)

# %% [markdown]
# ## Two known loads
#
# Put two known loads on the unit and read its output when it has settled. They correct gain and zero of the map. Here
# two rows of the audit stand for them: rest, and a high load that hardly moves.

# %%
if Path("audit.csv").exists():
    audit = softcal.Recording.read("audit.csv", output="output_V", reference="force_N", time_s="t_s")
    print(f"measured error: {unit.rmse(audit):.3f} N")

    table = audit.to_frame()
    is_steady = table.reference.diff().abs().rolling(15).max() < 0.1
    rows = [int(table.reference[is_steady].idxmin()), int(table.reference[is_steady].idxmax())]
    anchors = table.loc[rows, ["output", "reference"]]
    anchored = softcal.fit_map(network, target, limit_rmse=0.3, anchors=(anchors.output, anchors.reference))
    print(anchors.round(3))
    print(f"with two known loads: {anchored.rmse(audit):.3f} N")

    # An audit decides: its measured error outranks the forecast.
    audited = softcal.fit_map(network, target, limit_rmse=0.3, audit=audit)
    inside = np.mean((table.reference >= unit.estimate(audit).lower) & (table.reference <= unit.estimate(audit).upper))
    print(f"verdict with the audit: {audited.verdict}; {inside:.0%} of the loads lie inside the interval")
