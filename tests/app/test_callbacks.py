"""What a person pressed happens, whatever else the browser asks for at the same moment."""

import ast
from pathlib import Path

import pytest
from streamlit.testing.v1 import AppTest

UI = Path(__file__).parents[2] / "app" / "ui"


def page_with_a_button(is_whole: bool) -> None:
    import streamlit as st
    from streamlit.runtime.scriptrunner import RerunData, get_script_run_ctx

    from softcal.app.ui.callbacks import run_uninterrupted

    def press() -> None:
        # The browser asks for the whole page while the callback runs, as it does when a page has been drawn.
        get_script_run_ctx().script_requests.request_rerun(RerunData())
        st.session_state["begun"] = True
        st.session_state["done"] = st.session_state["begun"]

    st.button("press", on_click=run_uninterrupted(press) if is_whole else press)
    st.text(f"done: {st.session_state.get('done', False)}")


@pytest.mark.parametrize("is_whole", [True, False])
def test_a_callback_runs_to_its_end_when_the_page_is_asked_for_meanwhile(is_whole: bool) -> None:
    screen = AppTest.from_function(page_with_a_button, args=(is_whole,)).run()
    screen.button[0].click().run()
    # The second case says that Streamlit still breaks callbacks off: without it nothing here would be needed.
    assert screen.text[0].value == f"done: {is_whole}"


def test_an_error_in_a_callback_is_the_pages_error() -> None:
    def page() -> None:
        import streamlit as st

        from softcal.app.ui.callbacks import run_uninterrupted

        def press() -> None:
            raise ValueError("no such unit")

        st.button("press", on_click=run_uninterrupted(press))

    screen = AppTest.from_function(page).run()
    screen.button[0].click().run()
    assert [error.value for error in screen.exception] == ["no such unit"]


def callbacks(path: Path) -> list[tuple[int, str, bool]]:
    """Each callback that a screen is given: line, text, and whether it runs in one piece."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    whole = {
        node.name
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and "run_uninterrupted" in map(ast.unparse, node.decorator_list)
    }
    whole |= {
        ast.unparse(node.targets[0])
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("run_uninterrupted(")
    }
    handlers = [
        (node.lineno, keyword.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        for keyword in node.keywords
        if keyword.arg and keyword.arg.startswith("on_") and _is_widget(node)
    ]
    return [
        (line, ast.unparse(value), _is_whole(value, whole))
        for line, value in handlers
        if not isinstance(value, ast.Constant)
    ]


def _is_widget(call: ast.Call) -> bool:
    name = ast.unparse(call.func)
    return name.startswith("st.") or name in ("draw", "partial")


def _is_whole(value: ast.expr, whole: set[str]) -> bool:
    # st.login is Streamlit's own: it sends the browser away and does nothing else.
    return ast.unparse(value) in whole | {"st.login"} or ast.unparse(value).startswith("run_uninterrupted(")


@pytest.mark.long
def test_every_callback_of_a_screen_runs_run_uninterrupted() -> None:
    found = {(path.name, *callback) for path in UI.rglob("*.py") for callback in callbacks(path)}
    assert len(found) >= 6
    assert not [callback for callback in found if not callback[-1]]
