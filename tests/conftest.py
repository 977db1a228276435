"""The layers of the proof, and shared fixtures: a seeded generator, measured data, parts that may be missing."""

import os

# Two workers fill two cores: threads inside of them wait for one another, and a small matrix costs four times the CPU.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Some images keep no compiled files: both workers and every command that a test starts would compile softcal anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import gc
import random
import re
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from argon2 import PasswordHasher
from hypothesis import HealthCheck, Phase, settings
from hypothesis.stateful import RuleBasedStateMachine, run_state_machine_as_test
from scipy.signal import lfilter

from softcal.core.errors import SoftcalError
from softcal.db.access import people
from tests.system_packages import PACKAGES

sys.dont_write_bytecode = False

# What is drawn is the same on every run: fresh draws belong to benchmarks.
settings.register_profile("fixed", derandomize=True, database=None, deadline=None)
settings.load_profile("fixed")

SMALL_NETWORK = ("--hidden", "16,8")
"""Options of a network that trains in seconds."""

DEAREST = 20
"""Tests of which the end of a run says what CPU they took."""

_BEGAN: dict[str, float] = {}

_NUMBERS = count()

_MAIN_MODULE = sys.modules["__main__"]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--shuffle SEED`."""
    parser.addoption("--shuffle", type=int, metavar="SEED", help="run the tests of each file in a random order")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Files with long tests come first: begun last, one of them would keep a single core busy for minutes."""
    if (seed := config.getoption("--shuffle")) is not None:
        random.Random(seed).shuffle(items)
        # Files stay together, or what a file sets up would be made anew for every test.
        items.sort(key=lambda item: str(item.path))
    long = {item.path for item in items if item.get_closest_marker("long")}
    items.sort(key=lambda item: item.path not in long)


def pytest_configure() -> None:
    """What collecting brings into memory stays there: to look through it for garbage costs a tenth of all time."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Look from here on through what the tests make, and through that seldom."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)
    gc.enable()


def _cpu_s() -> float:
    """Seconds of CPU so far, of this process and of those that it started and that have ended."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def pytest_runtest_logstart(nodeid: str) -> None:
    """Note what CPU was taken before a test."""
    _BEGAN[nodeid] = _cpu_s()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Note the CPU of a test; turn every skip into a failure in CI: nothing passes there by a part that is missing."""
    report = yield
    if call.when == "teardown":
        # A property of the report: it travels from a worker to the process that prints.
        report.user_properties.append(("cpu_s", _cpu_s() - _BEGAN.pop(item.nodeid)))
    if report.skipped and os.environ.get("CI"):
        report.outcome = "failed"
        report.longrepr = f"{item.nodeid} was skipped: {report.longrepr[2]}; in CI a missing part is a failure"
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Write the dearest tests, and one line that counts what was not proven, by the Debian package or the reason."""
    reports = [report for stored in terminalreporter.stats.values() for report in stored]
    cpu_times = {r.nodeid: dict(r.user_properties)["cpu_s"] for r in reports if getattr(r, "when", "") == "teardown"}
    if len(cpu_times) > DEAREST:
        terminalreporter.section(f"CPU: {sum(cpu_times.values()):.0f} s of {len(cpu_times)} tests, the dearest first")
        for nodeid in sorted(cpu_times, key=lambda one: -cpu_times[one])[:DEAREST]:
            terminalreporter.write_line(f"{cpu_times[nodeid]:7.1f} s  {nodeid}")
    reasons = [report.longrepr[2].removeprefix("Skipped: ") for report in terminalreporter.stats.get("skipped", [])]
    packages, others = Counter[str](), Counter[str]()
    for reason in reasons:
        match = re.search(r"apt-get install (.*)", reason)
        packages.update(match[1].split() if match else [])
        others.update([] if match else [reason])
    lacks = [f"Debian's {name} ({count})" for name, count in sorted(packages.items())]
    lacks += [f"{reason} ({count})" for reason, count in sorted(others.items())]
    if lacks:
        terminalreporter.write_line(f"NOT PROVEN HERE: skipped {len(reasons)}, for want of {', '.join(lacks)}")


@pytest.fixture(autouse=True)
def main_module() -> None:
    """Streamlit's page tests leave their page as `__main__`; a process spawned later would run it as its own."""
    sys.modules["__main__"] = _MAIN_MODULE


@pytest.fixture(scope="session", autouse=True)
def data_of_the_session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What fixtures of a whole file write down stays out of the data of the person who runs them, too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(tmp_path_factory.mktemp("data")))
        patch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.mktemp("config")))
        yield


def _fresh_folder(tmp_path_factory: pytest.TempPathFactory, name: str) -> Path:
    """Make a folder for one test; pytest looks at all that are there for the next number, thousands for each test."""
    folder = tmp_path_factory.getbasetemp() / f"{re.sub(r'[^A-Za-z0-9_]', '_', name)[:30]}-{next(_NUMBERS)}"
    folder.mkdir(mode=0o700)
    return folder


@pytest.fixture
def tmp_path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _fresh_folder(tmp_path_factory, request.node.name)


@pytest.fixture(autouse=True)
def isolated_folders(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """No test writes into the logs or data of the person who runs it, or finds there what another test left.

    Copies of one registry have one identity: what a test writes down about one copy would speak against the next.
    """
    monkeypatch.setenv("SOFTCAL_LOGS", str(tmp_path_factory.getbasetemp() / "logs"))
    monkeypatch.setenv("XDG_DATA_HOME", str(_fresh_folder(tmp_path_factory, "data")))


@pytest.fixture(scope="session", autouse=True)
def real_hasher() -> Iterator[Callable[[], PasswordHasher]]:
    """The hasher of PINs as softcal has it; the tests sign in a thousand times and use one that is not slow on purpose.

    What is stored names its own cost, so that a process started by a test checks such a PIN like any other.
    """
    hasher, quick = people._hasher, PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(people, "_hasher", lambda: quick)
        yield hasher


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20201900178)


@pytest.fixture(scope="session")
def assert_finds_fault() -> Callable[[type[RuleBasedStateMachine]], None]:
    """`assert_finds_fault(machine)`: some sequence of its steps fails on what was broken on purpose."""
    quick = settings(
        max_examples=40, stateful_step_count=12, deadline=None, database=None, derandomize=True,
        phases=[Phase.generate], suppress_health_check=list(HealthCheck),
    )  # fmt: skip

    def runs(machine: type[RuleBasedStateMachine]) -> None:
        with pytest.raises((AssertionError, SoftcalError, KeyError)):
            run_state_machine_as_test(machine, settings=quick)

    return runs


NAMES = re.compile(r"`[^`]*`|b?'[^']*'|\S*[/._=]\S*|\bsoftcal\b|\b(min|ppm|rad|kgf|lbf)\b")
"""What stays in every language: commands, quotes of a device, ports, keys of a file, units."""


@pytest.fixture(scope="session")
def english_in() -> Callable[[str], list[str]]:
    """`english_in(text)`: its English words, without names, codes and units."""
    return lambda text: re.findall(r"\b[a-z]{3,}\b", NAMES.sub(" ", text))


@pytest.fixture(scope="session")
def require() -> Callable[[object, str], None]:
    """`require(condition, reason)`: go on only where an optional part (PostgreSQL, a header, a library) is there."""

    def check(condition: object, reason: str) -> None:
        if not condition:
            pytest.skip(reason)

    return check


@pytest.fixture(scope="session")
def require_program(require: Callable[[object, str], None]) -> Callable[..., str]:
    """`require_program("gcc")`: the path of a program of `PACKAGES`; where it or others are missing, skip the test."""

    def find(program: str, *others: str) -> str:
        # Debian installs daemons where only root looks.
        paths = {name: shutil.which(name) or shutil.which(name, path="/usr/sbin") for name in (program, *others)}
        lacking = [name for name, path in paths.items() if path is None]
        packages = " ".join(PACKAGES[name] for name in lacking)
        require(not lacking, f"{', '.join(lacking)} missing; apt-get install {packages}")
        return str(paths[program])

    return find


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """The folder of measured recordings: $SOFTCAL_DATA, else ../shared/data beside the checkout."""
    root = Path(__file__).parents[1]
    folder = Path(os.environ.get("SOFTCAL_DATA", root.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no measured data in {folder}; set SOFTCAL_DATA")
    return folder


def press_recording(samples: int, gain: float, offset_V: float, seed: int, rate_Hz: float = 50.0) -> pd.DataFrame:
    """A synthetic unit pressed at random: `t_s, output, reference`, lagging and bending like a soft sensor."""
    rng = np.random.default_rng(seed)
    force_N = np.zeros(samples)
    target, speed = 0.0, 0.1
    for k in range(1, samples):
        if abs(force_N[k - 1] - target) <= speed:
            target, speed = (0.0 if target else rng.uniform(0.5, 3.0)), rng.uniform(0.02, 0.2)
        force_N[k] = force_N[k - 1] + min(max(target - force_N[k - 1], -speed), speed)
    lagged_N = lfilter([0.3], [1, -0.7], force_N)
    output_V = offset_V + gain * (0.1 * lagged_N + 0.02 * lagged_N**2) + rng.normal(0, 0.0008, samples)
    return pd.DataFrame({"t_s": np.arange(samples) / rate_Hz, "output": output_V, "reference": force_N})


@pytest.fixture(scope="session")
def trained_lot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small lot (`lot/`) and a registry (`registry.db`) in which its network is trained already."""
    from softcal.app.cli.main import main

    root = tmp_path_factory.mktemp("small")
    folder = root / "lot"
    for name in ("source", "units", "audit"):
        (folder / name).mkdir(parents=True)
    (folder / "lot.toml").write_text(
        'sample_rate_Hz = 50.0\nsource = "A0"\n[lot]\nid = "small"\nsimulated = true\n'
        '[reference]\nunit = "N"\n[output]\nunit = "V"\n[limit]\nrmse = 0.16\n'
    )
    press_recording(1500, 1.0, 0.5, 1).to_csv(folder / "source/A0.csv", index=False)
    for k in (1, 2, 3):
        gain, offset_V = 1 + 0.15 * k, 0.5 + 0.04 * k
        unit = press_recording(1500, gain, offset_V, 10 + k)
        unit[["t_s", "output"]].to_csv(folder / f"units/A{k}.csv", index=False)
        press_recording(600, gain, offset_V, 50 + k).to_csv(folder / f"audit/A{k}.csv", index=False)
    assert main(["train", str(folder), "--registry", f"sqlite:///{root / 'registry.db'}", *SMALL_NETWORK]) == 0
    return root


@pytest.fixture
def lot_folder(trained_lot: Path, tmp_path: Path) -> Path:
    """A copy of the small lot of one source and three good units, audits for each."""
    return Path(shutil.copytree(trained_lot / "lot", tmp_path / "lot"))


@pytest.fixture
def registry_url(trained_lot: Path, tmp_path: Path) -> str:
    """An SQLite registry of its own in which the small lot's network is trained already."""
    shutil.copy(trained_lot / "registry.db", tmp_path / "registry.db")
    return f"sqlite:///{tmp_path / 'registry.db'}"


@pytest.fixture(scope="session")
def press_unit() -> Callable[[int, float, float, int], pd.DataFrame]:
    """`press_unit(samples, gain, offset_V, seed)`: a synthetic unit pressed at random: `t_s, output, reference`."""
    return press_recording
