"""The one list of export formats, light enough for a parser to import."""

FORMATS = ("json", "c", "blob", "hex", "onnx", "pdf", "dcc")

DEVICE_FORMATS = ("blob", "c", "hex")
"""Those that firmware reads."""

SIGNED_APART = ("certificate-",)
"""Files that travel without their folder: each gets a signature of its own."""

APART = ".sig"
"""Ending of such a signature: 64 bytes, Ed25519."""

AUDIT = "audit.json"
"""Where the registry's audit trail stood at the export: beside the manifest, which must repeat byte by byte."""
