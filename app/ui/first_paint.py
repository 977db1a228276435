"""What a person came for is drawn first: figures and tables follow when the browser has shown it.

The parts of the browser that draw them are megabytes of script. Sent at once they would be read before the numbers
above them are on the screen, so that a page was empty for seconds; a tab that has read them gets everything at once.
"""

import streamlit as st

HAS_DRAWN = "browser-has-drawn"
IS_AWAITED = "browser-is-awaited"
PLACE, PLACE_PX = "rest-of-page", 320


def rest_may_follow() -> bool:
    """Whether to draw the rest of a page now; else its place is kept, and the page is drawn again in a moment.

    Called by a page once its first useful content is drawn; on False the page returns.
    """
    if st.session_state.get(HAS_DRAWN):
        return True
    st.session_state[IS_AWAITED] = True
    with st.container(key=PLACE):
        st.skeleton(height=PLACE_PX)
    return False


def is_awaited() -> bool:
    """Whether a page of this run waits for the browser."""
    return bool(st.session_state.get(IS_AWAITED)) and not st.session_state.get(HAS_DRAWN)


def has_drawn() -> None:
    """Take the browser's word that the page so far is on the screen."""
    st.session_state[HAS_DRAWN] = True
