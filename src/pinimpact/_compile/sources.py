"""Hashes of the sources from which cached kernels were compiled.

The hash of a module covers its code and that of all modules of this package that it imports, directly or
indirectly, as syntax trees without docstrings: comments, layout and docstrings do not invalidate a kernel.
Sources are hashed when this module is imported, since kernels are compiled from the imported code even if
files are edited afterwards.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib.util
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT.name

Code = tuple[str, list[str]]
"""The digest of a module's code, and the modules of this package that it imports."""


def _path(module: str) -> Path | None:
    """Return the file of a module, or None if there is none."""
    package, *names = module.split(".")
    if package != PACKAGE:
        file = getattr(sys.modules.get(module), "__file__", None)
        return Path(file) if file else None
    path = ROOT.joinpath(*names)
    if path.is_dir():
        return path / "__init__.py"
    return path.with_suffix(".py") if path.with_suffix(".py").is_file() else None


def _hash(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()


_IMPORTED = {
    path: _hash(path.read_bytes()) for pattern in ("_*/*.py", "*/_*/*.py") for path in ROOT.glob(pattern)
}


class _Memory:
    """Results of parsing by module and hash of its source (`known`), saved in a file to save time."""

    def __init__(self) -> None:
        self._file: Path | None = None
        self.known: dict[str, Code] = {}
        self._unsaved = False

    def keep_in(self, folder: str) -> None:
        """Set the folder of the file, if there is none yet, and read the results in it."""
        if self._file is None:
            self._file = Path(folder, f"{PACKAGE}.{sys.implementation.cache_tag}.json")
            with contextlib.suppress(OSError, ValueError):
                self.known.update(json.loads(self._file.read_text()))

    def code(self, module: str) -> Code:
        path = _path(module)
        if path is None:
            return "", []
        imported = self.known.get(f"{module} {_IMPORTED.get(path)}")
        if imported is not None:
            return imported
        text = path.read_bytes()
        digest = _hash(text)
        if _IMPORTED.get(path, digest) != digest:  # edited since the import: the hash of the imported text
            return _IMPORTED[path], _imports(module, path, ast.parse(text))
        key = f"{module} {digest}"
        if key not in self.known:
            tree = ast.parse(text)
            imports = _imports(module, path, tree)
            self.known[key] = _digest(tree), imports
            self._unsaved = True
        return self.known[key]

    def save(self) -> None:
        """Write new results for other processes, if there is a folder."""
        if self._file is None or not self._unsaved:
            return
        self._unsaved = False
        with contextlib.suppress(OSError):
            handle, name = tempfile.mkstemp(dir=self._file.parent, prefix=PACKAGE)
            with os.fdopen(handle, "w") as file:
                json.dump(self.known, file)
            os.replace(name, self._file)


memory = _Memory()


@cache
def stamp(module: str) -> str:
    """Return a hash that changes if and only if the code of a module, or of one that it uses, changes."""
    found: dict[str, str] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found[name], imports = memory.code(name)
            waiting.extend(imports)
    memory.save()
    return _hash(json.dumps(sorted(found.items())).encode())


def _is_text(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def _digest(tree: ast.Module) -> str:
    """Return a hash of a module without docstrings, which are removed from the tree."""
    for node in (tree, *_statements(tree)):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [one for one in body if not _is_text(one)]  # type: ignore[attr-defined]
    return _hash(ast.dump(tree).encode())


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """Return all statements within one, or within a module."""
    for name in ("body", "orelse", "handlers", "finalbody", "cases"):
        for one in getattr(node, name, ()):
            yield one
            yield from _statements(one)


def _imports(module: str, path: Path, tree: ast.Module) -> list[str]:
    here = module if path.name == "__init__.py" else module.rpartition(".")[0]
    found: set[str] = set()
    for node in _statements(tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = importlib.util.resolve_name("." * node.level + (node.module or ""), here)
            for alias in node.names:
                found.add(f"{base}.{alias.name}" if _path(f"{base}.{alias.name}") else base)
    return sorted(name for name in found if name.split(".")[0] == PACKAGE)
