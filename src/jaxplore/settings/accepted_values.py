"""The accepted values of a setting in words, from pydantic's constraints."""

import functools
from typing import Any

from pydantic import BaseModel

from jaxplore._limits import LARGEST

_PLAIN = {
    "null": "null",
    "boolean": "true or false",
    "string": "text",
    "integer": "whole number",
    "number": "number",
}
"""Words for the types of a JSON schema that have no parts."""


def describe_accepted(section: type[BaseModel], name: str) -> str:
    """Return the accepted values of a setting in words, such as `number in (0, 1]`."""
    return _words(_schema(section)[name])


def choices(section: type[BaseModel], name: str) -> tuple[str, ...]:
    """Return the words that a setting accepts; none if it accepts something else."""
    return tuple(_schema(section)[name].get("enum", ()))


@functools.cache
def _schema(section: type[BaseModel]) -> dict[str, dict[str, Any]]:
    properties: dict[str, dict[str, Any]] = section.model_json_schema()["properties"]
    return properties


def _words(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(map(_words, schema["anyOf"])))
    if "enum" in schema:
        own = f", or {schema['code']} of your own" if "code" in schema else ""
        return "one of " + ", ".join(schema["enum"]) + own
    kind = schema.get("type")
    if kind == "array" and "prefixItems" in schema:
        return f"[{', '.join(map(_words, schema['prefixItems']))}]"
    if kind == "array":
        return f"list of {_words(schema['items'])}"
    if kind == "object":
        inner = schema["additionalProperties"]
        return f"mapping of names to {_words(inner)}" if isinstance(inner, dict) else "mapping"
    # A section stands in the schema as a reference, without a type.
    return "section" if kind is None else _PLAIN[kind] + _bounds(schema)


def _bounds(schema: dict[str, Any]) -> str:
    least, above = _show_bound(schema, "minimum"), _show_bound(schema, "exclusiveMinimum")
    most, below = _show_bound(schema, "maximum"), _show_bound(schema, "exclusiveMaximum")
    if (least is None and above is None) or (most is None and below is None):
        signs = {">=": least, ">": above, "<=": most, "<": below}
        return "".join(f" {sign} {bound}" for sign, bound in signs.items() if bound is not None)
    begins = f"({above}" if least is None else f"[{least}"
    ends = f"{below})" if most is None else f"{most}]"
    return f" in {begins}, {ends}"


def _show_bound(schema: dict[str, Any], name: str) -> object:
    bound = schema.get(name)
    # Every number has this bound, which the page of settings says once.
    if bound is None or abs(bound) == LARGEST:
        return None
    # Whole metres and seconds without `.0` or an exponent.
    return int(bound) if abs(bound) > 1 and bound == int(bound) else bound
