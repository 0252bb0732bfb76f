"""Values as Hydra's grammar of overrides takes them."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Sequence

# What Hydra reads as a word, unless it reads it as a number or what stands for none.
_WORD = re.compile(r"[\w.+/-]+", re.ASCII)
_NO_WORD = re.compile(r"[+-]?[\d_.]*(e[+-]?[\d_]*)?|[+-]?(inf|nan)|null|true|false", re.I)
_LISTED = 8  # values
# What no key of Hydra's grammar may hold, which takes none in quotes: written as its number.
_UNREAD = re.compile(r"[^\x20-\x7e\t]|[#&'!;<>~\"`^]|%(?=[0-9a-f]+%)")
_CODED = re.compile(r"%([0-9a-f]+)%")


def override(value) -> str:
    """A setting's value; plain words as they are."""
    if isinstance(value, str) and _WORD.fullmatch(value) and not _NO_WORD.fullmatch(value):
        return value
    return literal(value)


def plain(value):
    """Hydra's quoted strings and nested values as plain Python."""
    if isinstance(value, dict):
        return {str(plain(k)): plain(v) for k, v in value.items()}
    if isinstance(value, list):
        return [plain(v) for v in value]
    return getattr(value, "text", value)


def listed(setting: str, values: Sequence[str]) -> str:
    """``setting`` with a list of ``values``, as it is typed in a shell; of many, the first, and how
    many more there are."""
    word = f"{setting}=[{','.join(map(override, values[:_LISTED]))}]"
    # Within double quotes single ones stay as they are.
    twice = "'" in word and not set(word) & set('"$`\\!')
    more = len(values) - _LISTED
    typed = f'"{word}"' if twice else shlex.quote(word)
    return f"{typed} and {more} more" if more > 0 else typed


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
    coded = _UNREAD.sub(lambda found: f"%{ord(found[0]):x}%", key)
    return re.sub(r"([\\()\[\]{}:=, \t])", r"\\\1", coded)


def decoded(key: str) -> str:
    """The key of a dictionary that ``literal`` has written, as it was."""
    return _CODED.sub(lambda found: chr(int(found[1], 16)), key)
