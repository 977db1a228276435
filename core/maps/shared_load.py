"""Fit the maps of a lot together: units that were pressed by one load at once share it, whether the source did or not.

Unlabelled, a unit's own map puts its load where the distribution of its output says. Each errs in its own way, so the
load that all of them share is known better than any of them. In the literature's words this is a multi-marginal
transport problem whose pairs are known, solved by alternating between the common load and the maps paired with it.
Unlike a Wasserstein barycentre the common load lives over time, not over a distribution: no plan is solved for, and the
barycentre at each instant is a weighted mean. Unlike the paper's pairwise plan (Kim et al. 2020, eq. 3) no unit needs
to have been pressed as the source was.

The maps are paired with the common load once. Pairs say nothing of its level: any common load is a fixed point of
pairing again, and its level would wander from what the source says. Only the weights are iterated until they stand.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from softcal.core.errors import UnitRefused
from softcal.core.maps.common_load import LoadGroup, LotMember, LotUnit, SharedLoad, find_groups
from softcal.core.maps.config import MapConfig
from softcal.core.maps.interface import Anchors, FitProblem
from softcal.core.messages.reason import Reason, reason
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording


@dataclass(frozen=True, eq=False)
class LotFit:
    """The maps of a lot, fitted together.

    Args:
        groups: the common loads.
        units: every unit that was asked for and has a map, by its serial.
        refused: why each of the others has none.
    """

    groups: tuple[LoadGroup, ...]
    units: Mapping[str, LotUnit]
    refused: Mapping[str, Reason]

    @property
    def members(self) -> tuple[str, ...]:
        """Serials of the units whose maps the lot changed."""
        return tuple(serial for serial, unit in self.units.items() if unit.group is not None)

    @property
    def outliers(self) -> Mapping[str, Reason]:
        """Why each of the other units stands alone."""
        return {serial: unit.reason for serial, unit in self.units.items() if unit.reason is not None}


def fit_lot(
    source: LabelledRecording,
    network: Network,
    targets: Sequence[OutputRecording],
    config: MapConfig = MapConfig(),  # noqa: B008 - frozen
    anchors: Mapping[str, Anchors] = MappingProxyType({}),
    paired: Collection[str] | None = None,
) -> LotFit:
    """Fit every unit's map, and pair it with the load that it shares with others where there is one.

    A unit that is paired with the source already keeps its map. The cost is linear in the number of units.

    Args:
        source: labelled recording of the source unit.
        network: f, trained on it.
        targets: output of each unit, each with its own serial; no reference is read.
        anchors: known loads of units by serial; who has some keeps its own map.
        paired: serials of the units to fit maps of; the others show the common load only. None for all.
    """
    paired = [target.serial for target in targets] if paired is None else paired
    every, refused = list[LotMember](), dict[str, Reason]()
    for target in targets:
        try:
            every.append(LotMember(FitProblem(source, network, target, anchors.get(target.serial), config)))
        except UnitRefused as error:
            refused[target.serial] = error.reason
    excluded = {one.serial: one.exclusion_reason for one in every if one.exclusion_reason is not None}
    open_, groups = {one.serial: one for one in every if one.serial not in excluded}, list[LoadGroup]()
    members = dict[str, LotUnit]()
    for matches in find_groups([one.problem.target for one in open_.values()], config):
        for target, synchrony in matches:
            open_[target.serial].synchrony = synchrony
        group = SharedLoad([open_[target.serial] for target, _ in matches], config.shared_load, paired)
        if group.reason is None:
            members |= group.fitted(len(groups))
        groups.append(group.summary)
        excluded |= group.excluded
    lone = reason("lot_fit.alone")
    alone = {s.serial: LotUnit(s.alone, s.alone.unit_map, reason=excluded.get(s.serial, lone)) for s in every}
    return LotFit(tuple(groups), {s: members.get(s, alone[s]) for s in alone if s in paired}, refused)
