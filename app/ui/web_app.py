"""The application as `streamlit run` serves it: the pages, the guard, the stop key's way."""

from pathlib import Path

import streamlit as st
from starlette.middleware import Middleware
from starlette.routing import Route

from softcal.app.ui import secret_cookies, stop_key
from softcal.app.ui.guard import Guard

app = st.App(
    Path(__file__).with_name("main.py"),
    routes=[
        Route(stop_key.PATH, stop_key.stop, methods=["POST"]),
        Route(secret_cookies.PATH, secret_cookies.set_cookies, methods=["POST"]),
    ],
    middleware=[Middleware(Guard)],
)
