"""The application as a window of its own: the browser gets the address, and closing it ends the screen alone."""

import json
import os
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

SOFTCAL = str(Path(sys.executable).with_name("softcal"))
BROWSER = """#!{python}
import json, sys, urllib.request
address = next(a for a in sys.argv if a.startswith("--app=")).removeprefix("--app=")
health = urllib.request.urlopen(address + "/_stcore/health", timeout=10).status
json.dump({{"arguments": sys.argv[1:], "address": address, "health": health}}, open({seen!r}, "w"))
"""


@pytest.fixture
def opened(tmp_path: Path) -> dict:
    """What a browser was started with by `softcal ui --window`; it looks at the address and is closed at once."""
    browser, requests = tmp_path / "chromium", tmp_path / "seen.json"
    browser.write_text(BROWSER.format(python=sys.executable, seen=str(requests)))
    browser.chmod(0o755)
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    command = [SOFTCAL, "ui", "--window", "--kiosk", "--registry", f"sqlite:///{tmp_path / 'r.db'}"]
    process = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert process.returncode == 0, process.stderr
    return json.loads(requests.read_text())


def test_the_window_shows_a_living_screen_and_closing_it_ends_its_server(opened: dict) -> None:
    assert opened["health"] == 200
    assert "--kiosk" in opened["arguments"]
    assert any(a.startswith("--user-data-dir=") for a in opened["arguments"])
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(f"{opened['address']}/_stcore/health", timeout=2)
