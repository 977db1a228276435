"""Every hazard of docs/hazards.md names a test that exists: a function, a fault of the matrix, a file."""

import re
from pathlib import Path

from common.drawn_faults import KINDS

from softcal.station.testing.faults import FAULTS

ROOT = Path(__file__).parents[2]
TABLE, POWER = (ROOT / "docs" / "hazards.md").read_text().split("## Undetected faults")
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in TABLE.splitlines()
    if line.startswith("| ") and not line.startswith("| cause")
]
TESTS = set(re.findall(r"def (test_\w+)", "\n".join(path.read_text() for path in (ROOT / "tests").glob("*/*.py"))))
NAMES = [fault.name for fault in FAULTS]


def exists(name: str) -> bool:
    if name.startswith("test_"):
        return name in TESTS
    if ".py" in name:
        return (ROOT / name.split()[0]).is_file()
    pattern = ".*".join(re.escape(part.strip()) for part in name.split("…"))
    return any(re.fullmatch(pattern, fault) for fault in NAMES)


def test_each_hazard_has_cause_detection_reaction_and_a_test_that_exists() -> None:
    for row in ROWS:
        cause, detection, reaction, test = row
        assert cause and detection and reaction, row
        names = re.findall(r"`([^`]+)`", test)
        assert names and [name for name in names if not exists(name)] == [], row


def test_every_kind_of_drawn_fault_has_its_share_on_the_page() -> None:
    assert [kind.name for kind in KINDS if f"| {kind.name} |" not in POWER] == []


def test_each_fault_of_the_matrix_stands_in_the_hazard_table() -> None:
    fault_names = [name for row in ROWS for name in re.findall(r"`([^`]+)`", row[3]) if "test" not in name]
    patterns = [".*".join(re.escape(part.strip()) for part in name.split("…")) for name in fault_names]
    assert [fault for fault in NAMES if not any(re.fullmatch(pattern, fault) for pattern in patterns)] == []
