"""What one recording gave: the fit of a unit, which nothing changes that comes later."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from softcal.core.maps.interface import UnitMap
from softcal.core.messages.reason import Reason
from softcal.core.unit.budget import Reference
from softcal.core.unit.correspondence import Correspondence
from softcal.core.unit.health import OutputLimits
from softcal.core.unit.lot_fit_part import LotFitPart
from softcal.core.unit.method import Method
from softcal.core.unit.missing import MissingShares
from softcal.core.unit.output_level import OutputLevel
from softcal.core.unit.uncertainty import ErrorForecast, Interval
from softcal.core.unit.verdict import Finding, worst_of


@dataclass(frozen=True, eq=False)
class FittedMap:
    """The arrays of a fit: the map γ, its 90 % interval, and the limits of the unit's output."""

    unit_map: UnitMap
    interval: Interval
    output_limits: OutputLimits


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """What one recording gave: never changed by anything that comes later. Errors are in the reference unit.

    Args:
        id: content hash of what it was fitted from: recording, network, method, known loads, golden run.
        map_sha256: content hash of the map γ.
        correspondence: how unit and source correspond.
        budget: standard uncertainties u_i of the forecast by term (GUM, JCGM 100:2008).
        diagnostics: numbers of the map's family, for people to read.
        findings, rule_findings: what recording and map show against the unit; what rules of other packages say.
        remarks: what is said last beside a forecast.
        blocking_reasons: what keeps the unit from passing whatever its error is.
        rules: identities of the rules of other packages that were asked.
        reference: what the source is traced to; None where nobody said.
        missing: shares of samples and windows that are missing; None where nothing is.
        load_rms, correction_rms: RMS load above rest of the recording; RMS change that the map makes.
        lot_fit: its part in the fit of the lot; None where it was mapped by itself.
        fit_s: how long map and forecast took, in s.
        fitted: its arrays; None where units are listed without them.
    """

    id: str
    serial: str
    network_id: str
    recording_sha256: str
    family: str
    map_sha256: str
    method: Method
    correspondence: Correspondence
    forecast: ErrorForecast
    budget: Mapping[str, float] = field(default_factory=dict)
    diagnostics: Mapping[str, float | str] = field(default_factory=dict)  # noqa: V107
    findings: tuple[Finding, ...] = ()
    rule_findings: tuple[Finding, ...] = ()
    remarks: tuple[Reason, ...] = ()
    blocking_reasons: tuple[Reason, ...] = ()
    rules: tuple[str, ...] = ()
    reference: Reference | None = None
    output_level: OutputLevel | None = None
    missing: MissingShares | None = None
    load_rms: float | None = None
    correction_rms: float | None = None
    readout_lag_s: float | None = None  # noqa: V107
    lot_fit: LotFitPart | None = None
    fit_s: float | None = None
    fitted: FittedMap | None = None

    @property
    def is_open(self) -> bool:
        """Whether no finding stands against the unit: its forecast alone may, and audits can correct that."""
        return worst_of(one.best for one in (*self.findings, *self.rule_findings)).is_open
