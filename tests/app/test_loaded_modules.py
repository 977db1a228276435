"""Commands that only read load what they use and nothing else: a person waits for every library that is loaded."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from softcal.app.bootstrap import ONE_THREAD
from softcal.app.cli.main import COMMANDS, main
from softcal.app.extras import MODULES_OF
from softcal.db.connection import open_registry

HEAVY = {"scipy.linalg", "scipy.ndimage", "scipy.optimize", "scipy.sparse", "scipy.spatial", "scipy.special",
         "scipy.stats", "pandas", "pyarrow", "alembic", "torch", "numba", "ot", "structlog", "argon2",
         "psycopg", "openpyxl", "streamlit", "matplotlib", "reportlab", "onnx", "distributed",
         "sqlalchemy.dialects.postgresql"}  # fmt: skip
NUMBERS = {"numpy", "safetensors"}


@pytest.fixture(scope="module")
def calibrated(trained_lot: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Places of a registry with a calibrated lot, of an export folder and of a recording."""
    root = tmp_path_factory.mktemp("reading")
    url = f"sqlite:///{root / 'registry.db'}"
    (root / "registry.db").write_bytes((trained_lot / "registry.db").read_bytes())
    command = ["batch", str(trained_lot / "lot"), "--registry", url, "--hidden", "16,8", "--no-own"]
    assert main([*command, "--release", "conditional", "--out", str(root / "files")]) in (0, 1)
    with open_registry(url, create=False) as registry:
        assert registry.calibrations.get("A1").revision
    recording = trained_lot / "lot/units/A1.csv"
    return {"url": url, "files": str(root / "files"), "recording": str(recording), "out": str(root / "out.csv")}


def modules_of(code: str) -> set[str]:
    """Run code in a process of its own and return the names of all modules it loaded."""
    code += "\nimport json, sys\nprint(json.dumps(list(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(json.loads(answer.stdout.splitlines()[-1]))


def loaded(*arguments: str, codes: tuple[int, ...] = (0,)) -> set[str]:
    """Run a command and return the names of all modules it loaded."""
    return modules_of(f"from softcal.app.cli.main import main\nassert main({list(arguments)!r}) in {codes}")


@pytest.mark.parametrize(
    ("command", "without"),
    [
        ("registry list --registry {url}", HEAVY | NUMBERS),
        ("registry history --serial A1 --registry {url}", HEAVY),
        ("registry verify --quick --registry {url}", HEAVY),
        ("estimate --serial A1 {recording} --out {out} --registry {url}", HEAVY - {"pyarrow"}),
        ("export --check --out {files} --registry {url}", HEAVY | {"sqlalchemy"}),
    ],
    ids=lambda value: value.split(" --")[0] if isinstance(value, str) else "",
)
def test_a_command_that_reads_loads_only_what_it_uses(calibrated, command, without):
    modules = loaded(*(part.format(**calibrated) for part in command.split()))
    assert modules & without == set()


def modules_of_help(*arguments: str) -> set[str]:
    """Ask a command for its help or version and return the names of all modules it loaded."""
    call = f"with contextlib.suppress(SystemExit): main({list(arguments)!r})"
    return modules_of(f"import contextlib\nfrom softcal.app.cli.main import main\n{call}")


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_what_is_asked_of_softcal_itself_loads_no_command(option):
    modules = modules_of_help(option)
    assert not modules & (HEAVY | NUMBERS | {"sqlalchemy"})
    assert not {f"softcal.app.cli.{name}" for name in COMMANDS} & modules


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_a_command_loads_that_command_and_no_library(command):
    modules = modules_of_help(command.rstrip("_"), "--help")
    assert not modules & (HEAVY | NUMBERS | {"sqlalchemy"})
    assert {name for name in COMMANDS if f"softcal.app.cli.{name}" in modules} == {command}


def test_listing_loads_no_other_command_and_no_queue(calibrated):
    modules = loaded("registry", "list", "--registry", calibrated["url"])
    commands = {name for name in modules if name.startswith("softcal.app.cli.")}
    assert not {"softcal.app.cli.batch", "softcal.app.cli.gap", "softcal.app.cli.station"} & commands
    assert not {f"softcal.db.queues.{name}" for name in ("job_board", "order_queue", "outbox", "work_queue")} & modules


@pytest.mark.long
def test_a_batch_does_not_load_what_no_map_needs(calibrated, trained_lot):
    options = ("--registry", calibrated["url"], "--hidden", "16,8", "--no-own", "--refit")
    modules = loaded("batch", str(trained_lot / "lot"), *options, codes=(0, 1))
    assert not {"scipy.stats", "torch"} & modules


PARTS_OF_EXTRA = {
    "train": ("core.network.training_steps",),
    "ui": ("app.ui", "app.rest"),
    "documents": ("app.charts", "app.ui", "app.export.certificates", "app.paper", "app.api.figures", "app.gap.page",
                  "app.operation.course_page", "app.files.onnx_file"),
    "sklearn": ("app.api.estimators",),
    "connect": ("app.connect", "app.rest"),
}  # fmt: skip
"""The parts of softcal that an extra is for; every other module imports where its libraries are missing."""

WITHOUT = """
import importlib.machinery, pathlib

find = importlib.machinery.PathFinder.find_spec
importlib.machinery.PathFinder.find_spec = lambda name, *more: None if name in {libraries!r} else find(name, *more)
for file in sorted(p for part in ("app", "core", "db", "station") for p in pathlib.Path(part).rglob("*.py")):
    module = ".".join(file.with_suffix("").parts).removesuffix(".__init__")
    if module.startswith({parts!r}):
        continue
    try:
        importlib.import_module("softcal." + module)
    except ModuleNotFoundError:
        print(module)
"""


@pytest.mark.parametrize("extra", PARTS_OF_EXTRA)
def test_only_the_parts_an_extra_is_for_need_its_libraries(extra):
    code = WITHOUT.format(libraries=MODULES_OF[extra], parts=PARTS_OF_EXTRA[extra])
    root = Path(__file__).parents[2]
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert answer.stdout.split() == []


def test_what_calibrates_loads_no_search_tree_before_a_stage_asks_for_it():
    assert "scipy.spatial" not in modules_of("import softcal.app.calibration.unit_calibration")


def test_a_command_starts_no_threads_of_a_numerical_library():
    """On busy cores small matrices would take ten times as long."""
    code = "from softcal.app.cli.main import main; main(['completion', 'bash'])\nimport numpy, os"
    code += "\nnumpy.ones((200, 200)) @ numpy.ones((200, 200)); print(len(os.listdir('/proc/self/task')))"
    free = {name: value for name, value in os.environ.items() if name not in ONE_THREAD}
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=free)
    assert answer.stdout.splitlines()[-1] == "1"
