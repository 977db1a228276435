"""Errors of the REST interface as problem details of RFC 9457."""

from collections.abc import Mapping

from starlette.responses import JSONResponse
from starlette.types import Scope

from softcal.app.rest.v1 import ProblemAnswer

PROBLEM = "application/problem+json"
SIGN_IN = {"WWW-Authenticate": "Bearer"}
RETRY_AFTER_S = 5
"""After that time who was refused for now (429, 503) may ask again."""

TITLES = {
    400: "Bad request",
    401: "Not signed in",
    403: "Not allowed",
    404: "Not found",
    405: "Method not allowed",
    408: "Too slow",
    409: "Conflict",
    413: "Too long",
    422: "Invalid request",
    429: "Too many",
    431: "Head too long",
    500: "Defect",
    503: "Registry away",
}


def problem(status: int, detail: str, headers: Mapping[str, str] | None = None) -> JSONResponse:
    """Return an error as an answer; a transient error has a Retry-After header."""
    answer = ProblemAnswer(title=TITLES.get(status, "Error"), status=status, detail=detail)
    retry_header = {"Retry-After": str(RETRY_AFTER_S)} if status in (429, 503) else {}
    return JSONResponse(answer.model_dump(), status, {**retry_header, **(headers or {})}, PROBLEM)


class Headers:
    """Headers of a request by their name in small letters."""

    def __init__(self, scope: Scope) -> None:
        self._pairs = scope["headers"]

    def all(self, name: str) -> list[str]:
        """Return every value of a header."""
        return [value.decode("latin-1") for key, value in self._pairs if key == name.encode()]

    def size(self) -> int:
        """Return the bytes of all names and values."""
        return sum(len(key) + len(value) for key, value in self._pairs)

    def one(self, name: str) -> str:
        """Return the last value of a header; "" without."""
        return (self.all(name) or [""])[-1]
