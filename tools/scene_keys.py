"""Write the tables of docs/scene-files.md from the schema of scene files.

python -m tools.scene_keys
"""

from __future__ import annotations

import re
import types
import typing
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator
from pydantic.fields import FieldInfo

from pinimpact.app import scene_file
from pinimpact.app.units import UNITS

PAGE = Path(__file__).parents[1] / "docs" / "scene-files.md"
TABLES = {
    "file": (scene_file.SceneFile, "Keys of the file"),
    "robot": (scene_file.RobotTable, "`[[robot]]`"),
    "plane": (scene_file.PlaneTable, "`[plane.NAME]`"),
    "sphere": (scene_file.SphereTable, "`[sphere.NAME]`"),
    "box": (scene_file.BoxTable, "`[box.NAME]`"),
    "shape": (scene_file.ShapeTable, "`[shape.NAME]`"),
    "contact": (scene_file.ContactTable, "`[[contact]]`"),
    "start": (scene_file.StartTable, "`[start]`"),
    "control": (scene_file.ControlTable, "`[control]`"),
    "output": (scene_file.OutputTable, "`[output]`"),
}
HEADS = ("key", "value", "unit", "default", "meaning")
WORDS = {float: "number", int: "whole number", str: "text", bool: "true or false"}


def kind_of(annotated: Any) -> str | None:
    """Return the kind of quantity of an annotated type, such as "length"."""
    for item in (*getattr(annotated, "__metadata__", ()), *getattr(annotated, "metadata", ())):
        if isinstance(item, BeforeValidator) and isinstance(item.func, partial):
            return str(item.func.keywords["kind"])
    return None


def value_and_kind(annotation: Any) -> tuple[str, str | None]:
    """Return the type of a key in words, and its kind of quantity, if any."""
    if typing.get_origin(annotation) is Annotated:
        return value_and_kind(typing.get_args(annotation)[0])[0], kind_of(annotation)
    if annotation in WORDS:
        return WORDS[annotation], None
    origin, parts = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, types.UnionType):
        said = [value_and_kind(part) for part in parts if part is not type(None)]
        kind = next((kind for _, kind in said if kind), None)
        return " or ".join(words for words, _ in said), kind
    if origin is tuple:
        words, kind = value_and_kind(parts[0])
        return f"{len(parts)} {words}s", kind
    if origin is list:
        words, kind = value_and_kind(parts[0])
        return ("names" if parts[0] is str else f"list of {words}s"), kind
    if origin is dict:
        words, kind = value_and_kind(parts[1])
        return f"{words} per joint", kind
    raise TypeError(f"{annotation} has no words")


def default_of(field: FieldInfo) -> str:
    """Return a default in the notation of scene files."""
    if field.is_required():
        return "**required**"
    value = field.default
    if value is None or value in ({}, []):
        return ""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        return f"`[{', '.join(f'{number:g}' for number in value)}]`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value:g}`"


def table_of(model: type[BaseModel]) -> str:
    """Return the table of a model's keys; keys that are tables of the file are left out.

    The unit is that of the type, or the text in brackets at the end of the docstring of the key.
    """
    lines = ["| " + " | ".join(HEADS) + " |", "|" + " --- |" * len(HEADS)]
    for name, field in model.model_fields.items():
        if model is scene_file.SceneFile and name in TABLES:
            continue
        if not field.description:
            raise ValueError(f"{model.__name__}.{name} has no docstring")
        words, kind = value_and_kind(field.annotation)
        kind = kind or kind_of(field)
        units = list(UNITS[kind]) if kind else []
        unit = f"{units[0]} ({', '.join(units[1:])})" if len(units) > 1 else "".join(units)
        meaning = re.sub(r"``(.+?)``", r"`\1`", " ".join(field.description.split()))
        if own := re.search(r" \[([^][]+)\]\.$", meaning):
            unit, meaning = own[1], f"{meaning[: own.start()]}."
        lines.append(f"| `{name}` | {words} | {unit} | {default_of(field)} | {meaning} |")
    return "\n".join(lines)


def section(name: str) -> str:
    """Return a table of the file with its heading and description."""
    model, heading = TABLES[name]
    about = re.sub(r"^``.+?``: ", "", " ".join((model.__doc__ or "").split()))
    about = re.sub(r"``(.+?)``", r"`\1`", about)
    return f"### {heading}\n\n{about[0].upper()}{about[1:]}\n\n{table_of(model)}"


def page(text: str) -> str:
    """Return a page with the tables between its marks regenerated."""
    made = "\n\n".join(section(name) for name in TABLES)
    return re.sub(
        r"(<!-- keys -->\n).*?(<!-- end -->)", lambda m: f"{m[1]}\n{made}\n\n{m[2]}", text, flags=re.DOTALL
    )


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
