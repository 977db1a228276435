"""The numbers a screen shows, read from the registry and rounded; no Streamlit, no Plotly."""
