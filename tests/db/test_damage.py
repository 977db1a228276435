"""The benchmark of damaged and edited registries finds nothing silent or unseen, and would tell if there were any."""

from pathlib import Path

import pytest

pytestmark = pytest.mark.long

BENCHMARKS = str(Path(__file__).parents[2] / "benchmarks")


@pytest.fixture
def damage(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import registry_damage

    return registry_damage


@pytest.fixture
def damaged_registry(damage, tmp_path) -> Path:
    path = tmp_path / "registry.db"
    damage.make(path, units=5)
    return path


def total(rows, header, *names: str) -> int:
    return sum(row[header.index(name)] for row in rows for name in names)


def test_no_page_and_no_row_is_changed_silently(damage, damaged_registry, tmp_path):
    assert {"header", "free", "overflow", "table, leaf", "index, leaf"} <= set(damage.pages_by_kind(damaged_registry))
    flips = list(damage.flips(damaged_registry, tmp_path, 21, 5))
    assert total(flips, damage.FLIPS, "silent", "defect") == 0 and total(flips, damage.FLIPS, "told at use") > 0
    edits = list(damage.edits(damaged_registry, tmp_path, 42, 5))
    assert total(edits, damage.EDITS, "unseen") == 0 and total(edits, damage.EDITS, "found by verify") > 15


def test_without_the_checks_the_same_benchmark_tells(damage, damaged_registry, tmp_path):
    with damage.blind():
        edits = list(damage.edits(damaged_registry, tmp_path, 42, 5))
        flips = list(damage.flips(damaged_registry, tmp_path, 42, 5))
    assert total(edits, damage.EDITS, "unseen") > 10
    assert total(flips, damage.FLIPS, "silent") > 0
