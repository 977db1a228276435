"""The one list of export formats, light enough for a parser to import."""

FORMATS = ("json", "c", "blob", "hex", "onnx", "pdf", "dcc")

DEVICE_FORMATS = ("blob", "c", "hex")
"""Those that firmware reads."""
