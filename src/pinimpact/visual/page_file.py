"""A self-contained HTML page: viewer, data and player."""

from __future__ import annotations

import base64
import gzip
import html
import json
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from .collada import for_viewer

LARGE = 10_000
"""Length from which meshes and textures are stored once and referred to by number [characters or bytes]."""


class Recorder:
    """A replacement of the window of meshcat's Visualizer that stores the commands."""

    web_url = None

    def __init__(self) -> None:
        self.commands: list[bytes] = []
        self._kept: dict[str | bytes, int] = {}
        self._split: dict[str, str] = {}

    def send(self, command: Any) -> None:
        """Store a command, with its meshes in the form that the viewer shows completely."""
        import umsgpack  # with meshcat

        message = command.lower()
        if message["type"] == "set_object":
            mesh = message["object"]["object"]
            if mesh.get("format") == "dae":
                document = mesh["data"]
                if document not in self._split:
                    self._split[document] = for_viewer(document)
                mesh["data"] = self._split[document]
            for shape in message["object"].get("geometries", ()):
                if shape["type"] == "_meshfile":  # its name in the present viewer
                    shape["type"] = "_meshfile_geometry"
        message = self._without_repeats(message, umsgpack.packb)
        self.commands.append(umsgpack.packb(message))

    def _without_repeats(self, value: Any, pack: Callable[[Any], bytes]) -> Any:
        """Return a message with its large meshes and textures, each stored once, replaced by numbers."""
        if isinstance(value, dict):
            return {name: self._without_repeats(part, pack) for name, part in value.items()}
        if isinstance(value, list):
            return [self._without_repeats(part, pack) for part in value]
        if not isinstance(value, (str, bytes)) or len(value) < LARGE:
            return value
        if value not in self._kept:
            self._kept[value] = len(self._kept)
            self.commands.append(pack({"type": "keep", "value": value}))
        return {"kept": self._kept[value]}


def page(title: str, commands: list[bytes], motion: dict[str, Any]) -> str:
    """Return the HTML of a replay, from the commands of a `Recorder` and data for page/player.js."""
    import meshcat

    viewer = Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js"
    own = files(__package__) / "page"
    # each command is preceded by its length
    whole = b"".join(len(command).to_bytes(4, "little") + command for command in commands)
    text = Template((own / "page.html").read_text(encoding="utf-8")).substitute(
        title=html.escape(title),
        shapes=base64.b64encode(gzip.compress(whole, 5, mtime=0)).decode("ascii"),
        motion=json.dumps(motion, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c"),
        viewer=_script(viewer.read_text(encoding="utf-8")),
        drawing=_script((own / "drawing.js").read_text(encoding="utf-8")),
        player=_script((own / "player.js").read_text(encoding="utf-8")),
    )
    # names of files, for instance, may have characters that UTF-8 lacks
    return text.encode("utf-8", "replace").decode("utf-8")


def packed(numbers: Any, kind: type[np.floating[Any]] = np.float32) -> str:
    """Return an array for the player: its little-endian bytes in base64."""
    array = np.ascontiguousarray(numbers, dtype=np.dtype(kind).newbyteorder("<"))
    return base64.b64encode(array.tobytes()).decode("ascii")


def _script(text: str) -> str:
    return text.replace("</script", "<\\/script")
