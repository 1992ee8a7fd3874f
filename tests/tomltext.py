"""TOML text of plain data, for files that tests write."""

import json
from datetime import datetime


def toml(data):
    """A line for each key; tables and lists of tables stand inline, which means the same."""
    return "".join(f"{json.dumps(key)} = {value(item)}\n" for key, item in data.items())


def value(item):
    """A value of TOML; what TOML has no word for, None, is an empty text."""
    if isinstance(item, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {value(inner)}" for key, inner in item.items()) + "}"
    if isinstance(item, list):
        return "[" + ", ".join(map(value, item)) + "]"
    if isinstance(item, datetime):
        return item.isoformat()
    if isinstance(item, float):
        return repr(item)
    return '""' if item is None else json.dumps(item).replace("\x7f", "\\u007f")
