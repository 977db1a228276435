"""The page of figures of a diagnosis; it needs plotly, which a diagnosis does not."""

from functools import partial
from pathlib import Path
from typing import Any

from softcal.app.charts.gap_page import gap_page
from softcal.app.files.atomic import write_text
from softcal.app.gap.diagnose import run_views
from softcal.app.texts.catalogue import text
from softcal.core.gap.diagnosis import Diagnosis


def write_page(path: Path, diagnosis: Diagnosis[Any]) -> None:
    """Write the page of figures of a diagnosis in English, whole or not at all."""
    page = gap_page(diagnosis.report(), run_views(diagnosis), diagnosis.case.serial, partial(text, "en"))
    write_text(path, page)
