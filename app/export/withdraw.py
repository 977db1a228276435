"""Take back the files of units that are no longer released: a later verdict that is worse wins."""

from collections.abc import Collection, Mapping
from pathlib import Path

from softcal.app.export.manifest import read_manifest, write_manifest


def withdraw_units(folder: Path, released: Collection[str], verdicts: Mapping[str, str]) -> list[str]:
    """Remove the files of units that are not released, and say so in the manifest; return their serials.

    Args:
        folder: an export folder; nothing happens where there is none yet.
        released: serials whose files stay.
        verdicts: today's word of every unit that may have files here.
    """
    manifest = read_manifest(folder)
    gone = [serial for serial in manifest.units if serial in verdicts and serial not in released]
    for serial in gone:
        names = [name for name, entry in manifest.files.items() if entry.serial == serial]
        for name in names:
            (folder / name).unlink(missing_ok=True)
        facts = {**manifest.units[serial], "verdict": verdicts[serial], "withdrawn": bool(names)}
        manifest = manifest.without_files(names).with_unit(serial, facts)
    if gone:
        # A signature of the folder as it was would vouch for files that are gone.
        write_manifest(folder, manifest, None)
    return gone
