"""Core stands alone: without the other packages beside it, it imports whole, says the same, and reads no file."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

from softcal.core.messages import reason
from softcal.core.messages.gap_sentences import GAP_SENTENCES
from softcal.core.messages.reason import PLAIN
from softcal.core.messages.rig_sentences import SENTENCES
from softcal.core.messages.sentences import UNIT_SENTENCES

CORE = Path(reason.__file__).parents[1]
IMPORT_ALL = """
import importlib, json, os, pkgutil, sys

read = []
def watch(event, arguments):
    if event == "open" and isinstance(arguments[0], str):
        path = os.path.abspath(arguments[0])
        is_code = path.endswith(".py") or "__pycache__" in path or "site-packages" in path
        if path.startswith((FOLDER, ROOT)) and not is_code:
            read.append(path)
sys.addaudithook(watch)
# An installed softcal is not beside it either.
sys.meta_path = [finder for finder in sys.meta_path if "__editable__" not in str(finder)]
sys.path = [FOLDER, *(folder for folder in sys.path if "__editable__" not in folder and ROOT != folder)]
import softcal.core
for module in pkgutil.walk_packages(softcal.core.__path__, "softcal.core."):
    importlib.import_module(module.name)
from softcal.core.messages.reason import ENGLISH
files = [module.__file__ for name, module in sys.modules.items() if name.startswith("softcal.") and module.__file__]
print(json.dumps({"codes": sorted(ENGLISH), "files": files, "read": read}))
"""


def test_core_alone_imports_whole_says_all_it_says_and_reads_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "alone"
    shutil.copytree(CORE, folder / "softcal" / "core", ignore=shutil.ignore_patterns("__pycache__"))
    program = f"FOLDER, ROOT = {str(folder)!r}, {str(CORE.parent)!r}\n{IMPORT_ALL}"
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=folder)
    assert process.returncode == 0, process.stderr[-2000:]
    content = json.loads(process.stdout.splitlines()[-1])
    assert len(content["files"]) > 150 and all(file.startswith(str(folder)) for file in content["files"])
    assert content["read"] == []
    assert set(content["codes"]) == {PLAIN, *UNIT_SENTENCES, *GAP_SENTENCES, *SENTENCES}
