"""The one list of export formats, light enough for a parser to import."""

from softcal.core.plugins import find_plugins

FORMATS = ("json", "c", "blob", "hex", "onnx", "pdf", "dcc")

GROUP = "softcal.exporters"
"""Entry points of formats that other packages bring along, each under the format's name."""


def formats() -> tuple[str, ...]:
    """Return every format: softcal's own, then those of plug-ins, without loading their code."""
    return (*FORMATS, *(point.name for point in find_plugins(GROUP) if point.name not in FORMATS))


DOCUMENT_FORMATS = frozenset({"pdf", "dcc"})
"""Those that no device reads."""

DEVICE_FORMATS = ("blob", "c", "hex")
"""Those that firmware reads."""

DETACHED_PREFIXES = ("certificate-",)
"""Files that travel without their folder: each gets a signature of its own."""

DETACHED_SUFFIX = ".sig"
"""Ending of such a signature: 64 bytes, Ed25519."""

AUDIT = "audit.json"
"""Where the audit trail stood at the export; the manifest must repeat byte by byte."""
