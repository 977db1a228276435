"""The diagnosis knows no effect by name: what it must know of one stands in the effect's entry of the catalogue."""

import re
from pathlib import Path

from softcal.core.twin.catalogue import EFFECTS

ROOT = Path(__file__).parents[2]
GENERIC = sorted([*(ROOT / "core" / "gap").rglob("*.py"), ROOT / "core" / "twin" / "simulate.py"])


def test_generic_code_names_no_effect() -> None:
    names_by_file = {path.name: set(re.findall(rf"\b({'|'.join(EFFECTS)})\b", path.read_text())) for path in GENERIC}
    assert {name: names for name, names in names_by_file.items() if names} == {}, "say it in the effects' entries"


def test_the_test_would_see_a_name() -> None:
    assert re.search(rf"\b({'|'.join(EFFECTS)})\b", 'if effect.id == "adc_saturation":')
