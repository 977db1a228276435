"""Every number that decides about a unit stands in `Method`, with its origin, and is part of its identity."""

import ast
import json
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import pytest

from softcal.core.gap.method import GapMethod
from softcal.core.operation.method import DriftTracking
from softcal.core.settings import origins
from softcal.core.unit.method import Method

CORE = Path(__file__).parents[2] / "core"
PACKAGES = ("unit", "maps", "operation")
NO_DECISION = {
    "core/unit/method.py": {"CONFIDENCE", "LEVELS"},  # parts of the file formats, and fields of `Method`
    "core/unit/audit.py": {"INSTANTS"},  # instants of the stored reading
    "core/unit/trim.py": {"MAX_CHANGE"},  # what a device holds
    "core/unit/day_correction.py": {"SAME_DAY"},  # the identity
    "core/unit/line_spread.py": {"MAX_SPREAD"},  # 1, the end of what a share can be
    "core/unit/uncertainty.py": {"NORMAL_90"},  # a quantile of the normal distribution
    "core/unit/budget.py": {"COVERAGE", "DIVISORS"},  # what a certificate states, and the GUM's distributions
    "core/maps/paired.py": {"MIN_WINDOWS", "DAMPING", "SETTLED", "IDLE_STEPS"},  # what is refused, and of a solver
    "core/maps/plan.py": {"MAX_WINDOWS", "MAX_JOINT_WINDOWS", "MAX_JOINT_ROUNDS", "NEIGHBOURS", "RIDGE_PER_WINDOW"},
    "core/maps/readout_lag.py": {"MEAN_SAMPLES"},  # noise is averaged away
    "core/maps/crossing.py": {"CACHED"},  # entries of a cache
    "core/maps/synchrony.py": {"NONE", "LONGEST_LAG_s", "STRETCHES"},  # zeros, where a search ends, a cache
    "core/operation/adapter.py": {"STATE_FORMAT"},  # of the stored state
    "core/operation/stream_estimator.py": {"MAX_UPDATES"},  # length of a queue for the caller
    "core/gap/case.py": {
        "SHORTEST",
        "HALF_WIDTH",
        "SHIFTED",
        "COMMON",
        "POWERS",
    },  # what is refused, a smoother, units, the common rig
    "core/gap/episodes.py": {"SKEW_STEPS", "ACROSS", "MAINS_Hz", "PLACEMENTS"},  # of a solver, and of power lines
    "core/gap/fit.py": {"TOLERANCE", "TRIES"},  # of a solver
    "core/gap/hypothesis.py": {"DIFFERENCE", "BASE"},  # of a solver, and the base's bounds
    "core/gap/linear.py": {"COMMON_STEP_s"},  # of the common rig
    "core/gap/mistakes.py": {"UNITS_OF_RUN", "TIME_UNITS", "UNITS"},  # units
    "core/gap/fault_location.py": {"TIED"},  # rounding
    "core/gap/model.py": {"PASSES", "LINEAR_SIGMA"},  # of a solver
    "core/gap/residual.py": {"TRIMMED"},  # of an estimator
    "core/gap/search.py": {"MIN_GAIN_SHARE", "GENTLER"},  # where a fit begins
    "core/gap/simulator.py": {
        "REPEATABLE",
        "MOVED",
        "UNEQUAL",
        "SMOOTH",
        "FEWEST_STEPS",
        "OFF_GRID",
        "PROBED",
    },  # what is refused
    "core/gap/simulator_model.py": {"MAX_CACHED", "DRAWS", "FIRST_STEPS", "MIN_LIFT"},  # a cache, a fit, a list
    "core/gap/simulator_reach.py": {"FACTORS", "BLUNT", "MEMORIES"},  # units, parts of stored terms
    "core/gap/twin.py": {"QUIETEST"},  # a guard
    # equations, numbers of a solver, and runs that may be proposed
    "core/gap/twin_reach.py": {"WARM_DIVIDER", "UNMODELLED_EFFECTS", "LEVELS", "REST_s", "SET_UP_min", "TOUCHING_share"}
    | {"INVERSE_STEPS", "RETRACTED_mm"},
    "core/lot_diagnosis.py": {"MIN_UNITS"},  # what is refused
    "core/transfer.py": {"NETWORK"},  # the same network for rig and twins
    "core/operation/cycles.py": {"MAX_SAMPLES"},  # samples of a buffer; a longer cycle is thinned
}
"""Numbers outside the method that cannot change a map, an interval, a forecast or a verdict."""


def constants(path: Path) -> Iterator[str]:
    """Yield the names of a module that are given a number, or something made of numbers."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            is_number = any(
                isinstance(part, ast.Constant)
                and isinstance(part.value, int | float)
                and not isinstance(part.value, bool)
                for part in ast.walk(node.value)
            )
            if is_number:
                yield from (name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name))


DECIDES_ABOUT_NO_UNIT = {"core/maps/conformance.py", "core/unit/rule_conformance.py"}
"""The kit for those who write a map family: it makes its own lots."""

TRIVIAL = {0, 1, 2, 0.5}
GUARD = 1e-6
"""A number this small keeps a division or a logarithm finite; what it changes is rounding."""

EXPLAINED = {
    "core/maps/crossing.py": {
        "2048": "places of an axis over the whole range",
        "3": "samples shared by neighbouring means",
    },
    "core/maps/curve.py": {"3": "thirds of a curve", "10": "any two places fix a straight line"},
    "core/maps/ends.py": {
        "0.6745": "median of the magnitude of a standard normal variable",
        "6": "variance of a second difference over that of the samples",
        "12": "variance of a uniform variable over its squared width",
        "3": "a third of a window",
        "10": "windows that a press takes",
    },
    "core/operation/activity.py": {"12": "one over the variance of a uniform index from -1/2 to 1/2"},
    "core/operation/adapter.py": {"300": "places of a table over three swings"},
    "core/maps/anchors.py": {"30": "samples of a straight line", "0.01": "one load stated twice"},
    "core/maps/common_load.py": {
        "3": "sums over the units",
        "8": "bands of load that two numbers are fitted to",
        "20": "rounds of the weights at most",
        "0.01": "of the mean weight: no estimate moves by less",
    },
    "core/maps/choose.py": {"5": "a third of a window", "20": "levels of a histogram"},
    "core/maps/paired.py": {
        "1.5": "exponent of the integral of a squared second difference",
        "3": "knots that a bend needs",
        "40": "steps of the descent at most",
        "14": "attempts of a step at most",
        "4": "Marquardt's factor on the damping after a step that failed",
        "10": "the same after one that did not; pairs to a knot",
    },
    "core/maps/readout_lag.py": {
        "10": "means that share no sample",
        "4": "half octaves below the least lag",
        "8": "half octaves above it",
        "7": "time constants after which a thousandth is left",
        "5": "means that share most samples, to a length",
    },
    "core/maps/synchrony.py": {
        "4": "bands of one recording in a cache; a quarter of a circular correlation",
        "20": "rounds of a search at most",
        "0.51": "half a sample and its rounding",
        "0.2": "of the range: a swing of an opening",
        "0.9": "of a flat peak: lag 0 is kept",
    },
    "core/maps/plan.py": {
        "2000000": "iterations of the exact solver: it refuses beyond them, nothing else changes",
        "0.0001": "gain of a round that is rounding",
    },
    "core/unit/estimate.py": {"3": "columns: estimate and both limits", "12": "letters of a name in a message"},
    "core/unit/evidence.py": {"12": "variance of a uniform variable over its squared width"},
    "core/unit/day_correction.py": {"16": "stretches of time, every other held out"},
    "core/unit/forecast.py": {"5": "pseudo-counts of a table", "9": "levels of a smoother"},
    "core/unit/scoring.py": {"0.75": "what own calibration trains on (Kim et al. 2020, Table 1)"},
    "core/unit/health.py": {
        "0.6745": "median of the magnitude of a standard normal variable",
        "6": "variance of a second difference over that of the samples",
        "0.001": "width of a flat stretch without noise or steps",
    },
    "core/unit/method.py": {"0.9": "a tenth below another number"},
    "core/unit/source_model.py": {
        "0.05": "a finite step of a slope",
        "0.999": "quantile of bend and roughness",
        "0.001": "floor of a divisor",
    },
    "core/unit/uncertainty.py": {"3": "terms of a parabola", "4": "features of a window"},
}
"""Numbers inside functions that nobody chose, with what they are."""


def literals(path: Path) -> Iterator[tuple[str, int]]:
    """Yield (number, line) of every number inside a function that is neither trivial nor a guard."""
    for function in ast.walk(ast.parse(path.read_text())):
        if not isinstance(function, ast.FunctionDef):
            continue
        for part in ast.walk(function):
            value = part.value if isinstance(part, ast.Constant) else None
            if isinstance(value, int | float) and not isinstance(value, bool):
                if value not in TRIVIAL and not 0 < value <= GUARD:
                    yield f"{value:.15g}", part.lineno


@pytest.mark.parametrize("package", PACKAGES)
def test_no_function_holds_a_number_that_decides(package: str) -> None:
    numbers = []
    for path in sorted((CORE / package).glob("*.py")):
        module = path.relative_to(CORE.parent).as_posix()
        if module in DECIDES_ABOUT_NO_UNIT:
            continue
        explained = EXPLAINED.get(module, {})
        numbers += [f"{module}:{line}: {text}" for text, line in literals(path) if text not in explained]
    assert not numbers, "\n".join(numbers)


def test_explained_numbers_are_there() -> None:
    for module, explained in EXPLAINED.items():
        assert set(explained) <= {text for text, _ in literals(CORE.parent / module)}, module


RELEASE = ("acceptance", "audit_check", "lot_release", "qualification", "release")
"""Modules of core/quality that decide which units pass on the audits of others."""


@pytest.mark.parametrize("module", RELEASE)
def test_no_number_of_a_release_by_sample_stands_outside_the_method(module: str) -> None:
    assert set(constants(CORE / "quality" / f"{module}.py")) == set()


@pytest.mark.parametrize("package", (*PACKAGES, "gap"))
def test_no_module_keeps_a_number_that_decides(package: str) -> None:
    for path in sorted((CORE / package).glob("*.py")):
        module = path.relative_to(CORE.parent).as_posix()
        assert set(constants(path)) <= NO_DECISION.get(module, set()), module


def changed(config: object) -> Iterator[tuple[str, object]]:
    """Yield a configuration with one number changed, for each of its numbers in turn."""
    for one in fields(config):  # type: ignore[arg-type]
        value = getattr(config, one.name)
        if is_dataclass(value):
            for name, inner in changed(value):
                yield f"{one.name}.{name}", replace(config, **{one.name: inner})  # type: ignore[type-var]
        else:
            other = _other(value)
            yield one.name, replace(config, **{one.name: other})  # type: ignore[type-var]


def _other(value: object) -> object:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    if isinstance(value, str):
        return f"{value}?"
    assert isinstance(value, tuple)
    return (*value[:-1], _other(value[-1]))


FORMAT = {"taps", "levels", "confidence"}


def test_every_number_is_part_of_the_identity() -> None:
    method = Method()
    numbers = {name for name, _, _ in method.numbers()}
    hashes = set()
    for part in ("version", "range_margin"):
        assert replace(method, **{part: getattr(method, part) + 1}).id != method.id
        hashes.add(part)
    for section in (one.name for one in fields(method) if is_dataclass(getattr(method, one.name))):
        for name, config in changed(getattr(method, section)):
            assert replace(method, **{section: config}).id != method.id, name
            hashes.add(f"{section}.{name}")
    assert hashes == numbers - FORMAT


def test_numbers_of_the_file_formats_cannot_be_changed() -> None:
    for name in FORMAT:
        with pytest.raises(ValueError, match="part of the file formats"):
            Method(**{name: getattr(Method(), name) + 1})


@pytest.mark.parametrize("method", [Method(), DriftTracking(), GapMethod()], ids=["calibration", "use", "gap"])
def test_every_number_says_where_it_comes_from(method: object) -> None:
    assert [name for name, _, origin in origins(method) if not origin.strip()] == []


def test_every_number_of_use_is_part_of_its_identity() -> None:
    method = DriftTracking()
    changes = dict(changed(method))
    assert set(changes) == {name for name, _, _ in method.numbers()}
    for name, config in changes.items():
        assert config.id != method.id, name  # type: ignore[attr-defined]


def test_a_method_comes_back_from_what_was_kept() -> None:
    method = replace(Method(), range_margin=0.07)
    assert Method.from_json(json.loads(json.dumps(method.to_json()))) == method
    assert Method.from_json({}) == Method()


ROOT = CORE.parent
PRODUCT = [path for folder in ("app", "core", "db", "station") for path in sorted((ROOT / folder).rglob("*.py"))]


def numbered_classes() -> set[str]:
    """Names of the classes whose numbers are declared with `setting` or `table`, and of those made of them."""
    return {
        node.name
        for path in PRODUCT
        if "softcal.core.settings import" in (text := path.read_text())
        for node in ast.parse(text).body
        if isinstance(node, ast.ClassDef) and any(isinstance(part, ast.AnnAssign) for part in node.body)
    }


NUMBERED = numbered_classes()
FIELDS = {
    part.target.id
    for path in PRODUCT
    for node in ast.walk(ast.parse(path.read_text()))
    if isinstance(node, ast.ClassDef) and node.name in NUMBERED
    for part in node.body
    if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name)
}


def test_no_number_is_read_from_the_class_of_a_configuration() -> None:
    """A class has this version's numbers; what is hashed is the method that a unit was calibrated with."""
    assert {"Method", "ReleaseConfig", "MapConfig", "DriftTracking", "GapMethod", "ProofMethod"} <= NUMBERED
    read = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.value.id}.{node.attr}"
        for path in PRODUCT
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
        if node.value.id in NUMBERED and node.attr in FIELDS
    ]
    assert read == []


OF_A_RUN = {"core/inspection", "core/gap", "station/record"}
"""Packages that judge recordings before, or rigs without, a unit that was calibrated: one method for all of them."""


def test_no_module_keeps_a_configuration() -> None:
    """What a module keeps cannot be the numbers of the method that it is called with."""
    defaults = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in PRODUCT
        if path.parent.relative_to(ROOT).as_posix() not in OF_A_RUN
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None
        for part in ast.walk(node.value)
        if isinstance(part, ast.Call) and isinstance(part.func, ast.Name) and part.func.id in NUMBERED
    ]
    assert defaults == []


DECIDING = ("quality", "unit")


@pytest.mark.parametrize("package", DECIDING)
def test_no_function_that_decides_has_a_configuration_by_default(package: str) -> None:
    """A caller that leaves a method out would judge by another than the one that is stored."""
    defaults = [
        f"{path.relative_to(ROOT)}:{function.lineno}: {function.name}"
        for path in sorted((CORE / package).glob("*.py"))
        for function in ast.walk(ast.parse(path.read_text()))
        if isinstance(function, ast.FunctionDef)
        for default in (*function.args.defaults, *function.args.kw_defaults)
        if isinstance(default, ast.Call) and isinstance(default.func, ast.Name) and default.func.id in NUMBERED
    ]
    assert defaults == []
