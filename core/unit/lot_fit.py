"""What the fit of a lot gives one unit: a map that is paired with the load of the others, and what that rests on."""

from collections.abc import Sequence
from dataclasses import dataclass

from softcal.core.identity import content_sha256
from softcal.core.maps.choose import ChosenMap
from softcal.core.maps.common_load import LoadGroup, LotUnit
from softcal.core.maps.interface import map_sha256
from softcal.core.maps.source_bias import SourceBias
from softcal.core.unit.lot_fit_part import LotFitPart


@dataclass(frozen=True, eq=False)
class LotMap:
    """The map that the fit of a lot gives one unit."""

    unit: LotUnit
    part: LotFitPart

    @property
    def sha256(self) -> str:
        """Content hash of the map."""
        return map_sha256(self.unit.unit_map)

    @property
    def chosen(self) -> ChosenMap:
        """The map as the choice of a unit: what it might have been alone stands beside it."""
        alone, decision = self.unit.alone, "paired with the load that units of its lot share"
        alternatives = {alone.family: alone.unit_map, **alone.alternatives}
        return ChosenMap(self.unit.unit_map, {"decision": decision, "moved_rmse": self.unit.moved_rmse}, alternatives)

    @classmethod
    def from_group(
        cls, unit: LotUnit, group: LoadGroup, recordings: Sequence[str], number: int, bias: SourceBias | None = None
    ) -> "LotMap":
        """Return the map of a member of a group.

        Args:
            recordings: hashes of what was pressed together.
            bias: of the source, where the networks of others read the same load: what they differ by counts.
        """
        part = LotFitPart(
            number=number,
            sitting=content_sha256({}, {"recordings": sorted(recordings)}),
            units=len(recordings),
            common_rmse=max(group.common_rmse, 0.0 if bias is None else bias.common_rmse),
            unit_rmse=unit.unit_rmse,
        )
        return cls(unit, part)
