"""The folders app/, core/, db/ and station/ are imported as softcal.app, softcal.core, ... (docs/decisions/0001)."""

from setuptools import find_packages, setup

FOLDERS = ("app", "core", "db", "station")
patterns = [pattern for folder in FOLDERS for pattern in (folder, f"{folder}.*")]
found = find_packages(include=patterns, exclude=["app.public"])
setup(
    packages=["softcal", *(f"softcal.{package}" for package in found)],
    package_dir={"softcal": "app/public", **{f"softcal.{folder}": folder for folder in FOLDERS}},
)
