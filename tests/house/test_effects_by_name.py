"""The diagnosis knows no effect by name: what it must know of one stands in the effect's entry of the catalogue."""

import re
from pathlib import Path

import pytest

from softcal.core.twin.catalogue import EFFECTS

ROOT = Path(__file__).parents[2]
GENERIC = sorted([*(ROOT / "core" / "gap").rglob("*.py"), ROOT / "core" / "twin" / "simulate.py"])


@pytest.mark.parametrize("path", GENERIC, ids=lambda path: path.name)
def test_generic_code_names_no_effect(path: Path) -> None:
    named = re.findall(rf"\b({'|'.join(EFFECTS)})\b", path.read_text())
    assert not named, f"{path.name} knows {sorted(set(named))}; say it in the effects' entries"


def test_the_test_would_see_a_name() -> None:
    assert re.search(rf"\b({'|'.join(EFFECTS)})\b", 'if effect.id == "adc_saturation":')
