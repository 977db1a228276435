"""The profiles a station presses with, and whether they keep its bounds."""

import tempfile
from pathlib import Path

import numpy as np
import streamlit as st

from softcal.app.charts.station import profile_figure
from softcal.app.files.profile_file import profile_toml, read_profile
from softcal.app.ui.desk import colours, named, say
from softcal.app.ui.panels import numbers, rest_may_follow, show_figure
from softcal.app.views.station import bounds
from softcal.core.profiles import BUILT_IN
from softcal.station.devices.config import FixtureConfig, SafetyConfig

FILE = "file"

REACHED = {"depth": "reached", "speed": "speed"}
"""How a profile's reach is called: its depth counts from its beginning, the bound from the stage."""


def draw() -> None:
    name = st.selectbox(say("profiles.profile"), [*BUILT_IN, FILE], format_func=named("profile"))
    left, right = st.columns([1, 3])
    profile = None
    with left:
        if name != FILE:
            depth_mm = st.number_input(f"{say('profiles.depth')} [mm]", 0.1, 50.0, 3.5, 0.1)
            seed = int(st.number_input(say("networks.seed"), 0, 10**6, 0))
            profile = BUILT_IN[name](np.random.default_rng(seed), depth_mm)
        elif (file := st.file_uploader(say("profiles.file"), type=["toml"])) is not None:
            with tempfile.TemporaryDirectory(prefix="softcal-profile-") as folder:
                path = Path(folder) / "profile.toml"
                path.write_bytes(file.getvalue())
                profile = read_profile(path)
        # The bounds of a station live in its file, at its machine.
        st.caption(say("profiles.bounds_typed"))
        deepest_mm = st.number_input(f"{say('profiles.deepest')} [mm]", 0.1, 500.0, SafetyConfig().deepest_mm)
        speed_mm_s = st.number_input(f"{say('profiles.fastest')} [mm/s]", 0.01, 500.0, SafetyConfig().speed_mm_s)
        safety = SafetyConfig(deepest_mm=deepest_mm, speed_mm_s=speed_mm_s)
    if profile is None:
        return
    start_mm = FixtureConfig().approach_mm
    limits = bounds(profile, safety.deepest_mm, safety.speed_mm_s, start_mm)
    with right:
        numbers(
            (
                (say("column.duration"), f"{profile.duration_s:.0f} s", None),
                (say("profiles.presses"), str(profile.presses), None),
                *(
                    (say(f"profiles.{REACHED[bound.name]}"), f"{bound.value:.3g} {bound.unit}", None)
                    for bound in limits
                ),
            ),
            narrowest_px=185,
        )
        for bound in (bound for bound in limits if not bound.is_kept):
            limit = f"{bound.largest:g} {bound.unit}"
            st.error(say(f"profiles.{bound.name}.broken", limit=limit), icon=":material/block:")
        if all(bound.is_kept for bound in limits):
            st.caption(say("profiles.kept"))
        if not rest_may_follow():
            return
        figure = profile_figure(profile, start_mm, safety.deepest_mm, safety.speed_mm_s, colours(), say)
        show_figure(figure, "profile")
        file_name = f"{profile.name.replace(' ', '-').replace('/', '-')}.toml"
        st.download_button(say("profiles.save"), profile_toml(profile), file_name, on_click="ignore")
