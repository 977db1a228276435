"""Inspection of the columns of a recording: invalid samples and findings."""

from collections.abc import Iterator, Mapping

import numpy as np

from softcal.core.inspection.config import InspectionConfig
from softcal.core.inspection.dropouts import find_dropouts
from softcal.core.inspection.inspection import MAX_TIMES, Inspection, InspectionFinding
from softcal.core.inspection.levels import level_findings
from softcal.core.inspection.outliers import column_scale, fill, find_overflows, find_spikes
from softcal.core.inspection.reference import reference_findings
from softcal.core.inspection.timing import timing_findings, window_share
from softcal.core.recording import MASK_KINDS, Array, Indices, Mask, MaskedSamples

REFERENCE = "reference"


def inspect_samples(
    t_s: Array,
    columns: Mapping[str, Array],
    sample_rate_Hz: float,
    config: InspectionConfig,
    lines: Indices | None = None,
) -> tuple[Inspection, Mask]:
    """Return the inspection of the columns of one recording, before any fit.

    Outliers are found first, by quantiles; whatever else is looked for sees a recording without them.

    Args:
        t_s: (n,) strictly increasing.
        columns: `output`, and where they exist `stage_mm` and `reference`: (n,) each, NaN for a missing sample.
        lines: (n,) line of the file of each row; None where there was no file.

    Returns:
        What the look shows, and which rows are valid, (n,).
    """
    kinds, values, findings = np.full(len(t_s), -1), np.full(len(t_s), np.nan), []
    stage_mm = None
    for name in (REFERENCE, "stage_mm", "output"):
        if name not in columns:
            continue
        for kind, is_invalid in _find_invalid(name, t_s, columns[name], stage_mm, sample_rate_Hz, config):
            findings += _outlier_findings(kind, name, t_s, columns[name], is_invalid)
            kinds[is_invalid] = MASK_KINDS.index(_mask_kind(kind, name))
            values[is_invalid] = columns[name][is_invalid]
        if name == "stage_mm" and (kinds < 0).any():
            stage_mm = fill(columns[name], kinds >= 0)
    is_valid = kinds < 0
    lines = np.zeros(len(t_s), dtype=np.int64) if lines is None else lines
    rows = np.flatnonzero(~is_valid)
    masked = MaskedSamples(t_s[rows], kinds[rows].astype(np.int64), values[rows], lines[rows])
    if np.count_nonzero(is_valid) > 1:
        filled = {name: fill(values, ~is_valid) for name, values in columns.items()}
        findings += timing_findings(t_s, filled["output"], sample_rate_Hz, config)
        findings += level_findings(t_s, filled["output"], sample_rate_Hz, config)
        if REFERENCE in columns:
            findings += reference_findings(t_s, filled["output"], filled[REFERENCE], sample_rate_Hz, config)
    share = window_share(t_s[is_valid], len(t_s), sample_rate_Hz)
    return Inspection(len(t_s), masked, tuple(findings), share), is_valid


def _mask_kind(kind: str, column: str) -> str:
    if column != REFERENCE:
        return kind
    return "no_reference" if kind == "missing" else "reference_outlier"


def _find_invalid(
    name: str, t_s: Array, values: Array, stage_mm: Array | None, rate_Hz: float, config: InspectionConfig
) -> Iterator[tuple[str, Mask]]:
    is_missing = np.isnan(values)
    yield "missing", is_missing
    is_overflow = find_overflows(values, config)
    yield "overflow", is_overflow
    is_invalid = is_missing | is_overflow
    if name == "stage_mm" or is_invalid.all():
        return
    filled = fill(values, is_invalid)
    min_share = config.reference_spike_share if name == REFERENCE else config.spike_share
    is_spike = find_spikes(t_s, filled, rate_Hz, min_share, config) & ~is_invalid
    yield "spike", is_spike
    if name != REFERENCE:
        is_dropout = np.zeros(len(values), dtype=np.bool_)
        for dropout in find_dropouts(fill(values, is_invalid | is_spike), stage_mm, config.dropout):
            is_dropout[dropout.begin : dropout.end] = True
        yield "dropout", is_dropout & ~is_invalid & ~is_spike


def _outlier_findings(kind: str, column: str, t_s: Array, values: Array, is_invalid: Mask) -> list[InspectionFinding]:
    if not is_invalid.any():
        return []
    valid = values[~is_invalid & np.isfinite(values)]
    scale, middle = column_scale(valid), float(np.median(valid))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_invalid, [False]])))
    findings = []
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        run = values[start:stop]
        value = float("nan") if kind == "missing" else float(run[np.argmax(np.abs(run - middle))])
        times = min(abs(value - middle) / scale.span, MAX_TIMES) if scale.span > 0 else MAX_TIMES
        findings.append(InspectionFinding(kind, column, start, stop, float(t_s[start]), value, times))
    return findings
