"""Build a recording from columns as a file holds them: inspected, without its invalid rows."""

from dataclasses import dataclass

import numpy as np

from softcal.core.errors import InputError
from softcal.core.inspection.config import InspectionConfig
from softcal.core.inspection.inspection import Inspection
from softcal.core.inspection.samples import inspect_samples
from softcal.core.recording import Array, Indices, OutputRecording, check_times, typed_column


@dataclass(frozen=True, eq=False)
class InspectedRecording:
    """A recording of valid samples alone, and the findings of the inspection.

    Args:
        recording: masked rows are taken out, which leaves a gap in its `t_s`.
        reference: (n,) beside the samples that are left; None without a reference.
        rows: (n,) row of the input of each sample that is left.
    """

    recording: OutputRecording
    reference: Array | None
    rows: Indices
    inspection: Inspection


def build_recording(
    serial: str,
    t_s: Array,
    output: Array,
    *,
    sample_rate_Hz: float | None,
    output_unit: str = "V",
    stage_mm: Array | None = None,
    reference: Array | None = None,
    lines: Indices | None = None,
    config: InspectionConfig,
) -> InspectedRecording:
    """Inspect the columns of one recording and take invalid rows out of them.

    Args:
        lines: (n,) line of the file of each row, for remarks; None without a file.
        t_s: (n,) time stamps in s, strictly increasing, none missing.
        output: (n,) sensor output in `output_unit`; NaN is a missing sample, as in `stage_mm` and `reference`.
        config: thresholds of masking, from the calibration method of the unit.
        sample_rate_Hz: declared rate; None takes the median one of the time stamps.

    Raises:
        InputError: lengths differ, a time stamp is missing, repeated or backward, the declared rate is not that of the
            time stamps, or too few valid samples are left.
    """
    columns = {"output": output, "stage_mm": stage_mm, "reference": reference}
    t_s = typed_column("t_s", t_s)
    present = {
        name: typed_column(name, values, can_miss=True) for name, values in columns.items() if values is not None
    }
    for name, values in present.items():
        if len(values) != len(t_s):
            raise InputError(f"t_s has {len(t_s)} samples, {name} has {len(values)}; both must come from one recording")
        if np.isnan(values).all():
            raise InputError(f"{name} has no number in any of its {len(values)} rows")
    check_times(t_s)
    if sample_rate_Hz is None:
        sample_rate_Hz = 1.0 / float(np.median(np.diff(t_s))) if len(t_s) > 1 else float("nan")
    inspection, is_valid = inspect_samples(t_s, present, sample_rate_Hz, config, lines)
    rows = np.flatnonzero(is_valid)
    stage = present.get("stage_mm")
    recording = OutputRecording(
        serial,
        t_s[rows],
        present["output"][rows],
        float(sample_rate_Hz),
        output_unit,
        None if stage is None else stage[rows],
        inspection.masked,
    )
    labels = present.get("reference")
    return InspectedRecording(recording, None if labels is None else labels[rows], rows, inspection)
