"""kill -9 in the middle of writing: what was acknowledged is there, nothing is there by half."""

import random
import subprocess
import sys
import time

import pytest

from softcal.db.connection import open_registry

pytestmark = pytest.mark.long

WRITER = """
import sys
from dataclasses import replace
from softcal.db.connection import open_registry
from softcal.core.identity import content_sha256
registry = open_registry(sys.argv[1], create=False)
state = registry.calibrations.get("A0").state
for number in range(100_000):
    serial = f"A{number % 7}"
    own = replace(state, fit=replace(state.fit, serial=serial, id=content_sha256({}, {"number": number})))
    with registry.transaction():
        revision = registry.calibrations.add("L1", own)
        registry.trail.add("export", "exports", (serial, revision), {})
    print(serial, revision, flush=True)
"""
KILLS = 3


@pytest.mark.parametrize("seed", range(KILLS))
def test_what_was_acknowledged_survives_a_kill(registry_url, make_factory, seed):
    with open_registry(registry_url) as registry:
        make_factory(registry).calibrate("A0")
    child = subprocess.Popen([sys.executable, "-c", WRITER, registry_url], stdout=subprocess.PIPE, text=True)
    first = child.stdout.readline()
    time.sleep(random.Random(seed).uniform(0.0, 0.3))
    child.kill()
    rest, _ = child.communicate()
    # The line being printed at the kill may be cut; whole lines are acknowledgements.
    acknowledged = [line.split() for line in (first + rest).splitlines(keepends=True) if line.endswith("\n")]
    assert acknowledged
    with open_registry(registry_url, create=False) as registry:
        assert registry.verify() == []
        for serial, revision in acknowledged:
            assert registry.calibrations.get(serial, int(revision)).state.serial == serial
        exports = {row.key for row in registry.trail.rows() if row.entity == "exports"}
        keys = {row.key for row in registry.trail.rows() if row.action == "calibrate"}
        assert len(exports) == len(keys) - 1, "a transaction is there whole or not at all"
