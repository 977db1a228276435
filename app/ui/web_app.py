"""The application as `streamlit run` serves it: the pages behind the guard."""

from pathlib import Path

import streamlit as st
from starlette.middleware import Middleware

from softcal.app.ui.guard import Guard

app = st.App(Path(__file__).with_name("main.py"), middleware=[Middleware(Guard)])
