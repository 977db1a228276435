"""Sentences of a certificate that apply to every unit: method, decision rule, basis, reasons for no statement."""

from collections.abc import Mapping

PAPER = "Kim, Kwon, Jeon and Park, 2020, Advanced Intelligent Systems, 1900178"

METHODS: Mapping[str, tuple[str, str]] = {
    "identity": ("the source's network unchanged", "The unit's windows were taken as the source's, unchanged"),
    "affine": ("one gain and offset", "A gain and an offset were found from the distributions of both outputs"),
    "two_point": (
        "rest and peak matched by a line",
        "A gain and an offset were found from rest and peak of the unit's output, blind to how long and how fast it "
        "was pressed",
    ),
    "monotone": (
        "one-dimensional optimal transport",
        "Equal quantiles of both outputs were matched (one-dimensional optimal transport)",
    ),
    "averaged": (
        "mean of rest and peak, and of equal quantiles",
        "The line through rest and peak of both outputs was averaged with two curves through their equal quantiles: of "
        "all time, and of time without dwell",
    ),
    "synchronous": (
        "pairs at equal time",
        "Unit and source were pressed by one load at once; the map was fitted to the pairs of their windows",
    ),
    "stage_matched": (
        "pairs at equal stage position",
        "The map was fitted to pairs of windows at equal stage positions of unit and source",
    ),
    "shared_load": (
        "pairs with the common load of the lot",
        "Units of the lot were pressed by one load at once; the map was fitted to pairs with what the others read",
    ),
    "exact": (
        "exact discrete optimal transport",
        f"Windows were matched by exact discrete optimal transport ({PAPER}, eq. 3)",
    ),
    "joint": (
        "joint transport of windows and labels",
        "Windows and estimates were matched together by joint optimal transport (Courty et al. 2017)",
    ),
}
"""By family of the map: its name, and how it is fitted."""

DECISION_RULE = (
    "E is the error that decides: the measured one where the unit was measured, else the predicted one. E_lower to "
    "E_upper is its 95 % interval; where audits of other units decide, E_upper is the most that they leave open. TL is "
    "the limit. U_ref is the expanded uncertainty (k = 2) of the source's reference. AL = sqrt(TL^2 - U_ref^2). Pass: "
    "E_upper <= AL, and an audit of the unit or of its lot stands behind E. Conditional pass: E <= TL. Fail: E > TL. "
    "What was found against the unit makes the word worse, never better, and stands beside the verdict. U_est, the "
    "expanded uncertainty of one estimate, decides nothing. The guard band is E_upper - E (ILAC-G8:09/2019, 4.2.3)."
)

WITHHOLDING_REASONS: Mapping[str, str] = {
    "simulated": "no real unit was calibrated",
    "no_limit": "no limit was stated",
    "no_reference": "nobody stated what the source was compared with",
    "reference": "the reference cannot be relied on",
    "known_loads": "the map was set by known loads, nobody stated what these are traced to, and no audit followed",
    "no_interval": "the interval of the error is not known",
    "retest": "nothing can be said about the unit yet",
}
"""Why no statement of conformity is made, by code."""

NOT_COMPARED = (
    "The error of this unit is predicted from unlabelled data; the unit itself was not compared with a load cell."
)
SAMPLED = "Audits of other units of the lot stand behind the interval of the predicted error."
COMPARED = (
    "The unit was also compared with a reference on an audit recording; the measured error is stated. What the lot "
    "states of its reference is said of the source's recording."
)
TRIMMED = "The errors stated are those of the map before its trim; the unit was not compared with a reference since."
ONLY_THIS = (
    "The results relate only to the item named above, in the condition it was in. This certificate may be reproduced "
    "in full only."
)
SIMULATED = (
    "SIMULATED: the recordings come from a simulated station. No instrument was used, no real unit was calibrated, and "
    "nothing is metrologically traceable."
)
