"""The Streamlit application: its frame, its pages and their components."""
