"""A stage profile as a TOML file that people write: a move a line, target, speed and hold."""

import math
from pathlib import Path

import tomlkit

from softcal.app.files.toml_file import read_toml
from softcal.core.errors import InputError
from softcal.core.profiles import Profile, moves

KEYS = ("name", "moves")


def read_profile(path: Path) -> Profile:
    """Return the profile of a file.

    Raises:
        InputError: it cannot be read, a key is unknown, or a move is not three numbers that make sense; its line among
            the moves is named.
    """
    content = read_toml(path, "write one with `softcal station profiles --write`")
    unknown = set(content) - set(KEYS)
    rows = content.get("moves")
    if unknown or not isinstance(rows, list) or not rows:
        problem = f"unknown key {min(unknown)!r}" if unknown else "no moves"
        raise InputError(f"{path}: {problem}; expected are name and moves = [[target mm, speed mm/s, hold s], ...]")
    for k, row in enumerate(rows, start=1):
        is_row = isinstance(row, list) and len(row) == 3 and all(isinstance(x, (int, float)) for x in row)
        if not is_row or not all(math.isfinite(x) for x in row):
            raise InputError(f"{path}: move {k} is {row!r}; [target mm, speed mm/s, hold s] was expected")
        if float(row[1]) <= 0 or float(row[2]) < 0:
            problem = "a speed above 0 mm/s and a hold of 0 s or more were expected"
            raise InputError(f"{path}: move {k} is {row!r}; {problem}")
    targets, speeds, holds = zip(*([float(x) for x in row] for row in rows), strict=True)
    return moves(str(content.get("name", path.stem)), targets, speeds, holds)


def profile_toml(profile: Profile) -> str:
    """Return the TOML text of a profile, from which it can be read back."""
    rows: list[list[float]] = []
    at_mm = 0.0
    for segment in profile.segments:
        if segment.target_mm == at_mm and rows:
            rows[-1][2] += segment.duration_s
        elif segment.target_mm == at_mm:
            rows.append([at_mm, 1.0, segment.duration_s])
        else:
            rows.append([segment.target_mm, abs(segment.target_mm - at_mm) / segment.duration_s, 0.0])
        at_mm = segment.target_mm
    document = tomlkit.document()
    document["name"] = profile.name
    document.add(tomlkit.nl())
    document.add(tomlkit.comment(f"target mm, speed mm/s, hold s; {profile.duration_s:.1f} s in all"))
    document["moves"] = tomlkit.item(rows).multiline(True)
    return tomlkit.dumps(document)
