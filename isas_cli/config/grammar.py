"""Values as Hydra's grammar of overrides takes them."""

from __future__ import annotations

import json
import re


def override(value) -> str:
    """A setting's value; plain words as they are."""
    if isinstance(value, str) and re.fullmatch(r"[\w.+/-]+", value):
        return value
    return literal(value)


def literal(value) -> str:
    """A JSON value."""
    if isinstance(value, dict):
        return "{" + ",".join(f"{_key(k)}:{literal(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ",".join(literal(v) for v in value) + "]"
    if isinstance(value, str):
        # A backslash escapes only before a quote and at the end.
        escaped = re.sub(r"(\\*)('|$)", lambda m: 2 * m[1] + ("\\'" if m[2] else ""), value)
        return f"'{escaped}'"
    return json.dumps(value)


def _key(key: str) -> str:
    return re.sub(r"([\\()\[\]{}:=, \t])", r"\\\1", key)
