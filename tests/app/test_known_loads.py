"""Known loads are rows of their unit: whoever asks for one unit reads no other's."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from softcal.app.registry import known_loads as module
from softcal.app.registry.known_loads import keep_loads, known_loads
from softcal.core.lot import Lot
from softcal.core.maps.interface import Anchors
from softcal.db.connection import open_registry
from softcal.db.registry import Registry

UNITS = 30


def loads(level: float) -> Anchors:
    return Anchors(np.array([level, level + 1.0]), np.array([0.0, 2.0]))


def sha256(number: int) -> str:
    return f"{number:064x}"


@pytest.fixture
def registry(tmp_path: Path):
    with open_registry(f"sqlite:///{tmp_path / 'registry.db'}") as opened:
        opened.lots.add(Lot("small", "S0", 50.0))
        yield opened


def test_who_asks_for_one_unit_reads_no_others(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(UNITS):
        assert keep_loads(registry, "small", {sha256(number): (f"U{number}", loads(number))}, "line") == 1
    read: list[str] = []

    def counted(text: str) -> object:
        read.append(text)
        return json.loads(text)

    monkeypatch.setattr(module, "json", SimpleNamespace(loads=counted))
    (one,) = known_loads(registry, "small", {"U7"}).values()
    assert one.serial == "U7" and one.loads.output.tolist() == [7.0, 8.0]
    assert len(read) == 1, "rows of other units were read"
    read.clear()
    assert keep_loads(registry, "small", {sha256(7): ("U7", loads(7))}, "line") == 0
    assert keep_loads(registry, "small", {sha256(UNITS): ("new", loads(0))}, "line") == 1
    assert len(read) == 1, "rows of other units were read"


def test_loads_of_several_units_are_kept_together_or_not_at_all(registry: Registry) -> None:
    several = {sha256(1): ("U1", loads(1)), sha256(2): ("U1", loads(2)), sha256(3): ("U3", loads(3))}
    assert keep_loads(registry, "small", several, "file") == 3
    assert set(known_loads(registry, "small", {"U1"})) == {sha256(1), sha256(2)}
    assert set(known_loads(registry, "small", {"U1", "U3"})) == set(several)
    broken = {sha256(4): ("U4", loads(4)), sha256(5): ("U5", loads(np.nan))}
    with pytest.raises(ValueError, match="JSON"):
        keep_loads(registry, "small", broken, "file")
    assert not known_loads(registry, "small", {"U4", "U5"})
