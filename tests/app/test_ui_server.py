"""The process that serves the screens."""

import socket

import pytest
from streamlit.web.server.starlette import starlette_server

from softcal.app.ui.server import send_at_once


@pytest.mark.parametrize("address", ["127.0.0.1", "::"])
def test_a_message_to_a_browser_does_not_wait_for_the_answer_to_the_one_before(address, monkeypatch):
    monkeypatch.setattr(starlette_server, "_bind_socket", starlette_server._bind_socket)
    send_at_once()
    # The way Streamlit takes to its socket, not the function that was changed.
    listening, _ = starlette_server._bind_server_socket("127.0.0.1", address, 0, 1)
    listening.setblocking(True)
    with listening, socket.create_connection(("127.0.0.1", listening.getsockname()[1])):
        accepted, _ = listening.accept()
        with accepted:
            assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
