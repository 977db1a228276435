"""Which extra brings a library that only some tasks need."""

EXTRA_OF = {
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
    return f"this needs {module}, which is not installed; install it: pip install 'softcal[{EXTRA_OF[module]}]'"
