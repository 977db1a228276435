"""A sign-in in a browser: its cookie is for the server alone, and what was dropped is gone with the server."""

import gc
import http.client
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page

from softcal.app.ui.uploads import UploadFolder

pytestmark = pytest.mark.long


@pytest.fixture
def screen(calibrated, add_everybody, serve: Callable, tmp_path, monkeypatch) -> Iterator:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    add_everybody(calibrated)
    with serve(calibrated) as one:
        yield one


def test_no_script_can_read_a_sign_in_and_it_outlives_a_reload(screen, page: Page, sign_in):
    sign_in(screen.address, "engineer")
    cookies = {cookie["name"].partition("_")[2].partition("_")[2]: cookie for cookie in page.context.cookies()}
    secret = [cookie for name, cookie in cookies.items() if name == "session" or name.startswith("machine_")]
    assert len(secret) == 2
    assert all(cookie["httpOnly"] and cookie["sameSite"] == "Strict" for cookie in secret)
    cookie_text = page.evaluate("document.cookie")
    assert not [cookie for cookie in secret if cookie["value"] in cookie_text or cookie["name"] in cookie_text]
    page.reload()
    page.get_by_role("heading", name="Erin").wait_for()
    page.get_by_role("button", name="Sign out").click()
    page.get_by_label("PIN").wait_for()
    page.wait_for_timeout(2000)
    assert not [cookie for cookie in page.context.cookies() if cookie["name"].endswith("session")]
    page.reload()
    page.get_by_label("PIN").wait_for()


def test_a_ticket_that_nobody_was_given_sets_nothing(screen):
    for headers, body, status in (
        ({"x-softcal-key": "1"}, "guessed", 404),
        ({}, "guessed", 403),
        ({"x-softcal-key": "1"}, "x" * 10_000, 413),
        ({"x-softcal-key": "1", "Origin": "http://127.0.0.1:1"}, "guessed", 403),
    ):
        connection = http.client.HTTPConnection("127.0.0.1", screen.port, timeout=30)
        connection.request("POST", "/browser-memory", body, headers)
        answer = connection.getresponse()
        assert (answer.status, answer.getheader("set-cookie")) == (status, None), (headers, body[:9])
        connection.close()


def test_dropped_recordings_lie_in_one_folder_that_goes_with_the_server(screen, page: Page, sign_in, tmp_path: Path):
    def files_left() -> list[Path]:
        return [path for path in tmp_path.rglob("*") if path.name == "U1.csv" or "upload-" in path.name]

    (tmp_path / "U1.csv").write_text("t_s,output\n" + "".join(f"{k / 50},{k % 7}\n" for k in range(500)))
    drop = {"name": "U1.csv", "mimeType": "text/csv", "buffer": (tmp_path / "U1.csv").read_bytes()}
    (tmp_path / "U1.csv").unlink()
    sign_in(screen.address, "engineer")
    for name in ("audit", "known_loads", "new_lot"):
        page.goto(f"{screen.address}/{name}")
        page.locator("[data-testid=stApp][data-test-script-state=notRunning]").wait_for()
    assert files_left() == []
    for is_killed in (False, True):
        page.goto(f"{screen.address}/new_lot")
        page.locator("input[type=file]").set_input_files([drop])
        page.get_by_text("U1.csv").first.wait_for()
        page.wait_for_timeout(3000)
        assert len(files_left()) == 1
        if is_killed:
            screen.kill()
        else:
            screen.end()
            assert files_left() == []
        screen.start()
        assert files_left() == []
        sign_in(screen.address, "engineer")


def test_a_dropped_recording_is_gone_with_its_tab(separate_data_folder):
    folder = UploadFolder()
    recording = folder.path / "U1.csv"
    recording.write_text("t_s,output\n")
    del folder
    gc.collect()
    assert not recording.parent.exists()
