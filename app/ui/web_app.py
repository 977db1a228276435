"""The application as `streamlit run` serves it: the pages, the guard, the stop key's way."""

from pathlib import Path

import streamlit as st
from starlette.middleware import Middleware
from starlette.routing import Route

from softcal.app.ui.guard import Guard
from softcal.app.ui.stop_key import PATH, stop

app = st.App(
    Path(__file__).with_name("main.py"), routes=[Route(PATH, stop, methods=["POST"])], middleware=[Middleware(Guard)]
)
