"""The seal of a challenge on disk: encrypted labels, their key in a file of its own, an examiner that answers."""

import json
import secrets
import socketserver
from collections.abc import Callable
from pathlib import Path
from socket import create_connection
from typing import Any

from cryptography.fernet import Fernet, InvalidToken

from softcal.app.files.atomic import write_text
from softcal.app.files.case_folder import read_json
from softcal.core.challenge.seal import Seal
from softcal.core.errors import InputError

SCHEMA = "softcal.sealed/1"
MAX_REPLY_BYTES = 64 * 2**20
TIMEOUT_s = 120.0


def default_key_path(seal_file: Path) -> Path:
    """Return where the key of a seal lies unless another place is named."""
    return seal_file.with_name(f"{seal_file.name.removesuffix('.json')}.key")


def write_sealed(seal_file: Path, key_file: Path, seal: Seal) -> None:
    """Write labels encrypted (Fernet: AES-128-CBC with HMAC-SHA-256), and their key, readable by its owner alone."""
    key = Fernet.generate_key()
    write_text(key_file, key.decode() + "\n")
    key_file.chmod(0o600)
    sealed = {
        "schema": SCHEMA,
        "commitment": seal.commitment,
        "labels": Fernet(key).encrypt(seal.text.encode()).decode(),
    }
    write_text(seal_file, json.dumps(sealed, indent=2) + "\n")


def read_sealed(seal_file: Path, key_file: Path) -> str:
    """Return the text of the labels.

    Raises:
        InputError: a file cannot be read, is no seal, or the key is another one.
    """
    sealed = read_json(seal_file)
    try:
        key = key_file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{key_file}: cannot be read: {error}") from error
    if sealed.get("schema") != SCHEMA:
        raise InputError(f"{seal_file}: is no seal of a challenge; schema {SCHEMA!r} was expected")
    try:
        return Fernet(key).decrypt(str(sealed.get("labels")).encode()).decode()
    except (InvalidToken, ValueError) as error:
        raise InputError(
            f"{key_file}: is not the key of {seal_file}, or the seal is broken; nothing was opened"
        ) from error


class Examiner(socketserver.ThreadingTCPServer):
    """A process that holds the key and records further runs of sealed rigs: one JSON line asked, one answered.

    Args:
        answer: returns the files of a run, by name, for a case and an experiment; raises `InputError`.
        port: 0 for any free one.
    """

    allow_reuse_address = True

    def __init__(self, answer: Callable[[str, str, int], dict[str, str]], port: int = 0) -> None:
        self.answer, self.token = answer, secrets.token_urlsafe(12)
        super().__init__(("127.0.0.1", port), _RequestHandler)

    @property
    def address(self) -> str:
        """What the examinee is told: host, port and word."""
        return f"127.0.0.1:{self.server_address[1]}:{self.token}"


class _RequestHandler(socketserver.StreamRequestHandler):
    server: Examiner

    def handle(self) -> None:
        self.connection.settimeout(TIMEOUT_s)
        try:
            request = json.loads(self.rfile.readline(4096))
            if request["token"] != self.server.token:
                raise InputError("the examiner does not know this word")
            reply: dict[str, object] = {
                "files": self.server.answer(str(request["case"]), str(request["experiment"]), int(request["number"]))
            }
        except InputError as error:
            reply = {"error": str(error)}
        except (KeyError, TypeError, ValueError) as error:
            reply = {"error": f"no request: {error!r}; case, experiment, number and token were expected"}
        self.wfile.write(json.dumps(reply).encode() + b"\n")


def ask_examiner(address: str, case: str, experiment: str, number: int) -> dict[str, str]:
    """Return the files of one more run, from the process of the examiner.

    Raises:
        InputError: nobody answers, or the examiner refuses.
    """
    host, port, token = (address.split(":") + ["", ""])[:3]
    request = {"case": case, "experiment": experiment, "number": number, "token": token}
    try:
        with create_connection((host, int(port)), timeout=TIMEOUT_s) as line, line.makefile("rb") as answers:
            line.sendall(json.dumps(request).encode() + b"\n")
            reply: dict[str, Any] = json.loads(answers.readline(MAX_REPLY_BYTES))
    except (OSError, ValueError) as error:
        raise InputError(f"--examiner {address}: no answer ({error}); host:port:word was expected") from error
    if "error" in reply:
        raise InputError(f"{case}: {reply['error']}")
    return {str(name): str(text) for name, text in reply["files"].items()}
