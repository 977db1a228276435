"""The gap between simulator and rig, in Python."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from softcal.app.api.arguments import expect, file_path
from softcal.app.gap.diagnose import diagnose_case
from softcal.core.twin.parameters import ReadoutMetadata

if TYPE_CHECKING:
    from softcal.core.gap.diagnosis import Diagnosis
    from softcal.core.gap.twin import TwinModel


def diagnose(
    case: Any, progress: Callable[[str], None] | None = None, readout: ReadoutMetadata | None = None
) -> "Diagnosis[TwinModel]":
    """Diagnose where the simulator differs from the rig that a case was recorded on.

    >>> import pathlib, tempfile, softcal
    >>> from softcal.core.twin.parameters import ReadoutMetadata
    >>> (source,) = softcal.simulate_recordings(units=0, duration_s=8)
    >>> path = pathlib.Path(tempfile.mkdtemp(), "S1.csv")
    >>> source.to_frame().to_csv(path, index=False)
    >>> readout = ReadoutMetadata(vref_V=3.3, adc_bits=12, r_series_ohm=10.0, sample_rate_Hz=50.0)
    >>> report = softcal.diagnose(path, readout=readout).report()
    >>> ", ".join(report["missing_channels"])
    'stage_mm, temperature_C'

    Args:
        case: folder of a case, or a plain table.
        progress: called with a sentence at every step.
        readout: the electronics of a plain table; a case folder states its own.

    Raises:
        InputError: the case cannot be read, or a table comes without its electronics.
    """
    if readout is not None:
        expect("readout", readout, ReadoutMetadata, "a softcal.core.twin.parameters.ReadoutMetadata")
    return diagnose_case(file_path("case", case), progress, readout)
