"""The calibration files of one unit as one archive, made when a program asks for them."""

import io
import zipfile

from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.certificates.laboratory import kept_laboratory
from softcal.app.export.formats import writer_of
from softcal.core.unit.verdict import Release
from softcal.db.registry import Registry


def unit_archive(
    registry: Registry, lot_id: str, serial: str, file_format: str, with_conditional: bool, actor: str
) -> bytes:
    """Return the files of a format as a ZIP archive; who took them lands in the audit trail.

    Args:
        with_conditional: whether conditional units have their files, too.

    Raises:
        InputError: no such format, or no calibration.
        UnitRefused: the newest verdict of the unit, or its map, allows no such file.
    """
    release = Release.CONDITIONAL if with_conditional else Release.PASS
    options = ExportOptions(release=release, lot_id=lot_id, laboratory=kept_laboratory())
    contents = writer_of(file_format)(UnitLoader(registry, options).load(serial))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    registry.trail.add("export", "units", (serial,), {"lot_id": lot_id, "formats": [file_format]}, actor=actor)
    return packed.getvalue()
