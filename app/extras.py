"""Which extra brings a library that only some tasks need."""

from importlib.util import find_spec

EXTRA_OF = {
    "torch": "train",
    "numba": "twin",
    "plotly": "documents",
    "starlette": "ui",
    "streamlit": "ui",
    "serial": "station",
    "pyvisa": "visa",
    "pyvisa_py": "visa",
    "bleak": "ble",
    "labjack": "labjack",
    "onnx": "documents",
    "reportlab": "documents",
    "pikepdf": "documents",
    "PIL": "documents",
    "psycopg": "postgresql",
    "distributed": "cluster",
    "dask": "cluster",
    "sklearn": "sklearn",
    "asyncua": "connect",
    "fastapi": "connect",
    "httpx2": "connect",
    "paho": "connect",
    "uvicorn": "connect",
}
"""Extra by the name of the module that is imported."""


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
