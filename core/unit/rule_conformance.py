"""What every rule must keep, for the tests of rules in other packages."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from softcal.core.maps.conformance import example_problem
from softcal.core.unit.rules import Objection, Rule, RuleInput, is_rule
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Limit


def faults(rule: Rule) -> list[str]:
    """Return what a rule does wrong, a line each; nothing where it conforms.

    Checked, on a unit that was measured and on one that was not: it has a name and a version, answers twice alike with
    sentences, and changes nothing of what it looks at.
    """
    if not is_rule(rule):
        return ["a rule has a text `name`, a text `version` and a method `look(rule_input)`"]
    problems = [f"`{part}` is empty" for part in ("name", "version") if not getattr(rule, part).strip()]
    for rule_input in _examples():
        output, estimate = rule_input.recording.output.copy(), rule_input.estimate.copy()
        try:
            first, again = list(rule.look(rule_input)), list(rule.look(rule_input))
        except Exception as error:
            problems.append(f"look raises {type(error).__name__}: {error}")
            continue
        if not all(isinstance(one, Objection) and str(one.sentence).strip() for one in first):
            problems.append("look gives something else than objections with a sentence")
        elif first != again:
            problems.append("look answers the same unit differently the second time")
        if not (np.array_equal(output, rule_input.recording.output) and np.array_equal(estimate, rule_input.estimate)):
            problems.append("look changes what it was given")
    return list(dict.fromkeys(problems))


def _examples() -> Iterator[RuleInput]:
    """Yield a unit within its limit that nobody measured, the same measured beyond it, and one at rest."""
    problem = example_problem()
    estimate = problem.network.evaluate(problem.target.windows)
    limit, forecast = Limit(problem.source.reference_unit, 0.5), ErrorForecast(0.1, 0.05, 0.2)
    unmeasured = RuleInput(problem.target, problem.source, estimate, forecast, limit)
    yield unmeasured
    yield replace(unmeasured, measured_rmse=0.7)
    still = replace(problem.target, output=np.full_like(problem.target.output, 0.4))
    yield replace(unmeasured, recording=still, estimate=np.zeros_like(estimate))
