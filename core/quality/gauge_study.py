"""Gauge repeatability and reproducibility: how much of what is seen is the measurement (AIAG MSA, 4th edition).

Here the appraisers are stations or re-mounts and the parts are units; a trial is one press.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from softcal.core.errors import InputError
from softcal.core.recording import Array

K1 = {2: 0.8862, 3: 0.5908}
K2 = dict(zip(range(2, 11), (0.7071, 0.5231, 0.4467, 0.4030, 0.3742, 0.3534, 0.3375, 0.3249, 0.3146), strict=True))
"""1 / d2* for trials, and for appraisers and parts, of which there is one range (AIAG MSA, 4th ed., Appendix C)."""

POOLING_ALPHA = 0.05
"""An interaction less significant than this is counted as repeatability, as Minitab does."""


@dataclass(frozen=True)
class GaugeStudy:
    """Standard deviations of a gauge study, in the unit of the measurement.

    Args:
        repeatability: equipment variation EV, the same unit on the same station again.
        reproducibility: appraiser variation AV between stations or re-mounts, without the interaction.
        interaction: of units with stations; 0 where it was pooled or cannot be estimated.
        parts: PV, between units.
        interaction_p: p-value of the interaction; None without ANOVA.
    """

    method: str
    repeatability: float
    reproducibility: float
    interaction: float
    parts: float
    interaction_p: float | None = None  # noqa: V107

    @property
    def grr(self) -> float:
        """Combined repeatability and reproducibility."""
        return float(np.sqrt(self.repeatability**2 + self.reproducibility**2 + self.interaction**2))

    @property
    def total(self) -> float:
        """Everything together, TV."""
        return float(np.hypot(self.grr, self.parts))

    @property
    def grr_percent(self) -> float:
        return 100.0 * self.grr / self.total

    @property
    def categories(self) -> int:
        """How many kinds of units the gauge can tell apart, ndc; at least 5 are wanted."""
        return int(1.41 * self.parts / self.grr) if self.grr else 10_000

    @property
    def word(self) -> str:
        """good below 10 %, conditional up to 30 %, bad above (AIAG)."""
        return "good" if self.grr_percent < 10 else "conditional" if self.grr_percent <= 30 else "bad"

    def tolerance_percent(self, tolerance: float) -> float:
        """Return 6 GRR in % of a tolerance width."""
        return 600.0 * self.grr / tolerance


def study_by_anova(measured: Array) -> GaugeStudy:
    """Split the variance of a crossed study by two-way ANOVA with interaction.

    Args:
        measured: (parts, appraisers, trials), at least two of each.

    Raises:
        InputError: too few of something, a value that is not finite, or no variation at all.
    """
    parts, appraisers, trials = _checked(measured)
    mean = measured.mean()
    by_part, by_appraiser, cells = measured.mean((1, 2)), measured.mean((0, 2)), measured.mean(2)
    ss_part = appraisers * trials * np.sum((by_part - mean) ** 2)
    ss_appraiser = parts * trials * np.sum((by_appraiser - mean) ** 2)
    ss_cells = trials * np.sum((cells - mean) ** 2)
    # A difference of sums that are nearly equal may round below 0.
    ss_interaction = max(0.0, ss_cells - ss_part - ss_appraiser)
    ss_error = float(np.sum((measured - cells[:, :, None]) ** 2))
    df_interaction, df_error = (parts - 1) * (appraisers - 1), parts * appraisers * (trials - 1)
    ms_part, ms_appraiser = ss_part / (parts - 1), ss_appraiser / (appraisers - 1)
    ms_interaction, ms_error = ss_interaction / df_interaction, ss_error / df_error
    p = float(fdtrc(df_interaction, df_error, ms_interaction / ms_error)) if ms_error > 0 else 0.0
    # What cannot be told from repeatability is counted there: kept apart it would only make both less certain.
    if p > POOLING_ALPHA:
        ms_error = (ss_interaction + ss_error) / (df_interaction + df_error)
        ms_interaction, interaction = ms_error, 0.0
    else:
        interaction = _component(ms_interaction - ms_error, trials)
    return GaugeStudy(
        method="anova",
        repeatability=float(np.sqrt(ms_error)),
        reproducibility=_component(ms_appraiser - ms_interaction, parts * trials),
        interaction=interaction,
        parts=_component(ms_part - ms_interaction, appraisers * trials),
        interaction_p=p,
    )


def study_by_ranges(measured: Array) -> GaugeStudy:
    """Split the variation by the average and range method, which knows no interaction.

    Args:
        measured: (parts, appraisers, trials): 2 to 10 parts, 2 or 3 appraisers, 2 or 3 trials.

    Raises:
        InputError: another size, a value that is not finite, or no variation at all.
    """
    parts, appraisers, trials = _checked(measured)
    if parts not in K2 or appraisers not in K1 or trials not in K1:
        raise InputError(
            f"{parts} units, {appraisers} stations, {trials} trials: the average and range method is tabulated for "
            "2 to 10 units, 2 or 3 stations and 2 or 3 trials; use ANOVA"
        )
    repeatability = float(np.ptp(measured, axis=2).mean()) * K1[trials]
    spread = float(np.ptp(measured.mean((0, 2)))) * K2[appraisers]
    reproducibility = np.sqrt(max(0.0, spread**2 - repeatability**2 / (parts * trials)))
    return GaugeStudy(
        method="average-range",
        repeatability=repeatability,
        reproducibility=float(reproducibility),
        interaction=0.0,
        parts=float(np.ptp(measured.mean((1, 2)))) * K2[parts],
    )


def _component(difference: float, count: int) -> float:
    return float(np.sqrt(max(0.0, difference / count)))


def _checked(measured: Array) -> tuple[int, int, int]:
    if measured.ndim != 3 or min(measured.shape) < 2:
        raise InputError(
            f"a gauge study of shape {measured.shape}; at least 2 units, 2 stations and 2 trials are needed"
        )
    if not np.isfinite(measured).all():
        raise InputError("a gauge study needs every unit on every station in every trial; some value is missing")
    if np.ptp(measured) == 0:
        raise InputError("all measurements are equal; a gauge that shows no variation cannot be judged")
    return measured.shape[0], measured.shape[1], measured.shape[2]
