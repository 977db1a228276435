"""Rules of one's own that keep a unit from being released: entry points of the group `softcal.rules`.

A rule can only hold a unit back, whatever was forecast or measured. Its name and version are part of the identity of
every calibration it looked at, so that another version makes older results anew.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from softcal.core.errors import InputError
from softcal.core.messages.reason import reason
from softcal.core.plugins import PluginKind
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Finding, Limit, Verdict


@dataclass(frozen=True, eq=False)
class RuleInput:
    """What a rule may look at. Of an audit it sees the error alone, not the reference.

    Args:
        recording: unlabelled recording of the unit.
        estimate: (n windows,) what f reads through the unit's map, in the reference unit.
        forecast: the error that is expected, in the reference unit.
        measured_rmse: error against an audit, in the reference unit; None where the unit was not measured.
    """

    recording: OutputRecording
    source: LabelledRecording
    estimate: Array
    forecast: ErrorForecast
    limit: Limit
    measured_rmse: float | None = None


@dataclass(frozen=True)
class Objection:
    """Why a rule holds a unit back: a sentence for the operator, shown as it stands.

    Where another recording may answer it, the unit is to be pressed again and is a `retest`; else it fails.
    """

    sentence: str
    press_again: bool = False


@runtime_checkable
class Rule(Protocol):
    """One rule: what it is called in messages, and another version wherever it decides otherwise."""

    name: str
    version: str

    def look(self, rule_input: RuleInput) -> Iterable[Objection]:
        """Return what stands against the unit; nothing lets it go on."""


def identity(rule: Rule) -> str:
    """Return what stands for a rule in the identity of a calibration."""
    return f"{rule.name} {rule.version}"


def is_rule(candidate: object) -> bool:
    """Return whether a thing has what a rule has: a name, a version and `look`."""
    has_texts = all(isinstance(getattr(candidate, name, None), str) for name in ("name", "version"))
    return has_texts and not isinstance(candidate, type) and callable(getattr(candidate, "look", None))


PLUGINS = PluginKind[Rule](
    "softcal.rules", "rule", "a rule with name, version and look", is_rule, lambda rule: rule.name
)
"""Rules that installed packages bring along, in the order of their entry points."""

RULES: Mapping[str, Rule] = {identity(rule): rule for rule in PLUGINS.merge_plugins({}).values()}
"""By identity."""


def rules_in_force() -> tuple[str, ...]:
    """Return the identities of the rules that are installed here."""
    return tuple(RULES)


def rule_findings(rule_ids: Sequence[str], rule_input: RuleInput) -> tuple[Finding, ...]:
    """Ask rules about a unit.

    Raises:
        InputError: a rule is not installed where the unit is calibrated.
    """
    findings: list[Finding] = []
    for name in rule_ids:
        rule = RULES.get(name)
        if rule is None:
            installed = ", ".join(RULES) or "none"
            raise InputError(
                f"rule {name!r} is not installed where unit {rule_input.recording.serial} is calibrated "
                f"(there: {installed}); nothing was decided: install one version of its package on every machine"
            )
        try:
            objections = [(str(one.sentence), bool(one.press_again)) for one in rule.look(rule_input)]
        except Exception as error:
            # A rule that cannot judge has not agreed: the unit waits, and the lot goes on.
            message = f"{type(error).__name__}: {error}"
            findings.append(Finding(reason("rule.broken", rule=name, error=message), Verdict.RETEST))
            continue
        for sentence, press_again in objections:
            best = Verdict.RETEST if press_again else Verdict.FAIL
            findings.append(Finding(reason("rule.held", sentence=sentence, rule=name), best))
    return tuple(findings)
