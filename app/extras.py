"""Which extra brings a library that only some tasks need."""

from importlib.util import find_spec

MODULES_OF = {
    "train": ("torch",),
    "twin": ("numba",),
    "ui": ("starlette", "streamlit"),
    "station": ("serial",),
    "visa": ("pyvisa", "pyvisa_py"),
    "ble": ("bleak",),
    "labjack": ("labjack",),
    "documents": ("onnx", "pikepdf", "PIL", "plotly", "reportlab"),
    "formats": ("h5py", "nptdms", "python_calamine"),
    "postgresql": ("psycopg",),
    "cluster": ("dask", "distributed"),
    "sklearn": ("sklearn",),
    "fmu": ("fmpy",),
    "connect": ("asyncua", "fastapi", "h11", "httpx2", "paho", "uvicorn"),
}
"""Modules that are imported, by their extra."""
EXTRA_OF = {module: extra for extra, modules in MODULES_OF.items() for module in modules}


def missing_extra(error: ModuleNotFoundError) -> str | None:
    """Return the line that says what to install, None where the module belongs to no extra."""
    module = (error.name or "").partition(".")[0]
    if module not in EXTRA_OF:
        return None
    return f"this needs {module}, which is not installed; install it: {_install(module)}"


def lacking(module: str, task: str) -> str | None:
    """Return the line that says why a task is left out, None where its library is there."""
    return None if find_spec(module) else f"{task}: {module} is not installed; install it: {_install(module)}"


def _install(module: str) -> str:
    return f"pip install 'softcal[{EXTRA_OF[module]}]'"
