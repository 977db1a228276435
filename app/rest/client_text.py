"""A typed Python client of the REST interface, from its OpenAPI document, in one plain file."""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

Schema = Mapping[str, Any]

HEAD = '''"""Client of the REST interface of softcal {version}. Made by `softcal api client`."""

import json
import ssl
import urllib.error
import urllib.parse
import urllib.request
from typing import Any, Literal, NotRequired, TypedDict


class SoftcalProblem(Exception):
    """What the interface answered in place of a result: `status` as of HTTP, and one line that says why."""

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status = status

'''
CLIENT = '''
class Client:
    """Asks one server as one program.

    Args:
        address: of the server, such as https://softcal.plant:8600.
        token: as `softcal api token create` printed it.
        ca_file: authorities to trust, PEM; the system's without it.
        timeout_s: longest wait for an answer.
    """

    def __init__(self, address: str, token: str, ca_file: str | None = None, timeout_s: float = 30.0) -> None:
        if not address.startswith(("http://", "https://")):
            raise ValueError(f"the address is {address!r}; http:// or https:// was expected")
        self._address, self._token, self._timeout_s = address.rstrip("/"), token, timeout_s
        self._context = ssl.create_default_context(cafile=ca_file) if address.startswith("https:") else None

    def _ask(self, method: str, path: str, query: dict[str, Any], body: Any = None, **headers: str | None) -> bytes:
        said = {name: str(value).lower() if isinstance(value, bool) else value for name, value in query.items()}
        asked = urllib.parse.urlencode({k: v for k, v in said.items() if v is not None}, doseq=True)
        request = urllib.request.Request(f"{self._address}{path}{'?' if asked else ''}{asked}", method=method)
        request.add_header("Authorization", f"Bearer {self._token}")
        for name, value in headers.items():
            if value is not None:
                request.add_header(name.replace("_", "-"), value)
        if body is not None:
            request.add_header("Content-Type", "application/json")
            request.data = json.dumps(body).encode()
        try:
            with urllib.request.urlopen(request, timeout=self._timeout_s, context=self._context) as answer:
                return bytes(answer.read())
        except urllib.error.HTTPError as error:
            raise SoftcalProblem(error.code, _detail(error.read())) from None

'''
TAIL = """

def _detail(text: bytes) -> str:
    try:
        return str(json.loads(text)["detail"])
    except (ValueError, KeyError, TypeError):
        return text.decode(errors="replace")[:200]
"""
TYPES = {"string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None"}


def client_text(document: Schema) -> str:
    """Return the client as Python text: a type for each schema, a method for each path."""
    remaining, ordered = dict(document["components"]["schemas"]), dict[str, Schema]()
    # Each schema stands behind those it names.
    while remaining:
        references = {
            name: {*re.findall(r"#/components/schemas/(\w+)", json.dumps(one))} for name, one in remaining.items()
        }
        ready = [name for name, needs in references.items() if not (needs & remaining.keys()) - {name}]
        ordered |= {name: remaining.pop(name) for name in ready}
    types: list[str] = []
    for name, schema in ordered.items():
        if "enum" in schema:
            types.append(f"\n{name} = {_type(schema)}\n")
            continue
        types += [f"\nclass {name}(TypedDict):", f'    """{_sentence(schema.get("description", name))}"""\n']
        for key, value in schema["properties"].items():
            type_text = _type(value)
            types.append(
                f"    {key}: {type_text if key in schema.get('required', []) else f'NotRequired[{type_text}]'}"
            )
        types.append("")
    methods = [
        line
        for path, operations in document["paths"].items()
        for method, operation in operations.items()
        for line in _method(method.upper(), path, operation)
    ]
    head = HEAD.replace("{version}", document["info"]["version"])
    return head + "\n".join(types) + "\n" + CLIENT + "\n".join(methods).rstrip() + "\n" + TAIL


def _type(schema: Schema) -> str:
    if "$ref" in schema:
        return str(schema["$ref"].rpartition("/")[2])
    if "anyOf" in schema:
        return " | ".join(_type(one) for one in schema["anyOf"])
    if "const" in schema or "enum" in schema:
        return f"Literal[{', '.join(repr(one) for one in schema.get('enum', [schema.get('const')]))}]"
    match schema.get("type"):
        case "array":
            return f"list[{_type(schema.get('items', {}))}]"
        case "object":
            inner = schema.get("additionalProperties")
            return f"dict[str, {_type(inner) if isinstance(inner, Mapping) else 'Any'}]"
        case kind:
            return TYPES.get(str(kind), "Any")


def _method(method: str, path: str, operation: Schema) -> Iterator[str]:
    """Yield the lines of one method: words of the path, the body, all else by its name."""
    parameters = operation.get("parameters", [])
    path_names = [one["name"] for one in parameters if one["in"] == "path"]
    options = [one for one in parameters if one["in"] != "path" and one["name"] != "If-None-Match"]
    body = operation.get("requestBody", {}).get("content", {}).get("application/json")
    answer = next(response for code, response in operation["responses"].items() if code.startswith("2"))
    kind, content = next(iter(answer["content"].items()))
    return_type = _type(content["schema"]) if kind == "application/json" else "bytes"
    signature = [
        "self",
        *(f"{path_name}: str" for path_name in path_names),
        *([f"body: {_type(body['schema'])}"] if body else []),
    ]
    signature += ["*"] if options else []
    signature += [f"{_name(one)}: {_type(one['schema']).removesuffix(' | None')} | None = None" for one in options]
    yield f"    def {operation['operationId'].partition('_v1_')[0]}({', '.join(signature)}) -> {return_type}:"
    yield f'        """{_sentence(operation.get("description", operation["summary"]))}"""'
    for path_name in path_names:
        yield f'        {path_name} = urllib.parse.quote({path_name}, safe="")'
    query = ", ".join(f'"{one["name"]}": {_name(one)}' for one in options if one["in"] == "query")
    headers = "".join(f", {_name(one)}={_name(one)}" for one in options if one["in"] == "header")
    body_argument = ", body" if body else ""
    call = f'self._ask("{method}", f"{path}", {{{query}}}{body_argument}{headers})'
    if return_type == "bytes":
        yield f"        return {call}\n"
    else:
        yield f"        answer: {return_type} = json.loads({call})"
        yield "        return answer\n"


def _name(parameter: Schema) -> str:
    return str(parameter["name"].replace("-", "_").lower())


def _sentence(text: str) -> str:
    """Return the first paragraph of a description on one line."""
    return " ".join(text.split("\n\n")[0].split()).replace("\\", "\\\\").replace('"""', "'''")
